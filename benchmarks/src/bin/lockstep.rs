//! How fast virtual time passes, and whether memory stays constant over an hour of it.
//!
//! ```text
//! cargo run --release -p benchmarks --bin lockstep            # both
//! cargo run --release -p benchmarks --bin lockstep -- speed
//! cargo run --release -p benchmarks --bin lockstep -- memory
//! ```
//!
//! Everything runs on one core: loop, publication thread and logger.

use bench::logger::Logger;
use benchmarks::Bench;
use recordings::RunMetadata;
use rt_core::{Handover, PERIOD_NS, Pace, Publication, Publish, Sample};
use rustix::thread::{CpuSet, sched_setaffinity};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// The profile that is played.
const PROFILE: &str = "random_a";
/// Runs of each kind; they take turns.
const ROUNDS: u32 = 5;
/// Longest wait for the logger.
const PATIENCE: Duration = Duration::from_secs(30);

/// Times real time without subscribers.
const TARGET_ALONE: f64 = 500.0;
/// Times real time with the recording logger.
const TARGET_LOGGED: f64 = 150.0;
/// Memory after an hour of virtual time over that after ten minutes.
const TARGET_GROWTH: f64 = 1.1;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let outcome = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => one_core().and_then(|()| speed()).and_then(|()| memory()),
        ["speed"] => one_core().and_then(|()| speed()),
        ["memory"] => one_core().and_then(|()| memory()),
        _ => {
            eprintln!("expected `speed`, `memory` or nothing, got {arguments:?}");
            return ExitCode::from(2);
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(1)
        }
    }
}

fn one_core() -> Result<(), Box<dyn Error>> {
    let mut cpus = CpuSet::new();
    cpus.set(0);
    Ok(sched_setaffinity(None, &cpus)?)
}

/// Nobody hears of the samples.
struct Nobody;

impl Publish for Nobody {
    fn publish(&mut self, _sample: &Sample) -> Handover {
        Handover::Taken
    }
}

fn speed() -> Result<(), Box<dyn Error>> {
    let dir = tempfile::tempdir()?;
    let mut bench = Bench::new(PROFILE, str::to_owned)?;
    let (mut loop_alone, mut alone, mut logged) = (Vec::new(), Vec::new(), Vec::new());
    for round in 0..ROUNDS {
        loop_alone.push(times_real_time(|| bench.run_open_loop(0, &mut Nobody))?);

        let mut publication = Publication::start(&instance(), Pace::LOCKSTEP)?;
        alone.push(times_real_time(|| {
            let ticks = bench.run_open_loop(0, &mut publication)?;
            publication.settle(PATIENCE)?;
            Ok(ticks)
        })?);
        publication.stop()?;

        let path = dir.path().join(format!("{round}.mcap"));
        logged.push(times_real_time(|| recorded(&mut bench, &path, |_| ()))?);
    }
    println!("{PROFILE}, {ROUNDS} runs each, one core; median         times real time   target");
    println!("loop and emulated rig, samples dropped          {:>14.0}", median(&mut loop_alone));
    for (name, values, target) in [
        ("published, no subscriber", &mut alone, TARGET_ALONE),
        ("published and recorded by the logger", &mut logged, TARGET_LOGGED),
    ] {
        let median = median(values);
        println!("{name:<48}{median:>14.0}   {target:>8.0}   ratio {:.2}, at least 1 is wanted", median / target);
    }
    Ok(())
}

fn instance() -> String {
    format!("benchmark-{}", std::process::id())
}

fn times_real_time(run: impl FnOnce() -> Result<u64, Box<dyn Error>>) -> Result<f64, Box<dyn Error>> {
    let begin = Instant::now();
    let ticks = run()?;
    Ok((ticks * PERIOD_NS) as f64 * 1e-9 / begin.elapsed().as_secs_f64())
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// One run that the logger records to the last sample; `at_tick` is called at each tick.
fn recorded(bench: &mut Bench, path: &Path, at_tick: impl FnMut(u64)) -> Result<u64, Box<dyn Error>> {
    let publication = Publication::start(&instance(), Pace::LOCKSTEP)?;
    let mut logger = Logger::start(&instance())?;
    publication.wait_for_loggers(1, PATIENCE)?;
    let metadata = RunMetadata {
        name: bench.script.name.clone(),
        protocol: FromStr::from_str(bench.script.protocol.as_str())?,
        role: FromStr::from_str(bench.script.role.as_str())?,
        plane: FromStr::from_str(bench.script.plane.as_str())?,
        profile: bench.text.clone(),
        notes: BTreeMap::new(),
    };
    logger.begin(0, path.to_owned(), metadata, |_| ())?;
    let mut watched = Watched { publication, at_tick };
    let ticks = bench.run_open_loop(0, &mut watched)?;
    watched.publication.settle(PATIENCE)?;
    let recorded = logger.end(0, Some(ticks), Vec::new())?;
    drop(logger);
    watched.publication.stop()?;
    if !recorded.certificate.is_lossless() {
        return Err(format!("the logger received {}", recorded.certificate).into());
    }
    Ok(ticks)
}

/// The publication, and somebody who looks on.
struct Watched<F> {
    publication: Publication,
    at_tick: F,
}

impl<F: FnMut(u64)> Publish for Watched<F> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        (self.at_tick)(sample.tick);
        self.publication.publish(sample)
    }

    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        self.publication.publish_patiently(sample)
    }
}

fn memory() -> Result<(), Box<dyn Error>> {
    const TEN_MINUTES: u64 = 600_000;
    let dir = tempfile::tempdir()?;
    let mut bench = Bench::new(PROFILE, |text| text.replace("total_s = 70.0", "total_s = 3610.0"))?;
    let mut resident = Vec::new();
    let begin = Instant::now();
    let ticks = recorded(&mut bench, &dir.path().join("hour.mcap"), |tick| {
        if tick > 0 && tick % TEN_MINUTES == 0 {
            resident.push(resident_mb());
        }
    })?;
    let resident = resident.into_iter().collect::<Result<Vec<f64>, _>>()?;
    let (Some(first), Some(last), 6) = (resident.first(), resident.last(), resident.len()) else {
        return Err(format!("expected an hour of virtual time, got {ticks} ticks").into());
    };
    let shown: Vec<String> = resident.iter().map(|mb| format!("{mb:.1}")).collect();
    println!(
        "an hour of {PROFILE}, recorded in {:.1} s; resident every 10 min, MB: {}",
        begin.elapsed().as_secs_f64(),
        shown.join(" ")
    );
    println!("memory at 60 min over 10 min: ratio {:.3}, at most {TARGET_GROWTH} is wanted", last / first);
    Ok(())
}

/// Resident memory of this process, MB.
fn resident_mb() -> Result<f64, String> {
    let status = std::fs::read_to_string("/proc/self/status").map_err(|e| format!("/proc/self/status: {e}"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kb = line.and_then(|line| line.split_whitespace().next()).and_then(|word| word.parse::<f64>().ok());
    kb.map(|kb| kb / 1024.0).ok_or_else(|| "/proc/self/status: expected a line VmRSS".to_owned())
}
