//! What one tick of the emulated rig costs: time, and instructions where valgrind is installed.
//!
//! ```text
//! cargo bench -p drivers --bench tick                  # nanoseconds of a tick, times real time
//! cargo bench -p drivers --bench tick -- --callgrind   # instructions of a tick, the same in every run
//! cargo bench -p drivers --bench tick -- square        # the cases whose name holds "square" alone; also with --callgrind
//! ```
//!
//! A tick is `read` and `write`, as the loop calls them. Each case plays like a protocol of the paper; the last ones with an effect.

use drivers::EmulatedRig;
use drivers::emulated::Settings;
use model::Parameters;
use model::effects::{EffectSet, find};
use model::rec::STATES;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rt_core::{Command, Device, Fixture, Measurement, Tick};
use std::process::{Command as Process, ExitCode, Stdio};
use std::time::Instant;

/// Ticks of one case.
const TICKS: u64 = 20_000;
/// Ticks of one case under callgrind, which is 50 times slower.
const COUNTED_TICKS: u64 = 4_000;
/// Argument by which the bench, as its own child under callgrind, plays one case.
const PLAY: &str = "--play";

const FREE: Command =
    Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };
const SHUT: Command = Command { brake_open: false, ..FREE };

/// Chooses the command of a tick from what was measured, as a profile does.
type Play = Box<dyn FnMut(u64, &Measurement) -> Command>;

struct Case {
    name: &'static str,
    start: Command,
    vertical: bool,
    effect: Option<&'static str>,
    play: fn() -> Play,
}

const CASES: &[Case] = &[
    Case { name: "square", start: FREE, vertical: false, effect: None, play: square },
    Case { name: "square-vertical", start: FREE, vertical: true, effect: None, play: square },
    Case { name: "random", start: FREE, vertical: false, effect: None, play: random },
    Case { name: "clamped", start: FREE, vertical: false, effect: None, play: clamped },
    Case { name: "volume", start: FILLED, vertical: false, effect: None, play: volume },
    Case { name: "bench", start: FREE, vertical: false, effect: None, play: bench },
    Case { name: "square+pump_lag", start: FREE, vertical: false, effect: Some("pump_lag"), play: square },
    Case { name: "square+line_inertance", start: FREE, vertical: false, effect: Some("line_inertance"), play: square },
    Case {
        name: "square+stribeck_friction",
        start: FREE,
        vertical: false,
        effect: Some("stribeck_friction"),
        play: square,
    },
    Case { name: "random+wall_creep", start: FREE, vertical: false, effect: Some("wall_creep"), play: random },
    Case { name: "random+pressure_drift", start: FREE, vertical: false, effect: Some("pressure_drift"), play: random },
];

const FILLED: Command =
    Command { fixture: Fixture::Filled { angle_deg: 12.0, pressure1_bar: 2.75, pressure2_bar: 2.75 }, ..SHUT };

/// Voltage to and fro between two angles.
fn square() -> Play {
    let mut sign = 1.0;
    Box::new(move |_, m| {
        if m.angle_deg * sign > 30.0 {
            sign = -sign;
        }
        Command { voltage_v: 21.6 * sign, ..FREE }
    })
}

/// Voltage steps of random size and length, with the brake closed or the bypass open at times.
fn random() -> Play {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut until, mut command) = (0, FREE);
    Box::new(move |tick, m| {
        if tick >= until {
            until = tick + rng.random_range(200..2500);
            let valves = rng.random_range(0.0..1.0);
            let sign = if m.angle_deg.abs() > 10.0 { -m.angle_deg.signum() } else { 1.0 };
            command = Command {
                voltage_v: if rng.random_bool(0.1) { 0.0 } else { sign * rng.random_range(1.0..23.0) },
                brake_open: valves > 0.12,
                bypass_open: valves > 0.88,
                ..FREE
            };
        }
        if m.angle_deg.abs() > 25.0 {
            command.voltage_v = -m.angle_deg.signum() * command.voltage_v.abs();
        }
        command
    })
}

/// A lever clamped here and there while the pump fills one chamber, the brake closing in between.
fn clamped() -> Play {
    Box::new(|tick, _| {
        let angle_deg = [0.0, 15.0, -20.0][(tick / 4000) as usize % 3];
        let pumping = (tick / 700) % 2 == 0;
        Command { voltage_v: 3.0, brake_open: pumping, fixture: Fixture::Clamped { angle_deg }, ..FREE }
    })
}

/// A sweep with the chambers shut off, then oil released, again and again.
fn volume() -> Play {
    Box::new(|tick, _| {
        let phase = tick % 2500;
        let fixture = match phase {
            0..100 => return FILLED,
            100..1500 => Fixture::Driven { angle_deg: 12.0 + 2.0 * (phase as f64 * 2e-3).sin() },
            _ => Fixture::Released { angle_deg: 12.0, flow_ml_s: if (phase / 300) % 2 == 0 { 3.3 } else { 0.0 } },
        };
        Command { fixture, segment: (phase / 500) as u32, ..SHUT }
    })
}

/// The pump's map: a second at each voltage and load.
fn bench() -> Play {
    Box::new(|tick, _| {
        let point = tick / 1000;
        let fixture = Fixture::PumpBench { pressure1_bar: 1.5 + (point % 4) as f64, pressure2_bar: 1.5 };
        let voltage_v = [24.0, 12.0, 2.0, -8.0, -20.0][point as usize % 5];
        Command { voltage_v, fixture, segment: point as u32, ..FREE }
    })
}

