//! `bench run PROFILE [--realtime]`

use super::record::check_name;
use super::time::TimeArgs;
use crate::devices::Devices;
use crate::dry_run::predict;
use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::keyboard::{self, Keyboard};
use crate::operator;
use crate::over::{OverAtEnd, keep_open};
use crate::progress::Progress;
use crate::recorder::{OnFull, first_free};
use crate::rig_file::{DeviceSpec, Rig};
use crate::runner::{Finished, Plan, Runner};
use crate::setup::Knowledge;
use crate::timing::Timing;
use profiles::{BUILTIN, Context, EXAMPLES, Script};
use rt_core::{CommandServer, Ended, LinkError, Switches};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use rustix::thread::set_name;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// Instance on which a run is published unless another is named.
pub const INSTANCE: &str = "bench";

/// Said where the rig is not named and somebody may take it for a real one.
pub(super) const EMULATED: &str = "on the emulated rig (no --rig)";

/// Where recordings go unless another place is named.
pub const RECORDINGS: &str = "recordings/data";

/// Run one profile and record it
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Profile: a file, or the name of a built-in one (square_h, random_a, ...)
    profile: String,
    #[command(flatten)]
    time: TimeArgs,
    /// Rig file [default: the emulated rig]
    #[arg(long)]
    rig: Option<PathBuf>,
    /// Recording to write, .mcap [default: a new one under recordings/data]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Name under which the samples are published
    #[arg(long, default_value = INSTANCE, value_parser = super::instance)]
    instance: String,
    /// When the disk runs full
    #[arg(long, value_enum, default_value = "go-on")]
    on_full: OnFull,
    /// Seed of the profile's random steps and of the emulated sensors
    #[arg(long, default_value_t = 1, value_parser = super::seed)]
    seed: u64,
    /// Nobody is at the rig: a profile that would need people is refused before anything moves
    #[arg(long)]
    no_operator: bool,
    /// Skip the dry run on the rig's model, which comes before a run on wires
    #[arg(long)]
    no_dry_run: bool,
    /// Print how the run ended as one JSON object
    #[arg(long)]
    json: bool,
    /// Number that the samples carry
    #[arg(long, default_value_t = 0, hide = true)]
    run_number: u32,
    /// Process that started this one: when it ends, for whatever reason, the run is stopped as by SIGTERM
    #[arg(long, hide = true)]
    with_parent: Option<i32>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    if let Some(parent) = args.with_parent {
        end_with(parent)?;
    }
    let stdout = progress;
    let progress = &progress.beside(args.json);
    let rig = Rig::read(args.rig.as_deref())?;
    let script = profile(&args.profile)?;
    let path = args.out.clone().unwrap_or_else(|| free_file(Path::new(RECORDINGS), &script.name));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|error| {
            Failure::new(
                Kind::Input,
                format!(
                    "{}: expected a folder for the recording, got \"{error}\"; choose another --out",
                    folder.display()
                ),
            )
        })?;
    }
    // Before people are asked for anything, and before the amplifier is armed.
    check_name(&path)?;
    if args.time.realtime && args.rig.is_none() {
        progress.say(EMULATED);
    }
    if !args.no_dry_run {
        dry_run(&script, &rig, args.seed, progress)?;
    }
    let mode = args.time.mode();
    let notes = [("device".to_owned(), rig.name.clone()), ("instance".to_owned(), args.instance.clone())].into();
    let (switches, _driving) = interrupt::driving()?;
    let mut runner = Runner::open(&args.instance, rig.limits, mode.clone(), args.on_full, progress)?;
    runner.describe(rig.record()?);
    runner.number_from(args.run_number);
    let mut devices = Devices::open(&rig.device, rig.limits.safe_state, &mode, runner.journals())?;
    let context = Context { u_max_v: rig.facts.u_max_v, seed: args.seed, hands: devices.hands() };
    operator::require(&script, &context, args.no_operator, !args.time.realtime)?;
    runner.operated_by(context.hands);
    let plan = Plan {
        script: &script,
        seed: args.seed,
        u_max_v: rig.facts.u_max_v,
        knowledge: &rig.knowledge,
        path: &path,
        notes: &notes,
    };
    let finished = listening(&args.instance, switches, progress, || {
        runner.ask_to_prepare(&script, switches, progress)?;
        let mut device = devices.prepare(&script, args.seed, 0, rig.limits.safe_state, runner.journals(), switches)?;
        runner.run(&plan, &mut *device, switches, progress)
    })?;
    drop(devices);
    let closed = runner.finish();
    progress.result(&finished.report.to_string());
    if args.time.realtime {
        // A remark: where it can't be had, the certificate says what the recording lacks.
        match Timing::of_recording(&path) {
            Ok(timing) => progress.result(&timing.to_string()),
            Err(failure) => progress.say(&format!("no timing of this run: {failure}")),
        }
    }
    progress.result(&format!("recording: {}", path.display()));
    if let Some(first) = finished.incidents.first() {
        progress.result(&format!("incidents: {} files, the first {}", finished.incidents.len(), first.display()));
    }
    let told = if args.json { stdout.json(&Document::of(&script.name, &path, &finished)) } else { Ok(()) };
    // The exit code is of what happened to the rig, then of what was recorded, then of what came after the run.
    finished.judge(&script.name)?;
    closed.and(told)
}

/// What `--json` prints.
#[derive(Serialize)]
struct Document<'a> {
    name: &'a str,
    /// `completed`, `tripped`, `stopped` or `aborted`.
    outcome: &'static str,
    /// The same in words.
    text: String,
    recording: String,
    /// Whether the recording holds every sample.
    lossless: bool,
    samples: u64,
    expected: u64,
    /// First and last number of each gap.
    gaps: &'a [(u64, u64)],
    ticks: u64,
    skipped: u64,
    overruns: u64,
    /// 0 in virtual time.
    lateness_max_us: f64,
    trip: Option<String>,
    incidents: Vec<String>,
}

