//! The commands, one file each, and the table of them.

mod blind;
mod campaign;
mod check;
mod compare;
mod completions;
mod confirm;
mod demo;
mod diagnose;
mod diagnose_plant;
mod doctor;
mod emulate;
mod export;
mod foxglove;
pub mod help;
mod identify;
mod import;
mod info;
mod latency;
mod link;
pub mod list;
mod ls;
mod man;
mod monitor;
mod profile;
mod record;
mod recover;
mod replay;
pub mod results;
mod results_json;
pub(crate) mod run;
mod serve;
mod service;
mod simulate;
mod stop;
mod time;

use crate::failure::Failure;
use crate::progress::Progress;
use clap::{Parser, Subcommand};
use list::{Entry, Example, Group, commands};
use rt_core::link::validate_instance;

/// The name of an instance, as an argument.
fn instance(word: &str) -> Result<String, String> {
    validate_instance(word).map(|()| word.to_owned()).map_err(|error| error.to_string())
}

/// A seed, as an argument.
fn seed(word: &str) -> Result<u64, String> {
    word.parse().map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}

/// Test bench for a hydraulic actuator with rotary elastic chambers: runs experiments, identifies the model, names what it
/// lacks.
#[derive(Debug, Parser)]
#[command(name = "bench", version)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