impl Case {
    fn rig(&self) -> EmulatedRig {
        let effect = self.effect.map(|id| find(id).expect("an effect of the library"));
        let effects = effect.map(|e| (e, e.header().parameters.iter().map(|p| p.typical).collect()));
        let settings = Settings { start: self.start, vertical: self.vertical, seed: 7, ..Settings::default() };
        EmulatedRig::new(&Parameters::example(), EffectSet::new(STATES, effects), settings).expect("a rig")
    }

    /// Plays `ticks` ticks; `after` is called behind each.
    fn play(&self, ticks: u64, mut after: impl FnMut()) {
        let (mut rig, mut play) = (self.rig(), (self.play)());
        let mut command = self.start;
        for k in 0..ticks {
            let measured = measured_tick(&mut rig, k, &command);
            command = between_ticks(&mut play, k, &measured);
            after();
        }
    }
}

/// The tick that is measured: the command was chosen after the last one.
#[inline(never)]
fn measured_tick(rig: &mut EmulatedRig, k: u64, command: &Command) -> Measurement {
    let measured = rig.read(Tick::at(k)).expect("the rig reads");
    rig.write(Tick::at(k), command).expect("the rig writes");
    measured
}

/// What the tick is parted from.
#[inline(never)]
fn between_ticks(play: &mut Play, k: u64, measured: &Measurement) -> Command {
    play(k, measured)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if let [play, name] = arguments.as_slice()
        && play == PLAY
        && let Some(case) = CASES.iter().find(|c| c.name == name)
    {
        case.play(COUNTED_TICKS, || ());
        return ExitCode::SUCCESS;
    }
    let (options, names): (Vec<&String>, Vec<&String>) = arguments.iter().partition(|a| a.starts_with("--"));
    let chosen = || CASES.iter().filter(|c| names.is_empty() || names.iter().any(|n| c.name.contains(n.as_str())));
    match options.as_slice() {
        [] => times(chosen()),
        [option] if *option == "--callgrind" => match instructions(chosen()) {
            Ok(()) => {}
            Err(why) => {
                eprintln!("{why}");
                return ExitCode::from(1);
            }
        },
        other => {
            eprintln!("expected --callgrind or nothing, and names of cases, got {other:?}");
            return ExitCode::from(2);
        }
    }
    ExitCode::SUCCESS
}

/// Nanoseconds of a tick and speed against real time, the latter without reading the clock in between.
fn times<'a>(cases: impl Iterator<Item = &'a Case>) {
    println!("{:28} {:>10} {:>10} {:>10} {:>16}", "case", "median ns", "p99 ns", "max ns", "times real time");
    for case in cases {
        let start = Instant::now();
        case.play(TICKS, || ());
        let speed = TICKS as f64 * 1e-3 / start.elapsed().as_secs_f64();
        let mut ns = Vec::with_capacity(TICKS as usize);
        let mut last = Instant::now();
        case.play(TICKS, || {
            let now = Instant::now();
            ns.push((now - last).as_nanos() as u64);
            last = now;
        });
        let [median, p99, max] = percentiles(&mut ns[1..]);
        println!("{:28} {median:>10} {p99:>10} {max:>10} {speed:>16.0}", case.name);
    }
}

/// Instructions of every tick as callgrind counts them: it dumps its counters at the end of each.
fn instructions<'a>(cases: impl Iterator<Item = &'a Case>) -> Result<(), String> {
    let this = std::env::current_exe().map_err(|e| format!("the bench's own path: {e}"))?;
    println!("{:28} {:>10} {:>10} {:>10} {:>10}   instructions of a tick", "case", "mean", "median", "p99", "max");
    for case in cases {
        let dir = std::env::temp_dir().join(format!("tick-{}-{}", std::process::id(), case.name));
        std::fs::create_dir_all(&dir).map_err(|e| format!("{}: {e}", dir.display()))?;
        let done = Process::new("valgrind")
            .args(["--tool=callgrind", "--dump-before=*measured_tick*", "--dump-before=*between_ticks*"])
            .arg(format!("--callgrind-out-file={}", dir.join("out").display()))
            .arg(&this)
            .args([PLAY, case.name])
            .stderr(Stdio::null())
            .status()
            .map_err(|e| format!("valgrind: {e}: expected it on this machine (apt-get install valgrind)"))?;
        if !done.success() {
            return Err(format!("{}: valgrind ended with {done}", case.name));
        }
        let mut counts = Vec::new();
        for entry in std::fs::read_dir(&dir).map_err(|e| format!("{}: {e}", dir.display()))? {
            let path = entry.map_err(|e| e.to_string())?.path();
            let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
            // A dump is made where one function begins: its counts are those of the other one.
            let is_tick = text.lines().any(|l| l.starts_with("desc: Trigger") && l.contains("between_ticks"));
            let total = text.lines().find_map(|line| line.strip_prefix("summary: ")).filter(|_| is_tick);
            counts.extend(total.and_then(|n| n.trim().parse::<u64>().ok()));
        }
        std::fs::remove_dir_all(&dir).map_err(|e| format!("{}: {e}", dir.display()))?;
        if counts.len() as u64 != COUNTED_TICKS {
            return Err(format!("{}: expected {COUNTED_TICKS} counts, got {}", case.name, counts.len()));
        }
        let mean = counts.iter().sum::<u64>() / COUNTED_TICKS;
        let [median, p99, max] = percentiles(&mut counts);
        println!("{:28} {mean:>10} {median:>10} {p99:>10} {max:>10}", case.name);
    }
    Ok(())
}

/// Median, 99th percentile, largest.
fn percentiles(values: &mut [u64]) -> [u64; 3] {
    values.sort_unstable();
    [values[values.len() / 2], values[values.len() * 99 / 100], values[values.len() - 1]]
}
