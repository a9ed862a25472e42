//! Whether the identification's 95 % intervals hold the truth in 90 to 99 % of campaigns, parameter by parameter.
//!
//! ```text
//! cargo run --release -p benchmarks --bin coverage                            # 200 campaigns
//! cargo run --release -p benchmarks --bin coverage -- --cases 40 --seed 7 --each cases.tsv
//! ```
//!
//! Each case is a rig of its own, drawn within 10 % of the example, all built-in experiments on it through the real loop in virtual
//! time, in memory, and the identification of what its sensors showed. z is (estimate - truth) / standard error.

use benchmarks::campaign::{draw, record};
use benchmarks::exit;
use drivers::emulated::Noise;
use identify::identification::identify;
use identify::uncertainty::Uncertainty;
use model::parameters::NAMES;
use rayon::prelude::*;
use std::error::Error;
use std::fmt::Write as _;
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Cases that the verdict of 90 to 99 % refers to.
const CASES: usize = 200;
/// Share of the intervals that must hold the truth.
const LEAST: f64 = 0.90;
const MOST: f64 = 0.99;

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let (mut cases, mut seed, mut each) = (CASES, 1u64, None);
    while let Some(argument) = arguments.next() {
        let value = arguments.next();
        let number = value.as_deref().and_then(|v| v.parse::<u64>().ok());
        match (argument.as_str(), number, value) {
            ("--cases", Some(n), _) if n > 0 => cases = n as usize,
            ("--seed", Some(n), _) => seed = n,
            ("--each", _, Some(file)) => each = Some(file),
            (argument, _, value) => {
                eprintln!("expected --cases N, --seed S or --each FILE, got {argument} {}", value.unwrap_or_default());
                return ExitCode::from(2);
            }
        }
    }
    exit(study(cases, seed, each.as_deref()))
}

/// One parameter of one case.
struct Estimate {
    parameter: usize,
    value: f64,
    std: f64,
    freedom: f64,
    widening: f64,
    interval: (f64, f64),
    truth: f64,
}

impl Estimate {
    fn holds(&self) -> bool {
        (self.interval.0..=self.interval.1).contains(&self.truth)
    }
}

fn case(seed: u64) -> Result<Vec<Estimate>, String> {
    let truth = draw(seed);
    let loaded = record(&truth, Noise::default(), seed).map_err(|e| e.to_string())?;
    let identified = identify(&loaded, &|_| ()).map_err(|e| e.to_string())?;
    let uncertainty = Uncertainty::of(&identified.problem, &identified.fit).map_err(|e| e.to_string())?;
    let value = identified.fit.layout.parameters(&identified.fit.point.theta).to_vector();
    let truth = truth.to_vector();
    let estimates = uncertainty.determined().into_iter();
    Ok(estimates
        .map(|(p, _, std)| {
            let half = uncertainty.half_interval(p).unwrap_or(f64::NAN);
            Estimate {
                parameter: p,
                value: value[p],
                std,
                freedom: uncertainty.freedom(p).unwrap_or(f64::NAN),
                widening: uncertainty.widening(p).unwrap_or(f64::NAN),
                interval: (value[p] - half, value[p] + half),
                truth: truth[p],
            }
        })
        .collect())
}

fn study(cases: usize, seed: u64, each: Option<&str>) -> Result<bool, Box<dyn Error>> {
    let done = AtomicUsize::new(0);
    let seeds: Vec<u64> = (seed..seed + cases as u64).collect();
    let found: Vec<(u64, Result<Vec<Estimate>, String>)> = seeds
        .into_par_iter()
        .with_max_len(1)
        .map(|seed| {
            let found = case(seed);
            eprintln!("case {} of {cases} done", done.fetch_add(1, Ordering::Relaxed) + 1);
            (seed, found)
        })
        .collect();
    let failed: Vec<_> = found.iter().filter_map(|(seed, f)| f.as_ref().err().map(|e| (seed, e))).collect();
    for (seed, error) in &failed {
        println!("seed {seed} could not be identified: {error}");
    }
    if let Some(file) = each {
        let mut text = "seed\tparameter\ttruth\tvalue\tstd\tz\tfreedom\twidening\n".to_owned();
        for (seed, estimates) in &found {
            for e in estimates.iter().flatten() {
                let z = (e.value - e.truth) / e.std;
                let (name, truth, value, std) = (NAMES[e.parameter], e.truth, e.value, e.std);
                let (freedom, widening) = (e.freedom, e.widening);
                writeln!(text, "{seed}\t{name}\t{truth}\t{value}\t{std}\t{z}\t{freedom}\t{widening}")?;
            }
        }
        std::fs::write(file, text)?;
    }

    println!(
        "{:<6}{:>7}{:>9}{:>9}{:>9}{:>9}{:>9}{:>11}   95 % Wilson",
        "", "cases", "mean z", "RMS z", "most |z|", "freedom", "widened", "held / %"
    );
    let mut reached = failed.is_empty();
    for (p, name) in NAMES.iter().enumerate() {
        let own: Vec<&Estimate> =
            found.iter().flat_map(|(_, f)| f.iter().flatten()).filter(|e| e.parameter == p).collect();
        if own.is_empty() {
            continue;
        }
        let n = own.len() as f64;
        let z: Vec<f64> = own.iter().map(|e| (e.value - e.truth) / e.std).collect();
        let held = own.iter().filter(|e| e.holds()).count() as f64;
        let (low, high) = wilson(held, n);
        let share = held / n;
        // few cases can only refute
        let verdict = match ((LEAST..=MOST).contains(&share), high < LEAST || low > MOST) {
            (true, _) => "reached",
            (false, false) if own.len() < CASES => "too few cases to refute",
            _ => "MISSED",
        };
        reached &= verdict != "MISSED";
        println!(
            "{name:<6}{:>7}{:>9.2}{:>9.2}{:>9.2}{:>9.0}{:>9.2}{:>11.1}   {:.1} .. {:.1}  {verdict}",
            own.len(),
            z.iter().sum::<f64>() / n,
            (z.iter().map(|z| z * z).sum::<f64>() / n).sqrt(),
            z.iter().fold(0.0f64, |m, z| m.max(z.abs())),
            own.iter().map(|e| e.freedom).sum::<f64>() / n,
            own.iter().map(|e| e.widening).sum::<f64>() / n,
            100.0 * share,
            100.0 * low,
            100.0 * high,
        );
    }
    Ok(reached)
}

/// Wilson's 95 % interval of a share.
fn wilson(held: f64, n: f64) -> (f64, f64) {
    let z2 = 1.96f64 * 1.96;
    let p = held / n;
    let middle = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = (z2 * (p * (1.0 - p) / n + z2 / (4.0 * n * n))).sqrt() / (1.0 + z2 / n);
    ((middle - half).max(0.0), (middle + half).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_s_interval_is_the_textbook_s() {
        let (low, high) = wilson(190.0, 200.0);
        assert!((low - 0.9105).abs() < 1e-3 && (high - 0.9726).abs() < 1e-3, "{low} {high}");
        assert_eq!(wilson(10.0, 10.0).1, 1.0);
    }
}
