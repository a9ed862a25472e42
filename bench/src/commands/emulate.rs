//! `bench emulate --serial PTY --can vcan0`

use crate::emulation::plant_factory;
use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::progress::Progress;
use crate::rig_file::{DeviceSpec, Rig, WIRED};
use drivers::can::Interface;
use drivers::dbc::Database;
use drivers::journal::{JournalReader, Severity};
use drivers::nodes::{Emulator, EmulatorSettings, Statistics};
use drivers::wired::{AmplifierSettings, CanSettings};
use model::{ModelFile, Parameters};
use rt_core::SafeState;
use rt_core::system::{Request, prepare_thread};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::time::Duration;

/// The database of the built-in wired rig.
const DATABASE: &str = include_str!("../../rigs/rec.dbc");
const DATABASE_FILE: &str = "rec.dbc";
/// What happened is told so often.
const TELL_EVERY: Duration = Duration::from_millis(50);
/// Without a bench, that is said again and again no more often than this.
const LONGEST_WAIT: Duration = Duration::from_secs(2);

/// Put the emulated rig on the wires: an amplifier behind a pty, valves and sensors on CAN, until Ctrl-C
///
/// The same drivers that run a real rig then run against it. What is where on the bus is read from the rig file from the other end.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Name for the amplifier's port: a link to a pty that is made here
    #[arg(long, value_name = "PTY")]
    serial: PathBuf,
    /// Bus of the nodes: vcan0, can0, or unix:PATH for a socket in its place, on machines without CAN
    #[arg(long, value_name = "INTERFACE")]
    can: String,
    /// Rig file whose [amplifier], [can] and [safe_state] are read [default: the built-in wired rig]
    #[arg(long)]
    rig: Option<PathBuf>,
    /// Plant with its effects [default: the example of the campaign format]
    #[arg(long)]
    model: Option<PathBuf>,
    /// What the amplifier speaks, vesc or tmcl [default: the rig file's]
    #[arg(long)]
    protocol: Option<String>,
    /// Bits a second at which the amplifier listens [default: the rig file's]
    #[arg(long)]
    baud: Option<u32>,
    /// Seed of the sensors' noise; run k of a session has that of run k with `bench run --seed`
    #[arg(long, default_value_t = 1, value_parser = super::seed)]
    seed: u64,
    /// Priority of the rig's thread, SCHED_FIFO, if the system grants it: below the loop's (80) and its I/O threads' (75)
    #[arg(long, default_value_t = 70, value_parser = clap::value_parser!(u8).range(1..=98))]
    priority: u8,
    /// Without a fresh command for so long, ms, the valves go to their safe state by themselves
    #[arg(long, value_name = "MS", default_value_t = 50.0)]
    node_timeout_ms: f64,
    /// Without a sign of life for so long, ms, the amplifier goes to 0 V by itself
    #[arg(long, value_name = "MS", default_value_t = 100.0)]
    amplifier_timeout_ms: f64,
    /// New folder for rig.toml and rec.dbc, with which the bench reaches this rig
    #[arg(long, value_name = "FOLDER", conflicts_with = "rig")]
    write_rig: Option<PathBuf>,
}

/// The wires of a rig file.
#[derive(Deserialize)]
struct Wires {
    amplifier: AmplifierSettings,
    can: CanSettings,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let (settings, database) = settings(args)?;
    let plant = match &args.model {
        Some(path) => ModelFile::read(path).map_err(|e| Failure::of(Kind::Input, &e))?,
        None => ModelFile::plain(Parameters::example()),
    };
    let factory = plant_factory(plant, args.seed)?;
    let mut journals = JournalReader::default();
    let request = Request { priority: args.priority, ..Request::default() };
    let (granted, grants) = mpsc::channel();
    // Nobody listens to this any more where the rig could not be started.
    let prepare = move || drop(granted.send(prepare_thread(&request)));
    // Before the wires exist: who sees them may stop this at once.
    let (switches, _driving) = interrupt::driving()?;
    let emulator = Emulator::start(&settings, &database, factory, prepare, journals.journal("rig"))
        .map_err(|error| Failure::of(if error.is_configuration() { Kind::Input } else { Kind::Device }, &error))?;
    for grant in grants.recv_timeout(LONGEST_WAIT).unwrap_or_default().iter().filter(|grant| grant.is_refused()) {
        progress.say(&format!("without real time ({}): answers may come late", grant.what));
    }
    say_where(args, &settings, &emulator, progress)?;
    while !switches.stop.load(Ordering::Relaxed) && emulator.is_serving() {
        std::thread::sleep(TELL_EVERY);
        tell(&mut journals, progress);
    }
    let served = emulator.is_serving();
    let statistics = emulator.statistics();
    drop(emulator);
    tell(&mut journals, progress);
    progress.result(&summary(&statistics));
    if served {
        return Ok(());
    }
    Err(Failure::new(Kind::Device, "the emulated rig can't go on; the last line above says why"))
}

