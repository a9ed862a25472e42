//! `bench profile list [--json]`

use crate::commands::results::aligned;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use profiles::{BUILTIN, EXAMPLES, Script};
use serde::Serialize;

/// List the built-in profiles: the experiments of a campaign, and examples to start from
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Entry {
    name: String,
    /// Runs in a campaign.
    campaign: bool,
    protocol: &'static str,
    role: &'static str,
    plane: &'static str,
    /// What its targets need to be known of the rig.
    needs: &'static str,
    at_most_s: f64,
    about: String,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let entry = |(file, text): &(&str, &str), campaign: bool| {
        let script = Script::parse(text, file).map_err(|e| Failure::of(Kind::Internal, &e))?;
        Ok(Entry {
            campaign,
            protocol: script.protocol.as_str(),
            role: script.role.as_str(),
            plane: script.plane.as_str(),
            needs: script.need().as_str(),
            at_most_s: script.duration_bound_s(),
            name: script.name,
            about: script.about,
        })
    };
    let experiments = BUILTIN.iter().map(|script| entry(script, true));
    let entries: Vec<Entry> =
        experiments.chain(EXAMPLES.iter().map(|script| entry(script, false))).collect::<Result<_, Failure>>()?;
    if args.json {
        let text = serde_json::to_string_pretty(&entries).map_err(|e| Failure::of(Kind::Internal, &e))?;
        progress.result(&text);
        return Ok(());
    }
    let heads = ["name", "runs in", "protocol", "role", "plane", "needs", "at most s", "about"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    rows.extend(entries.into_iter().map(|entry| {
        let runs_in = if entry.campaign { "campaign" } else { "example" };
        let at_most_s = format!("{:.1}", entry.at_most_s);
        let words = [runs_in, entry.protocol, entry.role, entry.plane, entry.needs, &at_most_s].map(str::to_owned);
        [entry.name].into_iter().chain(words).chain([entry.about]).collect()
    }));
    aligned(&rows).iter().for_each(|line| progress.result(line));
    Ok(())
}
