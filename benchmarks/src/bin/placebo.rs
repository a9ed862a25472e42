//! Offers placebo terms on the residuals of a measured plant: phase-randomised surrogates of what the library's effects do, about their
//! mean. None of them is there, so no more than the level may be accepted.
//!
//! ```text
//! cargo run --release -p benchmarks --bin placebo -- --data train.csv.gz [--plant emps] [--terms 300]
//! ```

use identify::diagnose::{Declared, diagnose_declared};
use identify::fit::Fit;
use identify::layout::Layout;
use identify::plants::analysis::{fit_declared, problem_of};
use identify::plants::{Table, find};
use identify::problem::Problem;
use identify::score::{Direction, Scene};
use identify::significance::p_of_largest;
use identify::surrogate::{Spectrum, constant_share, p_of_selected};
use model::effects::Effect;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::error::Error;
use std::process::ExitCode;

/// Level of the test that each term is offered to.
const LEVEL: f64 = 0.01;
/// Largest share of accepted placebo terms.
const MOST: f64 = 0.03;

fn main() -> ExitCode {
    match run(&std::env::args().skip(1).collect::<Vec<_>>()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(3),
        Err(e) => {
            eprintln!("{e}");
            ExitCode::from(2)
        }
    }
}

fn run(args: &[String]) -> Result<bool, Box<dyn Error>> {
    let after = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let data = after("--data").ok_or("expected --data FILE, the plant's recording that is fitted")?;
    let id = after("--plant").map_or("emps", |s| s);
    let terms: usize = after("--terms").map_or(Ok(300), |s| s.parse()).map_err(|_| "--terms: expected a number")?;
    let plant = find(id).ok_or_else(|| format!("--plant: expected silverbox or emps, got {id}"))?;
    let problem = problem_of(plant, &Table::read(data.as_ref())?)?;
    let declared = fit_declared(plant, &problem)?;
    let component = Layout::of_plant(plant).fixed;
    let base = Declared { problem: &problem, fit: &declared, component: &component };
    let diagnosis = diagnose_declared(plant.header().library, &base, &|_| {})?;
    // what the engine adds is held against surrogates like the placebo terms
    let named: Vec<&str> = diagnosis.after.layout.effects.iter().map(|e| e.header().id).collect();
    println!(
        "{terms} placebo terms on the residuals of {id}, level {LEVEL}; at most {:.0} % may be accepted",
        100.0 * MOST
    );
    let mut kept = true;
    for (what, fit) in
        [("declared model".to_string(), &declared), (format!("with {}", named.join(", ")), &diagnosis.after)]
    {
        let counted = offer(&problem, fit, plant.header().library, terms)?;
        let share = |n: usize| 100.0 * n as f64 / counted.terms as f64;
        println!(
            "{what}: {} of {} accepted ({:.1} %); by signs of clusters alone {:.1} %, by a t-test of independent samples {:.1} %",
            counted.accepted,
            counted.terms,
            share(counted.accepted),
            share(counted.by_clusters),
            share(counted.by_t)
        );
        let share = counted.accepted as f64 / counted.terms as f64;
        kept &= share <= MOST;
    }
    Ok(kept)
}

/// A series less its mean.
fn about_mean(mut series: Vec<f64>) -> Vec<f64> {
    let mean = series.iter().sum::<f64>() / series.len().max(1) as f64;
    series.iter_mut().for_each(|v| *v -= mean);
    series
}

/// Accepted placebo terms.
#[derive(Default)]
struct Counted {
    terms: usize,
    /// By the test that a plant's findings must pass.
    accepted: usize,
    /// By the signs of clusters.
    by_clusters: usize,
    /// By a t-test that takes samples as independent.
    by_t: usize,
}

/// Offers terms on the residual of a fit.
fn offer(
    problem: &Problem,
    fit: &Fit,
    library: &[&'static dyn Effect],
    terms: usize,
) -> Result<Counted, Box<dyn Error>> {
    let scene = Scene::new(problem, fit)?;
    // a constant has no phases: it would be offered as itself
    let moves = |d: &Direction| constant_share(d) < 0.5;
    let candidates: Vec<Direction> = library.iter().flat_map(|e| scene.directions(*e)).filter(moves).collect();
    if candidates.is_empty() {
        return Err("expected effects that change over time in the plant's library, got none".into());
    }
    let spectra: Vec<Vec<Spectrum>> =
        candidates.iter().map(|d| d.raw.iter().map(|s| Spectrum::of(s)).collect()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(300);
    let mut out = Counted { terms, ..Counted::default() };
    let square: f64 = scene.residual.iter().flatten().map(|r| r * r).sum();
    let samples = problem.targets() as f64;
    for n in 0..terms {
        let from = n % candidates.len();
        // a mean is no placebo: a constant force is an effect of the library, and one that may be there
        let secant = spectra[from].iter().map(|s| about_mean(s.surrogate(&mut rng))).collect();
        let Some(d) = scene.along(candidates[from].effect, &candidates[from].start, secant) else { continue };
        out.accepted += usize::from(p_of_selected(&scene, &d, &[&d], n as u64) <= LEVEL);
        out.by_clusters += usize::from(p_of_largest(&[scene.by_cluster(&d)], &[false], n as u64) <= LEVEL);
        let t = d.with_residual / (d.square * square / samples).sqrt();
        out.by_t += usize::from(t.abs() > 2.576);
    }
    Ok(out)
}
