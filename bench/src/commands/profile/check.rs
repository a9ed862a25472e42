//! `bench profile check PROFILE... [--rig RIG] [--model MODEL] [--json]`

use super::outlook::Outlook;
use super::words;
use crate::commands::run::profile;
use crate::devices::hands_of;
use crate::dry_run::{model_of, predict, served};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::rig_file::Rig;
use model::ModelFile;
use profiles::Context;
use serde::Serialize;
use std::path::PathBuf;

/// Check profiles: what they would do, how long it takes, and what a dry run on the model predicts
///
/// Nothing moves: the dry run plays a profile on the emulated rig with the identified model, without noise, and says where the supervisor
/// would trip. Exit code 2: a profile is wrong or does not fit the rig; 3: the run would trip.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Profiles: files, or names of built-in ones
    #[arg(required = true)]
    profiles: Vec<String>,
    /// Rig file [default: the emulated rig]
    #[arg(long)]
    rig: Option<PathBuf>,
    /// Model to predict with, model.toml [default: the emulated rig's plant, or the rig file's controller model]
    #[arg(long)]
    model: Option<PathBuf>,
    /// Seed of the profile's random steps; the run must use the same
    #[arg(long, default_value_t = 1, value_parser = crate::commands::seed)]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Document {
    /// Whether all of them may run.
    fits: bool,
    profiles: Vec<Checked>,
}

#[derive(Serialize)]
struct Checked {
    /// As it was named.
    profile: String,
    /// Whether it may run.
    fits: bool,
    /// Why not.
    #[serde(skip_serializing_if = "Option::is_none")]
    message: Option<String>,
    #[serde(flatten)]
    outlook: Option<Outlook>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let rig = Rig::read(args.rig.as_deref())?;
    let given = args.model.as_deref().map(ModelFile::read).transpose().map_err(|e| Failure::of(Kind::Input, &e))?;
    let mut failures = Vec::new();
    let mut checked = Vec::new();
    for name in &args.profiles {
        let (outlook, failure) = match check(name, &rig, given.as_ref(), args) {
            Ok((outlook, failure)) => (Some(outlook), failure),
            Err(failure) => (None, Some(failure)),
        };
        if !args.json {
            if !checked.is_empty() {
                progress.result("");
            }
            outlook.iter().flat_map(words::text).for_each(|line| progress.result(&line));
        }
        let message = failure.as_ref().map(|failure| failure.message.clone());
        failures.extend(failure);
        checked.push(Checked { profile: name.clone(), fits: message.is_none(), message, outlook });
    }
    if args.json {
        let document = Document { fits: failures.is_empty(), profiles: checked };
        let text = serde_json::to_string_pretty(&document).map_err(|e| Failure::of(Kind::Internal, &e))?;
        progress.result(&text);
    }
    // What is wrong comes before what would trip.
    match failures.iter().map(|failure| failure.kind).min_by_key(|kind| *kind as u8) {
        None => Ok(()),
        Some(kind) => {
            let messages: Vec<String> = failures.into_iter().map(|failure| failure.message).collect();
            Err(Failure::new(kind, messages.join("\n")))
        }
    }
}

/// What the profile would do, and why it may not run.
fn check(name: &str, rig: &Rig, given: Option<&ModelFile>, args: &Args) -> Result<(Outlook, Option<Failure>), Failure> {
    let script = profile(name)?;
    let hands = hands_of(&rig.device);
    let context = Context { u_max_v: rig.facts.u_max_v, seed: args.seed, hands };
    let playback = script.compile(&context).map_err(|e| Failure::of(Kind::Input, &e))?;
    let limits =
        script.envelope.narrow(&rig.limits).map_err(|e| Failure::new(Kind::Input, format!("{}: {e}", script.name)))?;
    served(&script, &rig.knowledge)?;
    let outlook = Outlook::new(&script, &playback, hands, limits);
    let (model, source) = match (given, &args.model) {
        (Some(model), Some(path)) => (model, path.display().to_string()),
        _ => match model_of(rig) {
            Some(model) => (model, format!("the model of {}", rig.name)),
            None => return Ok((outlook, None)),
        },
    };
    let prediction = predict(&script, rig, model, args.seed)?;
    let failure = prediction.judge(&script).err();
    Ok((outlook.with(&playback, &prediction, source), failure))
}
