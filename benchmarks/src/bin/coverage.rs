//! Whether the identification's 95 % intervals hold the truth in 90 to 99 % of campaigns, parameter by parameter.
//!
//! ```text
//! cargo run --release -p benchmarks --bin coverage                            # 200 campaigns
//! cargo run --release -p benchmarks --bin coverage -- --cases 40 --seed 7 --each cases.tsv
//! ```
//!
//! `--each` keeps every case in a file as soon as it is done; a call with a file that is there goes on with the cases that it lacks.
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
use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write as _;
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

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

/// First line of the file of cases.
const HEAD: &str = "seed\tparameter\ttruth\tvalue\tstd\tlow\thigh\tfreedom\twidening";

/// A case as lines of the file.
fn lines(seed: u64, estimates: &[Estimate]) -> String {
    let mut text = String::new();
    for e in estimates {
        let (name, (low, high)) = (NAMES[e.parameter], e.interval);
        let Estimate { truth, value, std, freedom, widening, .. } = e;
        text += &format!("{seed}\t{name}\t{truth}\t{value}\t{std}\t{low}\t{high}\t{freedom}\t{widening}\n");
    }
    text
}

/// The cases of a file that [`lines`] wrote.
fn kept(text: &str, file: &str) -> Result<BTreeMap<u64, Vec<Estimate>>, Box<dyn Error>> {
    let mut cases: BTreeMap<u64, Vec<Estimate>> = BTreeMap::new();
    let mut all = text.lines();
    if all.next().is_some_and(|head| head != HEAD) {
        return Err(format!("{file}: expected a file of this study, which begins with {HEAD:?}").into());
    }
    for (n, line) in all.enumerate() {
        let wrong = || format!("{file}, line {}: expected 9 fields of a case, got {line:?}; delete it", n + 2);
        let fields: Vec<&str> = line.split('\t').collect();
        let [seed, name, numbers @ ..] = &fields[..] else { return Err(wrong().into()) };
        let parameter = NAMES.iter().position(|n| n == name).ok_or_else(wrong)?;
        let numbers: Vec<f64> = numbers.iter().map(|v| v.parse()).collect::<Result<_, _>>().map_err(|_| wrong())?;
        let &[truth, value, std, low, high, freedom, widening] = &numbers[..] else { return Err(wrong().into()) };
        let estimate = Estimate { parameter, value, std, freedom, widening, interval: (low, high), truth };
        cases.entry(seed.parse().map_err(|_| wrong())?).or_default().push(estimate);
    }
    Ok(cases)
}

fn study(cases: usize, seed: u64, each: Option<&str>) -> Result<bool, Box<dyn Error>> {
    let seeds = seed..seed + cases as u64;
    let mut found = BTreeMap::new();
    let mut file = None;
    if let Some(name) = each {
        let text = match std::fs::read_to_string(name) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            read => read.map_err(|e| format!("{name}: {e}"))?,
        };
        found = kept(&text, name)?;
        found.retain(|seed, _| seeds.contains(seed));
        let mut to = std::fs::OpenOptions::new().create(true).append(true).open(name)?;
        if text.is_empty() {
            writeln!(to, "{HEAD}")?;
        }
        file = Some(Mutex::new(to));
    }
    let missing: Vec<u64> = seeds.filter(|seed| !found.contains_key(seed)).collect();
    let done = AtomicUsize::new(found.len());
    let new: Vec<(u64, Result<Vec<Estimate>, String>)> = missing
        .into_par_iter()
        .with_max_len(1)
        .map(|seed| {
            let mut found = case(seed);
            if let (Some(file), Ok(estimates)) = (&file, &found) {
                let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
                // whole cases only: one write
                if let Err(e) = file.write_all(lines(seed, estimates).as_bytes()) {
                    found = Err(format!("not kept: {e}"));
                }
            }
            eprintln!("case {} of {cases} done", done.fetch_add(1, Ordering::Relaxed) + 1);
            (seed, found)
        })
        .collect();
    let mut failed = 0;
    for (seed, case) in new {
        match case {
            Ok(estimates) => drop(found.insert(seed, estimates)),
            Err(error) => {
                failed += 1;
                println!("seed {seed} could not be identified: {error}");
            }
        }
    }

    println!(
        "{:<6}{:>7}{:>9}{:>9}{:>9}{:>9}{:>9}{:>11}   95 % Wilson",
        "", "cases", "mean z", "RMS z", "most |z|", "freedom", "widened", "held / %"
    );
    let mut reached = failed == 0;
    for (p, name) in NAMES.iter().enumerate() {
        let own: Vec<&Estimate> = found.values().flatten().filter(|e| e.parameter == p).collect();
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
    let verdict = if reached { "reached" } else { "MISSED" };
    println!("{} of {cases} cases: 90 to 99 % of each parameter's intervals hold the truth: {verdict}", found.len());
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
    fn a_case_that_was_kept_is_read_back() {
        let estimate = |parameter, value| Estimate {
            parameter,
            value,
            std: 0.1,
            freedom: 12.5,
            widening: f64::NAN,
            interval: (value - 0.2, value + 0.2),
            truth: 1.0 / 3.0,
        };
        let text =
            format!("{HEAD}\n{}{}", lines(7, &[estimate(0, 0.4), estimate(3, -1e-9)]), lines(2, &[estimate(1, 2.0)]));
        let cases = kept(&text, "cases.tsv").expect("it is well formed");
        assert_eq!(cases.keys().copied().collect::<Vec<_>>(), [2, 7]);
        assert_eq!((cases[&7][1].parameter, cases[&7][1].value, cases[&7][1].truth), (3, -1e-9, 1.0 / 3.0));
        assert!(cases[&7][0].holds() && !cases[&2][0].holds() && cases[&2][0].widening.is_nan());
        assert!(kept("seed", "x").is_err() && kept(&format!("{HEAD}\n1\tm1\t2"), "x").is_err());
        assert!(kept("", "x").expect("a new file").is_empty());
    }

    #[test]
    fn wilson_s_interval_is_the_textbook_s() {
        let (low, high) = wilson(190.0, 200.0);
        assert!((low - 0.9105).abs() < 1e-3 && (high - 0.9726).abs() < 1e-3, "{low} {high}");
        assert_eq!(wilson(10.0, 10.0).1, 1.0);
    }
}
