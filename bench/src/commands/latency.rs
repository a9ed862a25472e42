//! `bench latency --seconds N [--json]`

use crate::failure::Failure;
use crate::latency::measurement::{Settings, measure};
use crate::latency::output::{Summary, lines};
use crate::latency::slices::Plan;
use crate::latency::subscriber;
use crate::progress::Progress;
use rt_core::system::Request;

/// Measure the loop's timing beside a loop that does nothing else
///
/// Slices take turns: the real loop on the emulated rig, with 0, 1 and 10 subscribers (one of them stalled, one killed), and a
/// bare loop of the same thread; both with the same priority, latency request and rule for skipping.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Time of all slices together, s
    #[arg(long, value_parser = seconds, required_unless_present = "subscribe")]
    seconds: Option<f64>,
    /// Longest slice, s; a short measurement has shorter ones
    #[arg(long, value_parser = seconds, default_value = "5")]
    slice_s: f64,
    /// Figures as one JSON object
    #[arg(long)]
    json: bool,
    /// The program cyclictest takes turns too (package rt-tests)
    #[arg(long)]
    cyclictest: bool,
    /// Be a subscriber of this instance; for the program itself
    #[arg(long, hide = true, exclusive = true, value_name = "INSTANCE")]
    subscribe: Option<String>,
}

/// Longest time that is taken for one, s: a day.
const LONGEST_S: f64 = 86_400.0;

fn seconds(word: &str) -> Result<f64, String> {
    let seconds = word.parse::<f64>().map_err(|_| "expected seconds as a number".to_owned())?;
    if seconds > 0.0 && seconds <= LONGEST_S {
        Ok(seconds)
    } else {
        Err(format!("expected more than 0 and at most {LONGEST_S} s"))
    }
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    if let Some(instance) = &args.subscribe {
        return subscriber::follow(instance);
    }
    let plan = Plan::new(args.seconds.unwrap_or(LONGEST_S), args.slice_s, args.cyclictest);
    let measured = measure(&Settings { plan, request: Request::default() }, progress)?;
    if args.json {
        progress.result(&Summary::of(&measured).json());
    } else {
        lines(&measured).iter().for_each(|line| progress.result(line));
    }
    Ok(())
}