/// The other end of the rig file's wires.
fn settings(args: &Args) -> Result<(EmulatorSettings, Database), Failure> {
    let input = |error: &dyn std::error::Error| Failure::of(Kind::Input, error);
    let interface: Interface = args.can.parse().map_err(|e| input(&e))?;
    let (mut amplifier, can, safe_state, database) = match &args.rig {
        Some(path) => {
            let rig = Rig::read(Some(path))?;
            let DeviceSpec::Wired(wires) = rig.device else {
                let file = path.display();
                let message =
                    format!("{file}: expected a rig on wires ([device] kind = \"wired\"), got an emulated one");
                return Err(Failure::new(Kind::Input, message));
            };
            let database = Database::read(&wires.can.dbc).map_err(|e| input(&e))?;
            (wires.amplifier, wires.can, rig.limits.safe_state, database)
        }
        None => {
            let wires: Wires = toml::from_str(WIRED).map_err(|e| Failure::of(Kind::Internal, &e))?;
            let database = Database::parse(DATABASE, DATABASE_FILE).map_err(|e| Failure::of(Kind::Internal, &e))?;
            (wires.amplifier, wires.can, SafeState::default(), database)
        }
    };
    if let Some(protocol) = &args.protocol {
        amplifier.protocol.clone_from(protocol);
    }
    amplifier.baud = args.baud.unwrap_or(amplifier.baud);
    let settings = EmulatorSettings {
        link: Some(args.serial.clone()),
        node_timeout_ms: args.node_timeout_ms,
        amplifier_timeout_ms: args.amplifier_timeout_ms,
        safe_state,
        ..EmulatorSettings::new(amplifier, can, interface)
    };
    Ok((settings, database))
}

/// Where the rig is, and how to run against it.
fn say_where(
    args: &Args,
    settings: &EmulatorSettings,
    emulator: &Emulator,
    progress: &Progress,
) -> Result<(), Failure> {
    let AmplifierSettings { protocol, baud, .. } = &settings.amplifier;
    let port = std::path::absolute(emulator.port()).unwrap_or_else(|_| emulator.port().to_owned());
    let interface = match &settings.interface {
        Interface::Unix(path) => {
            Interface::Unix(std::path::absolute(path).unwrap_or_else(|_| path.clone())).to_string()
        }
        interface => interface.to_string(),
    };
    progress.result(&format!("amplifier: {} ({protocol}, {baud} baud)", port.display()));
    progress.result(&format!("valves, sensors, fixture: {interface}"));
    match (&args.write_rig, &args.rig) {
        (Some(folder), _) => {
            let file = write_rig(folder, settings, &port, &interface)?;
            progress.result(&format!("run against it: bench run square_h --realtime --rig {}", file.display()));
        }
        (None, Some(rig)) if settings.can.interface == interface => {
            progress.result(&format!("run against it: bench run square_h --realtime --rig {}", rig.display()));
        }
        (None, rig) => {
            let rig =
                rig.as_ref().map_or("a copy of bench/rigs/wired.toml".to_owned(), |rig| rig.display().to_string());
            let port = port.display();
            progress.result(&format!(
                "run against it: bench run square_h --realtime --rig RIG.toml, where RIG.toml is {rig} with [amplifier] \
                 port = \"{port}\", [can] interface = \"{interface}\" (--write-rig FOLDER makes one)"
            ));
        }
    }
    Ok(())
}

/// The built-in wired rig at these wires, with its database beside it.
fn write_rig(folder: &Path, settings: &EmulatorSettings, port: &Path, interface: &str) -> Result<PathBuf, Failure> {
    let AmplifierSettings { protocol, baud, .. } = &settings.amplifier;
    let changed = [
        ("protocol = ", format!("{protocol:?}")),
        ("port = ", format!("{:?}", port.display().to_string())),
        ("baud = ", baud.to_string()),
        ("interface = ", format!("{interface:?}")),
    ];
    let text: String = WIRED
        .lines()
        .map(|line| match changed.iter().find(|(key, _)| line.starts_with(key)) {
            Some((key, value)) => format!("{key}{value}\n"),
            None => format!("{line}\n"),
        })
        .collect();
    let failure = |error: std::io::Error| {
        let message = format!(
            "{}: expected a new folder to write, got \"{error}\"; choose another --write-rig",
            folder.display()
        );
        Failure::new(Kind::Input, message)
    };
    std::fs::create_dir_all(folder).map_err(failure)?;
    let file = folder.join("rig.toml");
    // What somebody has calibrated is not overwritten.
    let new = |path: &Path, text: &str| {
        use std::io::Write;
        std::fs::File::create_new(path)?.write_all(text.as_bytes())
    };
    new(&file, &text).and_then(|()| new(&folder.join(DATABASE_FILE), DATABASE)).map_err(failure)?;
    Ok(file)
}

fn tell(journals: &mut JournalReader, progress: &Progress) {
    for entry in journals.read() {
        let severity = match entry.severity {
            Severity::Info => "",
            Severity::Warning => "warning: ",
            Severity::Error => "error: ",
        };
        progress.say(&format!("{severity}{}", entry.text));
    }
}

fn summary(statistics: &Statistics) -> String {
    let Statistics { syncs, repeated, passed_over, commands, late, refused, .. } = *statistics;
    let Statistics { node_timeouts, amplifier_timeouts, preparations, unsent, .. } = *statistics;
    format!(
        "{preparations} rigs prepared, {syncs} command frames ({repeated} not fresh, {passed_over} ticks passed over), {commands} commands of \
         the amplifier ({late} ticks without one in time), {refused} refused, {node_timeouts} time-outs of the nodes, {amplifier_timeouts} of \
         the amplifier, {unsent} frames unsent"
    )
}
