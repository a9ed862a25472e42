//! A campaign: a folder with `campaign.toml` beside one file a run.

use std::path::{Path, PathBuf};

use crate::{CampaignError, Plane, Protocol, Recording, Role};

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
    pub fn open(_dir: &Path) -> Result<Campaign, CampaignError> {
        todo!("next commit")
    }

    /// Reads and checks one run.
    pub fn read(&self, run: &RunEntry) -> Result<Recording, CampaignError> {
        Recording::read(&self.dir.join(&run.file), run.protocol)
    }

    /// Writes `campaign.toml` into the folder; what [`Campaign::open`] reads is the same campaign.
    pub fn write_toml(&self) -> Result<(), CampaignError> {
        todo!("next commit")
    }
}