impl<'a> Document<'a> {
    fn of(name: &'a str, path: &Path, Finished { report, certificate, incidents, .. }: &'a Finished) -> Self {
        Document {
            name,
            outcome: match report.ended {
                Ended::Completed => "completed",
                Ended::Tripped => "tripped",
                Ended::Stopped => "stopped",
                Ended::Aborted => "aborted",
            },
            text: report.to_string(),
            recording: path.display().to_string(),
            lossless: certificate.is_lossless(),
            samples: certificate.received,
            expected: certificate.expected,
            gaps: &certificate.gaps,
            ticks: report.statistics.ticks,
            skipped: report.statistics.skipped,
            overruns: report.statistics.overruns,
            lateness_max_us: report.statistics.lateness_max_ns as f64 * 1e-3,
            trip: report.trip.as_ref().map(ToString::to_string),
            incidents: incidents.iter().map(|file| file.display().to_string()).collect(),
        }
    }
}

/// What the run would do to a rig on wires, by its own model, before anything moves.
///
/// # Errors
/// It would trip, or fail (3).
pub(super) fn dry_run(script: &Script, rig: &Rig, seed: u64, progress: &Progress) -> Result<(), Failure> {
    let DeviceSpec::Wired(_) = &rig.device else { return Ok(()) };
    let Knowledge::Model(model, _) = &rig.knowledge else {
        progress.say("no dry run: the rig file names no model ([controller] model), so that nothing is predicted");
        return Ok(());
    };
    let prediction = predict(script, rig, model, seed)?;
    prediction.judge(script).map_err(|mut failure| {
        failure.message.push_str("; --no-dry-run runs it all the same");
        failure
    })?;
    let least = prediction.peaks.iter().filter_map(|peak| Some((prediction.margin(peak)?, peak.channel.name())));
    if let Some((margin, name)) = least.min_by(|a, b| a.0.total_cmp(&b.0)) {
        let duration_s = prediction.duration_s();
        let percent = 100.0 * margin;
        progress.say(&format!(
            "dry run: {duration_s:.1} s, within all limits; nearest is the {name}'s, {percent:.0} % left"
        ));
    }
    prediction.remarks().iter().for_each(|remark| progress.say(&format!("dry run: {remark}")));
    Ok(())
}

/// Does the work while the terminal's keys and commands from other processes are heard.
pub(super) fn listening<T>(
    instance: &str,
    switches: &'static Switches,
    progress: &Progress,
    work: impl FnOnce() -> Result<T, Failure>,
) -> Result<T, Failure> {
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _over = OverAtEnd(&over);
        scope.spawn(|| {
            let serve =
                |server: &mut CommandServer| server.serve(Duration::from_millis(50), switches, &operator::open_request);
            let say = |error: &LinkError| {
                progress
                    .say(&format!("`bench stop` and `bench confirm` can't reach this run, it is tried again: {error}"));
            };
            keep_open(&over, || CommandServer::open(instance), serve, say);
        });
        let keys = Keyboard::watch(switches, progress);
        if keys.is_some() {
            progress.say(keyboard::HELP);
        }
        work()
    })
}

/// A profile by its file, or by the name of a built-in one or of an example. A file that is there comes first.
pub(crate) fn profile(name: &str) -> Result<Script, Failure> {
    if Path::new(name).is_file() {
        return Script::read(Path::new(name)).map_err(|e| Failure::of(Kind::Input, &e));
    }
    let known = || BUILTIN.iter().chain(EXAMPLES);
    let named = |file: &str| file == name || file.strip_suffix(".toml") == Some(name);
    if let Some((file, text)) = known().find(|(file, _)| named(file)) {
        return Script::parse(text, file).map_err(|e| Failure::of(Kind::Internal, &e));
    }
    Script::read(Path::new(name)).map_err(|error| {
        let mut failure = Failure::of(Kind::Input, &error);
        if Path::new(name).is_dir() {
            failure.message.push_str("; name one of the scripts in this folder");
        }
        if !Path::new(name).exists() {
            let names: Vec<&str> = known().map(|(file, _)| file.trim_end_matches(".toml")).collect();
            failure.message.push_str(&format!("; built in are {}", names.join(", ")));
        }
        failure
    })
}

/// A file of this folder that is not there yet: a measurement is never overwritten.
pub(crate) fn free_file(folder: &Path, name: &str) -> PathBuf {
    let now = jiff::Timestamp::now().strftime("%Y-%m-%dT%H%M%SZ").to_string();
    let file = |n: u32| {
        let again = if n > 1 { format!("-{n}") } else { String::new() };
        folder.join(format!("{now}_{name}{again}.mcap"))
    };
    first_free((1..).map(file))
}

/// From here on the end of the parent's thread that started this process stops the run.
fn end_with(parent: i32) -> Result<(), Failure> {
    let failed = |what: String| Failure::new(Kind::Internal, format!("--with-parent {parent}: {what}"));
    // Begun through a link of the system, it would bear the link's name. A name is no reason to fail.
    let _ = set_name(c"bench");
    // Asked for by this process itself: what a parent asks for is forgotten when a program with capabilities is begun.
    set_parent_process_death_signal(Some(Signal::TERM))
        .map_err(|error| failed(format!("expected a signal at its end, got \"{error}\"")))?;
    // A parent that ended before that sends none.
    if getppid().map(|pid| pid.as_raw_nonzero().get()) != Some(parent) {
        return Err(failed("expected this to be the parent, and it is gone; nothing was begun".to_owned()));
    }
    Ok(())
}
