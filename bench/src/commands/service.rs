//! `bench service state|arm|disarm|queue|unqueue|stop|emergency-stop|acknowledge`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use rt_core::{ServiceAnswer, ServiceCommand, send_service_command};
use serde_json::json;
use std::time::Duration;

/// The service answers at once; a machine under load a little later.
const PATIENCE: Duration = Duration::from_secs(5);

/// Command the service of `bench serve` on this machine, over shared memory
///
/// Exit code 2 where it refuses, with the reason; 4 where no service answers.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
    /// Instance of the service
    #[arg(long, global = true, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
    /// For scripts
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// How it stands
    State,
    /// Start what is queued, for a time
    Arm {
        /// s
        #[arg(long, default_value_t = 600.0)]
        for_s: f64,
    },
    /// Start nothing more
    Disarm,
    /// Append a profile to the queue
    Queue {
        /// Its name
        profile: String,
        /// Seed of its random steps
        #[arg(long, default_value_t = 1, value_parser = super::seed)]
        seed: u64,
    },
    /// Take out of the queue
    Unqueue {
        /// As `queue` said it
        id: u64,
    },
    /// End the run orderly and hold the queue
    Stop,
    /// Trip
    EmergencyStop,
    /// The trip was seen, and the rig looked after
    Acknowledge,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let command = match &args.what {
        What::State => ServiceCommand::State,
        What::Arm { for_s } => ServiceCommand::Arm { for_s: *for_s },
        What::Disarm => ServiceCommand::Disarm,
        What::Queue { profile, seed } => ServiceCommand::Queue { profile: profile.clone(), seed: *seed },
        What::Unqueue { id } => ServiceCommand::Unqueue { id: *id },
        What::Stop => ServiceCommand::Stop,
        What::EmergencyStop => ServiceCommand::EmergencyStop,
        What::Acknowledge => ServiceCommand::Acknowledge,
    };
    let answer = send_service_command(&args.instance, &command, PATIENCE).map_err(|e| Failure::of(Kind::Device, &e))?;
    if !answer.done {
        return Err(Failure::new(Kind::Input, answer.text));
    }
    progress.result(&if args.json { as_json(&answer).to_string() } else { in_words(&answer) });
    Ok(())
}

fn as_json(answer: &ServiceAnswer) -> serde_json::Value {
    let ServiceAnswer { state, control, run, armed_left_s, queued, id, text, .. } = answer;
    json!({
        "state": state.as_str(),
        "control": control,
        "run": run.map(|(number, tick)| json!({"number": number, "tick": tick})),
        "armed_left_s": armed_left_s,
        "queued": queued,
        "id": id,
        "text": text,
    })
}

fn in_words(answer: &ServiceAnswer) -> String {
    let ServiceAnswer { state, control, run, armed_left_s, queued, id, text, .. } = answer;
    let mut words = vec![state.as_str().to_owned()];
    if !text.is_empty() {
        words.push(text.clone());
    }
    words.extend(armed_left_s.map(|left_s| format!("armed for {left_s:.0} s more")));
    words.extend(run.map(|(number, tick)| format!("run {number} at tick {tick}")));
    words.push(format!("{queued} queued"));
    if !control {
        words.push("read-only".to_owned());
    }
    words.extend(id.map(|id| format!("queued as {id}")));
    words.join(", ")
}
