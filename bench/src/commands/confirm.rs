//! `bench confirm [--volume-ml X] [--instance NAME]`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use rt_core::{Amount, Answer, Confirmation, Refusal, RunCommand, Waiting, send_command};
use std::time::Duration;

/// The run answers within a tick; a machine under load a little later.
const PATIENCE: Duration = Duration::from_secs(5);

/// Tell a run of another process that what it asks people for is done
///
/// Exit code 2 where it was not taken: nothing is asked, the amount is missing, or another request is open by now.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// What the measuring cylinder reads, ml, where an amount is asked for
    #[arg(long, allow_negative_numbers = true)]
    volume_ml: Option<f64>,
    /// Only say what is asked for
    #[arg(long, conflicts_with = "volume_ml")]
    show: bool,
    /// Instance that runs
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let link = |e| Failure::of(Kind::Device, &e);
    // What is confirmed is what was asked a moment ago, and not what may follow it.
    let Answer { open, text, .. } = send_command(&args.instance, RunCommand::Look, PATIENCE).map_err(link)?;
    let wants = match open.map(|open| open.amount) {
        None => "nothing is asked for".to_owned(),
        Some(None) => format!("asked: {text}"),
        Some(Some(Amount::VolumeMl)) => format!("asked, with an amount in ml: {text}"),
    };
    if args.show {
        progress.result(&wants);
        return Ok(());
    }
    let confirmation = answering(open, args.volume_ml)?;
    let answer = send_command(&args.instance, RunCommand::Confirm(confirmation), PATIENCE).map_err(link)?;
    match answer.taken {
        Ok(tick) => {
            let tick = tick.map_or_else(String::new, |tick| format!(" at tick {tick}"));
            progress.result(&format!("confirmed{tick}: {text}"));
            Ok(())
        }
        Err(refusal @ (Refusal::ReadOnly | Refusal::Unreachable)) => {
            Err(Failure::new(Kind::Device, format!("not taken: {refusal}")))
        }
        Err(refusal) => Err(Failure::new(Kind::Input, format!("not taken: {refusal} ({wants})"))),
    }
}

/// The confirmation of what was seen to be open. Where nothing was, none is sent: by then it could meet a request that nobody has read.
///
/// # Errors
/// Nothing waits (2).
fn answering(open: Option<Waiting>, volume_ml: Option<f64>) -> Result<Confirmation, Failure> {
    match open {
        Some(Waiting { request, .. }) => Ok(Confirmation { request: Some(request), volume_ml }),
        None => {
            let message = format!("not sent: {}", Refusal::NothingWaits);
            Err(Failure::new(Kind::Input, message))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_request_that_was_seen_is_confirmed() {
        let open = Some(Waiting { request: 3, amount: None });
        assert_eq!(answering(open, None), Ok(Confirmation { request: Some(3), volume_ml: None }));
        let refused = answering(None, Some(1.0)).expect_err("whichever is open by then was not seen");
        assert_eq!(refused.exit_code(), 2);
        assert!(refused.message.contains("nothing waits"), "{refused}");
    }
}
