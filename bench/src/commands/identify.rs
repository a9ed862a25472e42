//! `bench identify DIR [--out OUT] [--torque FORM]`

use super::results::analyse_folder_as;
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
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    analyse_folder_as(&args.dir, args.out.as_deref(), Depth::Identification, args.torque, progress).map(drop)
}
