//! `bench check RIG.toml [--json]`

use super::results::aligned;
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::rig_file::{Rig, Understood};
use serde::Serialize;
use std::path::PathBuf;

/// Check a rig file without touching the rig: keys, units, ranges, signals, what it asks of its wires
///
/// Opens no port and no interface. Says how the file was understood, or everything that is wrong with it (2).
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Rig file
    rig: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Document<'a> {
    /// Whether a run may begin with this file.
    fits: bool,
    /// What is wrong.
    #[serde(skip_serializing_if = "Option::is_none")]
    message: Option<&'a str>,
    #[serde(flatten)]
    understood: Option<&'a Understood>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let outcome = Rig::read(Some(&args.rig)).and_then(|rig| Understood::of(&rig));
    if args.json {
        let (understood, message) = match &outcome {
            Ok(understood) => (Some(understood), None),
            Err(failure) => (None, Some(failure.message.as_str())),
        };
        let document = Document { fits: outcome.is_ok(), message, understood };
        let text = serde_json::to_string_pretty(&document).map_err(|e| Failure::of(Kind::Internal, &e))?;
        progress.result(&text);
        return outcome.map(drop);
    }
    progress.result(&text(&outcome?));
    Ok(())
}

fn text(understood: &Understood) -> String {
    let Understood { name, device, parts, mapping, budget, .. } = understood;
    let mut rows = vec![vec!["rig".to_owned(), name.clone()], vec!["device".to_owned(), (*device).to_owned()]];
    rows.extend(parts.iter().map(|part| vec![part.name.to_owned(), part.is.clone()]));
    let mut lines = aligned(&rows);
    if !mapping.is_empty() {
        let mut rows =
            vec![["mapping", "message", "id", "signal", "bits", "gain", "offset", "unit"].map(String::from).to_vec()];
        let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        rows.extend(mapping.iter().map(|m| {
            let texts = [&m.key, &m.message, &m.id, &m.signal, &m.bits].map(String::clone);
            texts.into_iter().chain([number(m.gain), number(m.offset), m.unit.clone()]).collect()
        }));
        lines.push(String::new());
        lines.extend(aligned(&rows));
    }
    for wire in budget {
        lines.push(String::new());
        lines.push(wire.sum.clone());
        lines.extend(wire.entries.iter().map(|(what, bits)| format!("{bits:9.1}  {what}")));
        lines.push(format!("{:9.1}  in a tick in which all comes together", wire.busiest_bits));
        lines.extend(wire.not_counted.iter().map(|what| format!("        -  {what}")));
    }
    lines.push(String::new());
    lines.push("fits".to_owned());
    lines.join("\n")
}
