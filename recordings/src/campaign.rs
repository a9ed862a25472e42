//! A campaign: a folder with `campaign.toml` beside one file a run.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::Place;
use crate::part_file::{Existing, PartFile, part_path};
use crate::recording::FileKind;
use crate::{CampaignError, Plane, Protocol, Recording, Role, campaign_toml, mcap_reader};

/// Name of the file that makes a folder a campaign.
pub const CAMPAIGN_FILE: &str = "campaign.toml";

/// What is known of the rig without identification.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigFacts {
    /// Inertia of lever and load, kg m2 (> 0).
    pub inertia_kg_m2: f64,
    /// Gravity torque at 90 degrees, Nm (>= 0); acts in the vertical plane.
    pub gravity_nm: f64,
    /// Largest command to the amplifier, V (> 0).
    pub u_max_v: f64,
}

/// One run of a campaign.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunEntry {
    /// File inside the campaign's folder: `.mcap`, `.csv` or `.csv.gz`.
    pub file: String,
    /// Which experiment it is.
    pub protocol: Protocol,
    /// What it may be used for.
    pub role: Role,
    /// The plane in which the lever moves.
    pub plane: Plane,
}

/// A campaign folder.
#[derive(Clone, Debug, PartialEq)]
pub struct Campaign {
    /// The folder.
    pub dir: PathBuf,
    /// Free text.
    pub name: String,
    /// What is known of the rig without identification.
    pub rig: RigFacts,
    /// In the order of the file.
    pub runs: Vec<RunEntry>,
}

impl Campaign {
    /// Reads and checks `dir/campaign.toml`, and that every run's file is there. The runs themselves are read by
    /// [`Campaign::read`].
    ///
    /// # Errors
    /// Name the file, the line and the key: wrong format number, missing or ill-typed key, unknown protocol, role or
    /// plane, value out of range, no run, a file that is named twice, lies outside the folder or does not exist.
    pub fn open(dir: &Path) -> Result<Campaign, CampaignError> {
        let parsed = parsed(dir)?;
        for (run, at) in parsed.runs.iter().zip(parsed.places) {
            let file = dir.join(&run.file);
            if !file.is_file() {
                let remedy = if part_path(&file).exists() {
                    "this run was never closed (its .part is there): record it again, or see what `bench recover` saves"
                } else {
                    "put the recording there or take the run out of the campaign"
                };
                return Err(CampaignError::content(
                    at,
                    "a recording in the folder",
                    format!("no file {:?}", run.file),
                    remedy,
                ));
            }
        }
        Ok(Campaign { dir: dir.to_owned(), name: parsed.name, rig: parsed.rig, runs: parsed.runs })
    }

    /// The runs that `dir/campaign.toml` names, in its order, whether their files are there or not; none where there is no such file.
    ///
    /// # Errors
    /// Those of [`Campaign::open`], but for a run's file that does not exist.
    pub fn named_runs(dir: &Path) -> Result<Vec<RunEntry>, CampaignError> {
        if !dir.join(CAMPAIGN_FILE).exists() {
            return Ok(Vec::new());
        }
        Ok(parsed(dir)?.runs)
    }

    /// Reads and checks one run (see [`Recording::read`]). An MCAP recording that says another protocol or plane than
    /// the campaign does is an error; its role is the campaign's to decide.
    pub fn read(&self, run: &RunEntry) -> Result<Recording, CampaignError> {
        let path = self.dir.join(&run.file);
        match FileKind::of_name(&run.file) {
            Some(FileKind::Mcap) => mcap_reader::read_recording(&path, run.protocol, Some(run.plane)),
            _ => Recording::read(&path, run.protocol),
        }
    }

    /// Writes `campaign.toml` into the folder (which must exist), replacing the one that is there; keys that other tools
    /// added are not kept. The runs' files need not exist yet.
    ///
    /// # Errors
    /// Whatever [`Campaign::open`] would refuse, before anything is written, and the system's refusal.
    pub fn write_toml(&self) -> Result<(), CampaignError> {
        let path = self.dir.join(CAMPAIGN_FILE);
        let text = campaign_toml::render(&self.name, &self.rig, &self.runs);
        campaign_toml::parse(&path, &text)?;
        let mut file = PartFile::create(&path, Existing::Replace)?;
        file.write_all(text.as_bytes()).map_err(|source| CampaignError::write(&path, source))?;
        file.commit().map(drop)
    }
}

/// What `dir/campaign.toml` says.
fn parsed(dir: &Path) -> Result<campaign_toml::Parsed, CampaignError> {
    let path = dir.join(CAMPAIGN_FILE);
    let bytes = fs::read(&path).map_err(|source| CampaignError::read(&path, source))?;
    let text = String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let line = 1 + error.as_bytes()[..good].iter().filter(|&&byte| byte == b'\n').count();
        let at = Place::file(&path).line(line as u64);
        CampaignError::content(at, "text in UTF-8", "a byte that is not", "save the file as UTF-8")
    })?;
    campaign_toml::parse(&path, &text)
}