// A command more is a file, its `mod` above, and its lines here: help, completions, manual pages and the tests follow.
commands! {
    Demo(demo) in Run:
        "bench demo" => "the whole way on an emulated rig: experiments, model, effect, in about a minute",
        "bench demo --seed 7 --out demo7" => "another rig with another effect, into a folder of your choice";
    Run(run) in Run:
        "bench run square_h" => "a built-in profile on the emulated rig in virtual time",
        "bench run my.toml --realtime --rig my_rig.toml --out a.mcap" => "your own profile on your own rig at 1 kHz";
    Campaign(campaign) in Run:
        "bench campaign --plan-only" => "order, times, and what people will be asked",
        "bench campaign --out campaign" => "all experiments; called again it goes on where it was interrupted",
        "bench campaign --out campaign --realtime --rig my_rig.toml" => "the same on your own rig";
    Profile(profile) in Run:
        "bench profile list" => "what is built in",
        "bench profile show square_h" => "the text of one, to start an own one from",
        "bench profile check my.toml --rig my_rig.toml" => "steps, times, predicted peaks against the limits; nothing moves",
        "bench profile schema" => "for an editor that completes and checks profiles";
    Serve(serve) in Run:
        "bench serve" => "the service on the emulated rig, to be looked at in a browser",
        "bench serve my_rig.toml --control" => "on your own rig, and it takes orders from who has its token";
    Service(service) in Run:
        "bench service state" => "what the service does, its queue",
        "bench service arm" => "lets the queue run for ten minutes",
        "bench service queue square_h" => "puts a profile into the queue",
        "bench service emergency-stop" => "trips the run that goes on";
    Stop(stop) in Run:
        "bench stop" => "an orderly end of the run of another terminal",
        "bench stop --emergency" => "trips the supervisor";
    Confirm(confirm) in Run:
        "bench confirm --show" => "what the run waits for",
        "bench confirm" => "it is done",
        "bench confirm --volume-ml 1.25" => "it is done, and the measuring cylinder reads this";
    Monitor(monitor) in Watch:
        "bench monitor" => "the run of another process in this terminal",
        "bench monitor --control" => "with keys that stop it";
    Foxglove(foxglove) in Watch:
        "bench foxglove" => "for Foxglove, Lichtblick and PlotJuggler on this machine";
    Record(record) in Watch:
        "bench record --out a.mcap" => "the next run of this machine, by a process of its own",
        "bench record --out a.mcap --runs 0 --instance rig2" => "every run of the instance rig2 until Ctrl-C";
    Link(link) in Watch:
        "bench link serve" => "on the rig's machine, for a tunnel that ends there",
        "bench link serve --listen 192.168.1.7 --allow-remote --control" => "for a trusted network, with stop and confirm",
        "bench link connect 192.168.1.7" => "on another machine: the rig is instance `remote` there",
        "bench link connect 127.0.0.1:7447 --instance rig2" => "through a tunnel, under a name of your choice";
    Info(info) in Recordings:
        "bench info a.mcap" => "whether it is good, and what it holds",
        "bench info campaign --no-plot" => "each run of a campaign",
        "bench info a.mcap --page a.html" => "a page with zoomable figures",
        "bench info a.mcap --json" => "for a script";
    Ls(ls) in Recordings:
        "bench ls" => "what is below recordings/data",
        "bench ls campaigns --json" => "another folder, for a script";
    Export(export) in Recordings:
        "bench export a.mcap --out a.csv" => "the columns that a campaign needs",
        "bench export a.mcap --out a.mf4" => "ASAM MDF 4, with events and amplifier",
        "bench export a.mcap --out a.parquet --raw" => "every field of every sample",
        "bench export campaign --out campaign_csv" => "a campaign as a campaign of CSV files";
    Import(import) in Recordings:
        "bench import a.csv --protocol square-wave --role validate --plane horizontal --out a.mcap" => "a run of another program",
        "bench import campaign_csv --out campaign" => "a campaign of CSV files";
    Recover(recover) in Recordings:
        "bench recover a.mcap.part" => "after a crash: every complete chunk, in a.mcap";
    Replay(replay) in Recordings:
        "bench replay a.mcap b.mcap" => "does this program do with these inputs what that one did?";
    Identify(identify) in Model:
        "bench identify campaign" => "model and report into campaign/analysis",
        "bench identify campaign --torque third-order --out third" => "with eq. (1) to third order beside eq. (2)";
    Diagnose(diagnose) in Model:
        "bench diagnose campaign" => "model, and the effect behind what it does not explain",
        "bench diagnose campaign --auto --budget-min 10" => "with further runs on the emulated rig until the verdict stands",
        "bench diagnose --plant silverbox --data snls80mv.csv.gz" => "another plant";
    Simulate(simulate) in Model:
        "bench simulate model.toml run.csv --plane horizontal --out simulated.csv" => "the model alone with a run's voltage and valves",
        "bench simulate model.toml run.mcap --out with.csv --with-effects" => "with the effects that the file carries";
    Compare(compare) in Model:
        "bench compare a/analysis/model.toml b/analysis/model.toml" => "two campaigns of one rig; 3 where they disagree";
    Blind(blind) in Model:
        "bench blind --cases 20 --seed 3 --out blind.json" => "how often the verdict is right, on sealed campaigns";
    Check(check) in Machine:
        "bench check my_rig.toml" => "keys, units, signals, what it asks of its wires; touches nothing",
        "bench check my_rig.toml --json" => "for a script or an editor";
    Doctor(doctor) in Machine:
        "bench doctor" => "what of this machine speaks against real time",
        "bench doctor --serial /dev/ttyACM0 --can can0 --dir recordings/data" => "with the rig's own parts";
    Latency(latency) in Machine:
        "bench latency --seconds 120" => "the loop's lateness beside that of a bare loop",
        "bench latency --seconds 600 --cyclictest --json" => "with cyclictest too, for a script";
    Emulate(emulate) in Machine:
        "bench emulate --serial /tmp/pump --can vcan0 --write-rig /tmp/rig" => "the emulated rig behind a serial port and on CAN",
        "bench emulate --serial /tmp/pump --can unix:/tmp/can --rig my_rig.toml" => "the far end of your own rig file, without CAN in the kernel";
    Completions(completions) in Program:
        "bench completions bash" => "for ~/.local/share/bash-completion/completions/bench";
    Man(man) in Program:
        "bench man --out man/man1" => "then: man -M man bench-run";
}
