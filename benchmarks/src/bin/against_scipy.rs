//! The joint fit against `scipy.optimize.least_squares` over the same model, data, weights and start.
//!
//! ```text
//! benchmarks/scipy/compare.sh                     # makes the Python environment below target, builds, compares
//! cargo run --release -p benchmarks --bin against_scipy -- PYTHON fit.py
//! ```
//!
//! Both minimise the weighted sum of squares of the free-run errors of all experiments of role identify over the same 18
//! parameters, initial values as measured. Python's side integrates a right-hand side compiled by numba, stretches in parallel on as many
//! threads; its compilation is not counted. Costs are compared by the integrator of this project.

use benchmarks::campaign::{draw, record};
use benchmarks::{Target, exit};
use drivers::emulated::Noise;
use identify::fit::fit_from;
use identify::identification::{identify, polish, rough_fit};
use identify::layout::Layout;
use identify::prepare::{Channel, Stand};
use identify::problem::Problem;
use serde_json::{Value, json};
use std::error::Error;
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};
use std::time::Instant;

/// Time of scipy over ours.
const TARGET_TIME: Target = Target::AtLeast(10.0);
/// Our cost over scipy's.
const TARGET_COST: Target = Target::AtMost(1.0001);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [python, script] = &arguments[..] else {
        eprintln!("expected the Python interpreter and fit.py, got {arguments:?}");
        return ExitCode::from(2);
    };
    exit(compare(python, script))
}

fn compare(python: &str, script: &str) -> Result<bool, Box<dyn Error>> {
    let truth = draw(1);
    let loaded = record(&truth, Noise::default(), 1)?;
    let identified = identify(&loaded, &|_| ())?;
    let mut problem = identified.problem;
    problem.stretches.iter_mut().for_each(|s| s.initial_std = vec![0.0; 3]);
    // as after the component experiments
    let layout = Layout::base(&identified.component);
    let start = layout.vector_of(&identified.component);

    let begin = Instant::now();
    let (rough, known) = rough_fit(&problem, &layout, start.clone())?;
    let (own, _) = fit_from(&problem, &layout, rough.point, polish(), known)?;
    let own_s = begin.elapsed().as_secs_f64();

    let dir = tempfile::tempdir()?;
    write(&problem, &layout, &start, dir.path())?;
    let output =
        Command::new(python).args([script, &dir.path().display().to_string()]).stderr(Stdio::inherit()).output()?;
    if !output.status.success() {
        return Err(format!("{script} ended with {}", output.status).into());
    }
    let said: Value = serde_json::from_slice(&output.stdout)?;
    let number =
        |key: &str| said[key].as_f64().ok_or_else(|| format!("{script}: expected a number `{key}`, got {said}"));
    let theta: Vec<f64> =
        said["theta"].as_array().map(|t| t.iter().filter_map(Value::as_f64).collect()).unwrap_or_default();
    if theta.len() != start.len() {
        return Err(format!("{script}: expected {} parameters, got {}", start.len(), theta.len()).into());
    }
    let (seconds, by_itself) = (number("seconds")?, number("cost")?);
    let cost = problem.cost(&layout, &problem.point(theta));
    println!("{} targets, {} parameters, {} threads", problem.targets(), start.len(), rayon::current_num_threads());
    println!("{:<28}{:>12}{:>16}", "", "time / s", "cost");
    println!("{:<28}{:>12}{:>16.1}", "start", "", problem.cost(&layout, &problem.point(start)));
    println!("{:<28}{own_s:>12.2}{:>16.1}", "this project", own.cost);
    println!("{:<28}{seconds:>12.2}{cost:>16.1}   ({by_itself:.1} by its own integrator)", "scipy least_squares");
    println!("time of scipy over ours   {:.1}   {}", seconds / own_s, TARGET_TIME.judge(seconds / own_s));
    println!("our cost over scipy's     {:.6}   {}", own.cost / cost, TARGET_COST.judge(own.cost / cost));
    Ok(TARGET_TIME.reached_by(seconds / own_s) & TARGET_COST.reached_by(own.cost / cost))
}

/// The problem for Python: `problem.json`, and every column of every stretch one after the other in `data.f64`, little-endian.
fn write(problem: &Problem, layout: &Layout, start: &[f64], dir: &Path) -> Result<(), Box<dyn Error>> {
    let mut data: Vec<u8> = Vec::new();
    let mut put = |column: &mut dyn Iterator<Item = f64>| column.for_each(|v| data.extend_from_slice(&v.to_le_bytes()));
    let mut stretches = Vec::new();
    for (n, s) in problem.stretches.iter().enumerate() {
        let rows = s.rows();
        put(&mut s.time_s.iter().copied());
        put(&mut s.voltage_v.iter().copied());
        put(&mut s.brake_open.iter().map(|b| f64::from(u8::from(*b))));
        put(&mut s.bypass_open.iter().map(|b| f64::from(u8::from(*b))));
        let or_nothing = |column: &[f64]| if column.is_empty() { vec![f64::NAN; rows] } else { column.to_vec() };
        put(&mut or_nothing(&s.angle_rad).into_iter());
        s.pressure_bar.iter().for_each(|p| put(&mut or_nothing(p).into_iter()));
        for c in Channel::ALL {
            put(&mut or_nothing(&s.measured[c.index()]).into_iter());
        }
        let stand = match s.stand {
            Stand::Free => 0,
            Stand::Led => 1,
            Stand::LedShutOff => 2,
            Stand::Drained => 3,
            Stand::Bench => 4,
        };
        stretches.push(json!({
            "rows": rows, "stand": stand, "vertical": s.vertical, "initial": s.initial, "blocks": s.blocks,
            "std": problem.std[n], "targets": s.targets.len(),
        }));
    }
    let bounds: Vec<[Option<f64>; 2]> =
        layout.bounds().iter().map(|(l, u)| [l, u].map(|v| Some(*v).filter(|v| v.is_finite()))).collect();
    let described = json!({
        "stretches": stretches, "start": start, "base": layout.base, "fixed": layout.fixed, "bounds": bounds,
        "threads": rayon::current_num_threads(),
    });
    std::fs::write(dir.join("problem.json"), described.to_string())?;
    std::fs::write(dir.join("data.f64"), data)?;
    Ok(())
}
