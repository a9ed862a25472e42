//! `bench identify DIR [--out OUT] [--torque FORM] [--model MODEL.toml]`

use super::results::{Wanted, analyse_with, declared_in};
use super::results_json::as_json;
use crate::failure::Failure;
use crate::progress::Progress;
use identify::analysis::Depth;
use identify::torque_form::TorqueForm;
use std::path::PathBuf;

/// Identify the model from a campaign folder: model.toml, report.html and its twin report.json
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Campaign folder with campaign.toml
    dir: PathBuf,
    /// Where the results go [default: DIR/analysis]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Torque characteristic: eq. (2), or its third order after eq. (1), compared with eq. (2) in the report
    #[arg(long, value_name = "eq2|third-order", default_value = "eq2")]
    torque: TorqueForm,
    /// Print the results as one JSON object
    #[arg(long)]
    json: bool,
    /// Model whose effects ([[effect]]) are part of what is identified; its values are where they begin
    #[arg(long, value_name = "MODEL.toml")]
    model: Option<PathBuf>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let declared = args.model.as_deref().map(declared_in).transpose()?;
    let wanted =
        Wanted { depth: Depth::Identification, form: args.torque, declared: declared.as_ref(), ..Wanted::default() };
    let results = analyse_with(&args.dir, args.out.as_deref(), &wanted, &progress.beside(args.json))?;
    if args.json { progress.json(&as_json(&results)?) } else { Ok(()) }
}
