//! Instructions of one tick, in all and by stage, as callgrind counts them: the same in every run, whatever the machine does.
//!
//! ```text
//! cargo run --release -p benchmarks --bin instructions            # all profiles
//! cargo run --release -p benchmarks --bin instructions square_h   # this one
//! ```
//!
//! The loop is driven for N and for 2 N ticks in virtual time; the difference is N ticks without anything before and after
//! them. Callgrind counts within the function of a stage alone, one stage at a time. The supervisor is no function of its
//! own within the loop: it is fed again with what a run showed it. A real-time loop adds the clock: one wait and eight
//! readings (vDSO) a tick. Needs valgrind.

use benchmarks::{Bench, Target, exit};
use rt_core::{
    Command, Controller, Demand, Device, DeviceError, Fixture, Handover, Limits, Measurement, Pace, Publication,
    Publish, Reference, SafeState, Sample, Step, Supervisor, Tick,
};
use std::error::Error;
use std::process::{Command as Process, ExitCode, Stdio};

/// N. Twice as many samples fit the publication's queue, so that the loop never waits, however slow valgrind is.
const TICKS: u64 = 2000;
/// Instructions that a tick should not exceed.
const TARGET: Target = Target::AtMost(6000.0);
/// Profiles that are counted.
const PROFILES: [&str; 5] = ["square_h", "random_a", "constant_flow", "pressure_steps", "angle_sine"];
/// Argument by which the program, as its own child under callgrind, plays a profile.
const PLAY: &str = "--play";

/// What is counted: name, and the function within which callgrind counts.
const PARTS: [(&str, &str); 6] = [
    ("device", "device_stage"),
    ("supervisor", SUPERVISOR),
    ("profile", "profile_stage"),
    ("controller", "controller_stage"),
    ("hand-over", "handover_stage"),
    ("all", "whole_run"),
];
/// The function of the only stage that is not counted within the loop.
const SUPERVISOR: &str = "supervisor_stage";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let outcome = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [PLAY, profile, function, ticks] => {
            ticks.parse().map_err(Into::into).and_then(|ticks| play(profile, ticks, function == SUPERVISOR))
        }
        [] => PROFILES.iter().try_fold(true, |all, profile| Ok(count(profile)? & all)),
        [profile] if PROFILES.contains(&profile) => count(profile),
        _ => {
            eprintln!("expected one of {PROFILES:?} or nothing, got {arguments:?}");
            return ExitCode::from(2);
        }
    };
    exit(outcome)
}

fn count(profile: &str) -> Result<bool, Box<dyn Error>> {
    println!("{profile}: instructions of a tick");
    let (mut stages, mut all) = (0.0, 0.0);
    for (name, function) in PARTS {
        let (once, twice) = (counted(profile, function, TICKS)?, counted(profile, function, 2 * TICKS)?);
        let of_a_tick = (twice - once) as f64 / TICKS as f64;
        if name == "all" {
            all = of_a_tick;
            println!("  {:<12}{:>8.0}   clock, sample, accounting, flight recorder", "the loop", all - stages);
        } else {
            stages += of_a_tick;
        }
        println!("  {name:<12}{of_a_tick:>8.0}");
    }
    println!("  {}", TARGET.judge(all));
    Ok(TARGET.reached_by(all))
}

/// Instructions within a function of the child, in all.
fn counted(profile: &str, function: &str, ticks: u64) -> Result<u64, Box<dyn Error>> {
    let dir = tempfile::tempdir()?;
    let out = dir.path().join("callgrind.out");
    let child = Process::new("valgrind")
        .args(["--tool=callgrind", "--collect-atstart=no"])
        .arg(format!("--toggle-collect=*{function}*"))
        .arg(format!("--callgrind-out-file={}", out.display()))
        .arg(std::env::current_exe()?)
        .args([PLAY, profile, function, &ticks.to_string()])
        .stdin(Stdio::null())
        .output()
        .map_err(|e| format!("valgrind: expected it on this machine (apt-get install valgrind), got \"{e}\""))?;
    if !child.status.success() {
        return Err(format!("valgrind ended with {}: {}", child.status, String::from_utf8_lossy(&child.stderr)).into());
    }
    let text = std::fs::read_to_string(&out).map_err(|e| format!("{}: {e}", out.display()))?;
    let total = text.lines().find_map(|line| line.strip_prefix("totals: ")).and_then(|n| n.trim().parse::<u64>().ok());
    match total {
        Some(total) if total > 0 => Ok(total),
        _ => Err(format!("{profile}: expected instructions within *{function}*, callgrind found none").into()),
    }
}

