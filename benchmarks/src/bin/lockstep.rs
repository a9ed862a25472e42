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
use benchmarks::{Bench, Target, exit};
use recordings::RunMetadata;
use rt_core::{Handover, PERIOD_NS, Pace, Publication, Publish, Sample};
use rustix::thread::{CpuSet, sched_setaffinity};
use rustix::time::{ClockId, clock_gettime};
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
const TARGET_ALONE: Target = Target::AtLeast(500.0);
/// Times real time with the recording logger.
const TARGET_LOGGED: Target = Target::AtLeast(150.0);
/// Memory after an hour of virtual time over that after ten minutes.
const TARGET_GROWTH: Target = Target::AtMost(1.1);

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let outcome = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => one_core().and_then(|()| Ok(speed()? & memory()?)),
        ["speed"] => one_core().and_then(|()| speed()),
        ["memory"] => one_core().and_then(|()| memory()),
        _ => {
            eprintln!("expected `speed`, `memory` or nothing, got {arguments:?}");
            return ExitCode::from(2);
        }
    };
    exit(outcome)
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

fn speed() -> Result<bool, Box<dyn Error>> {
    let dir = tempfile::tempdir()?;
    let mut bench = Bench::new(PROFILE, str::to_owned)?;
    let (mut dropped, mut alone, mut logged) = (Vec::new(), Vec::new(), Vec::new());
    for round in 0..ROUNDS {
        dropped.push(timed(|| bench.run_new(0, &mut Nobody))?);

        let mut publication = Publication::start(&instance(), Pace::LOCKSTEP)?;
        alone.push(timed(|| {
            let ticks = bench.run_new(0, &mut publication)?;
            publication.settle(PATIENCE)?;
            Ok(ticks)
        })?);
        publication.stop()?;

        let path = dir.path().join(format!("{round}.mcap"));
        logged.push(timed(|| recorded(&mut bench, &path, |_| ()))?);
    }
    println!("{PROFILE}, {ROUNDS} runs each on one core; medians, times real time");
    println!("{:<42}{:>10}{:>10}", "", "by clock", "by CPU");
    let mut reached = true;
    for (name, speeds, target) in [
        ("samples dropped", &dropped, None),
        ("published, no subscriber", &alone, Some(TARGET_ALONE)),
        ("published and recorded by the logger", &logged, Some(TARGET_LOGGED)),
    ] {
        let (by_clock, by_cpu) = (median(speeds, |s| s.by_clock), median(speeds, |s| s.by_cpu));
        let judged = target.map_or(String::new(), |target: Target| target.judge(by_clock));
        println!("{name:<42}{by_clock:>10.0}{by_cpu:>10.0}   {judged}");
        reached &= target.is_none_or(|target| target.reached_by(by_clock));
    }
    Ok(reached)
}

fn instance() -> String {
    format!("benchmark-{}", std::process::id())
}

/// Virtual time over real time.
struct Speed {
    /// By the clock on the wall, with whatever else the machine did.
    by_clock: f64,
    /// By the CPU time of all threads of this process.
    by_cpu: f64,
}

fn timed(run: impl FnOnce() -> Result<u64, Box<dyn Error>>) -> Result<Speed, Box<dyn Error>> {
    let now = |clock| {
        let time = clock_gettime(clock);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    };
    let begin_s = [ClockId::Monotonic, ClockId::ProcessCPUTime].map(now);
    let virtual_s = (run()? * PERIOD_NS) as f64 * 1e-9;
    let end_s = [ClockId::Monotonic, ClockId::ProcessCPUTime].map(now);
    Ok(Speed { by_clock: virtual_s / (end_s[0] - begin_s[0]), by_cpu: virtual_s / (end_s[1] - begin_s[1]) })
}

fn median(speeds: &[Speed], of: fn(&Speed) -> f64) -> f64 {
    let mut values: Vec<f64> = speeds.iter().map(of).collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// One run that the logger records to the last sample; `at_tick` is called at each tick.
fn recorded(bench: &mut Bench, path: &Path, at_tick: impl FnMut(u64)) -> Result<u64, Box<dyn Error>> {
    let publication = Publication::start(&instance(), Pace::LOCKSTEP)?;
    let mut logger = Logger::start(&instance())?;
    publication.wait_for_loggers(1, PATIENCE)?;
    let mut metadata = RunMetadata::new(
        bench.script.name.clone(),
        FromStr::from_str(bench.script.protocol.as_str())?,
        FromStr::from_str(bench.script.role.as_str())?,
        FromStr::from_str(bench.script.plane.as_str())?,
    );
    metadata.profile = bench.text.clone();
    logger.begin(0, path.to_owned(), metadata, |_| ())?;
    let mut watched = Watched { publication, at_tick };
    let ticks = bench.run_new(0, &mut watched)?;
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

fn memory() -> Result<bool, Box<dyn Error>> {
    const TEN_MINUTES: u64 = 600_000;
    let dir = tempfile::tempdir()?;
    let mut bench = Bench::new(PROFILE, |_| an_hour())?;
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
        "an hour of random steps, recorded in {:.1} s; resident every 10 min, MB: {}",
        begin.elapsed().as_secs_f64(),
        shown.join(" ")
    );
    println!("memory at 60 min over that at 10 min: {:.3}, {}", last / first, TARGET_GROWTH.judge(last / first));
    Ok(TARGET_GROWTH.reached_by(last / first))
}

/// Random steps for an hour. Every minute the chambers are filled anew: over many cycles the paper's chambers lose oil, since
/// eqs. (13) and (14) close no volume.
fn an_hour() -> String {
    r#"
name = "hour"
protocol = "random-steps"
role = "validate"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
[[step]]
repeat = 61
  [[step.step]]
  voltage_v = 0.0
  brake = "closed"
  fixture = "filled"
  angle_deg = 0.0
  pressure1_bar = 2.8
  pressure2_bar = 2.8
  for_s = 1.0
  [[step.step]]
  brake = "open"
  fixture = "free"
  for_s = 1.0
  [[step.step]]
  [step.step.random]
  total_s = 58.0
  length_s = [0.2, 2.5]
  voltage_u_max = [0.04, 0.97]
  zero_share = 0.1
  brake_closed_share = 0.12
  bypass_open_share = 0.12
  guard_deg = 25.0
"#
    .to_owned()
}

/// Resident memory of this process, MB.
fn resident_mb() -> Result<f64, String> {
    let status = std::fs::read_to_string("/proc/self/status").map_err(|e| format!("/proc/self/status: {e}"))?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kb = line.and_then(|line| line.split_whitespace().next()).and_then(|word| word.parse::<f64>().ok());
    kb.map(|kb| kb / 1024.0).ok_or_else(|| "/proc/self/status: expected a line VmRSS".to_owned())
}
