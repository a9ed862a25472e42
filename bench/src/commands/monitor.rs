//! `bench monitor [--instance NAME] [--control]`, `bench monitor --once [--json]`

use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::monitor::listener::Listener;
use crate::monitor::screen;
use crate::monitor::snapshot;
use crate::monitor::state::State;
use crate::monitor::view::{Look, as_text};
use crate::progress::Progress;
use std::io::{IsTerminal, stdout};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// A snapshot follows the run for so long, so that it can say something of its timing.
const FOLLOWED: Duration = Duration::from_secs(1);
/// Between two looks of a snapshot.
const LOOK: Duration = Duration::from_millis(20);
/// Size of a snapshot in text.
const TEXT_SIZE: (u16, u16) = (100, 40);

/// Watch a run of another process in the terminal: values, curves, timing, what happened
///
/// It takes what it gets and never holds the run up. Keys: q quits, + and - change the time that is shown, Tab the curves. Without
/// colours where NO_COLOR is set.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Instance to watch
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
    /// Let the keys `s` stop the run and `E` trip it
    #[arg(long, conflicts_with = "once")]
    control: bool,
    /// Follow the run for a second, print one picture, and end; needs no terminal
    #[arg(long)]
    once: bool,
    /// The picture as JSON
    #[arg(long, requires = "once")]
    json: bool,
    /// With --once: wait so long for a sample, s; then the exit code is 4
    #[arg(long, default_value_t = 10.0, requires = "once", value_parser = seconds)]
    wait_s: f64,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let (switches, _driving) = interrupt::driving()?;
    if args.once {
        return once(args, &switches.stop, progress);
    }
    if !stdout().is_terminal() {
        let message = "expected a terminal on stdout, got none; over ssh use `ssh -t`, and for a script or a file \
                       `bench monitor --once`, with --json for programs";
        return Err(Failure::new(Kind::Input, message));
    }
    let colour = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    screen::show(&args.instance, Look::new(args.control, colour), &switches.stop)
}

/// A wait of a day at most.
fn seconds(text: &str) -> Result<f64, String> {
    let said = text.parse::<f64>().ok().filter(|seconds| (0.0..=86_400.0).contains(seconds));
    said.ok_or_else(|| format!("expected seconds from 0 to 86400, got {text:?}"))
}

fn once(args: &Args, end: &AtomicBool, progress: &Progress) -> Result<(), Failure> {
    let link = |e| Failure::of(Kind::Device, &e);
    let mut state = State::new(&args.instance);
    let mut listener = Listener::open(&args.instance).map_err(link)?;
    let patience = Duration::from_secs_f64(args.wait_s);
    let begin = Instant::now();
    let mut first: Option<Instant> = None;
    loop {
        listener.look(&mut state).map_err(link)?;
        let now = Instant::now();
        let over = match (&state.run, first) {
            (None, _) => now.duration_since(begin) >= patience,
            (Some(_), None) => {
                first = Some(now);
                false
            }
            (Some(run), Some(since)) => now.duration_since(since) >= FOLLOWED || run.newest.last(),
        };
        if over {
            break;
        }
        if end.load(Ordering::Relaxed) {
            return Err(Failure::new(Kind::Interrupted, "interrupted before there was anything to show"));
        }
        thread::sleep(LOOK);
    }
    let now = Instant::now();
    if args.json {
        progress.result(&snapshot::document(&state, now).to_string());
    } else {
        let (width, height) = TEXT_SIZE;
        let lines = as_text(&state, &Look::new(false, false), now, width, height);
        let lines = lines.map_err(|e| Failure::new(Kind::Internal, format!("the picture: {e}")))?;
        progress.result(&lines.join("\n"));
    }
    if state.run.is_none() {
        let message = format!(
            "instance {:?}: waited {} s for a sample, got none; does it run? `bench run --instance NAME` sets the name",
            args.instance, args.wait_s
        );
        return Err(Failure::new(Kind::Device, message));
    }
    Ok(())
}