/// What the child does: a run of `ticks`; then, where it is asked for, the supervisor again with what the run showed it.
fn play(profile: &str, ticks: u64, supervisor: bool) -> Result<bool, Box<dyn Error>> {
    let mut bench = Bench::new(profile, str::to_owned)?;
    let seen = supervisor.then(|| Vec::with_capacity(ticks as usize));
    let mut device = Counted { inner: bench.rig()?, seen };
    let mut reference = Cut { inner: bench.playback()?, last: ticks - 1 };
    // In real time's way: the loop never waits for the queue.
    let publication = Publication::start(&format!("instructions-{}", std::process::id()), Pace::RealTime)?;
    let mut publish = Handed(publication);
    let played = whole_run(&mut bench, &mut device, &mut reference, &mut publish)?;
    if played != ticks {
        return Err(format!("{profile}: expected {ticks} ticks, got {played}").into());
    }
    publish.0.stop()?;
    let mut supervisor = Supervisor::new(Limits { pressure_min_bar: 0.3, pressure_max_bar: 9.0, ..Limits::default() })?;
    supervisor.begin_run();
    for (now, measured, command) in device.seen.iter().flatten() {
        std::hint::black_box(supervisor_stage(&mut supervisor, *now, measured, *command));
    }
    match supervisor.trip() {
        None => Ok(true),
        Some(trip) => Err(format!("{profile}: the supervisor tripped: {trip}").into()),
    }
}

#[inline(never)]
fn whole_run(
    bench: &mut Bench,
    device: &mut dyn Device,
    reference: &mut dyn Reference,
    publish: &mut dyn Publish,
) -> Result<u64, Box<dyn Error>> {
    let controller = bench.controller()?;
    bench.run(0, device, reference, &mut Asked(controller), publish)
}

/// A device; what it showed and was told is kept where there is a place for it.
struct Counted<D> {
    inner: D,
    seen: Option<Vec<(Tick, Measurement, Command)>>,
}

#[inline(never)]
fn device_stage_read(device: &mut impl Device, now: Tick) -> Result<Measurement, DeviceError> {
    device.read(now)
}

#[inline(never)]
fn device_stage_write(device: &mut impl Device, now: Tick, command: &Command) -> Result<(), DeviceError> {
    device.write(now, command)
}

impl<D: Device> Device for Counted<D> {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let measured = device_stage_read(&mut self.inner, now)?;
        if let Some(seen) = &mut self.seen {
            seen.push((now, measured, SafeState::default().command(Fixture::Free, 0)));
        }
        Ok(measured)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        // Behind the last tick the loop writes the safe state, which no check led to.
        if let Some((tick, _, given)) = self.seen.as_mut().and_then(|seen| seen.last_mut())
            && *tick == now
        {
            *given = *command;
        }
        device_stage_write(&mut self.inner, now, command)
    }
}

#[inline(never)]
fn supervisor_stage(supervisor: &mut Supervisor, now: Tick, measured: &Measurement, command: Command) -> Command {
    supervisor.check(now, Demand::None, measured);
    supervisor.release(now, command)
}

/// A profile that ends at a tick of ours.
struct Cut<R> {
    inner: R,
    last: u64,
}

#[inline(never)]
fn profile_stage(reference: &mut impl Reference, now: Tick, measured: &Measurement) -> Step {
    reference.step(now, measured)
}

impl<R: Reference> Reference for Cut<R> {
    fn step(&mut self, now: Tick, measured: &Measurement) -> Step {
        let step = profile_stage(&mut self.inner, now, measured);
        Step { last: step.last || now.index >= self.last, ..step }
    }
}

struct Asked<C>(C);

#[inline(never)]
fn controller_stage(controller: &mut impl Controller, now: Tick, measured: &Measurement, step: &Step) -> f64 {
    controller.control(now, measured, step)
}

impl<C: Controller> Controller for Asked<C> {
    fn begin_run(&mut self) {
        self.0.begin_run();
    }

    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64 {
        controller_stage(&mut self.0, now, measured, step)
    }
}

struct Handed<P>(P);

#[inline(never)]
fn handover_stage(publish: &mut impl Publish, sample: &Sample) -> Handover {
    publish.publish(sample)
}

impl<P: Publish> Publish for Handed<P> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        handover_stage(&mut self.0, sample)
    }

    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        self.0.publish_patiently(sample)
    }
}
