//! The folder of a campaign: claimed by one process at a time, new or to be gone on with.

use super::plan::{PLAN_FILE, Plan, file_of};
use super::set_aside::set_aside;
use super::standing::{Standing, standing};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use profiles::Script;
use recordings::{CAMPAIGN_FILE, Campaign, RunEntry};
use std::fs::{File, TryLockError};
use std::path::{Component, Path, PathBuf};

/// A folder that holds the plan of this campaign and that no other process records into.
pub struct Folder {
    dir: PathBuf,
    /// The lock goes with the process, however that ends.
    _claimed: File,
    /// The plan was there.
    resumed: bool,
}

impl Folder {
    /// Makes the folder and puts the plan there, or finds the same plan there.
    ///
    /// # Errors
    /// The folder holds a campaign without a plan, another plan, or files that the runs would be written to; another process
    /// records into it (2); the system refuses (2, 6).
    pub fn claim(dir: &Path, plan: &Plan) -> Result<Folder, Failure> {
        create(dir)?;
        let claimed = lock(dir)?;
        let resumed = match Plan::read(dir)? {
            Some(planned) => {
                same(dir, &planned, plan)?;
                true
            }
            None => {
                make_folder(dir)?;
                nothing_there(dir, plan.runs.iter().map(|run| run.name.as_str()))?;
                plan.write(dir)?;
                false
            }
        };
        Ok(Folder { dir: dir.to_owned(), _claimed: claimed, resumed })
    }

    /// Whether the campaign was begun by an earlier call.
    pub fn resumed(&self) -> bool {
        self.resumed
    }

    /// Which runs are there, one for each of the plan. What an earlier call left of the others is set aside.
    ///
    /// # Errors
    /// Recordings of other profiles under the runs' names (2), before anything is moved; the system refuses (6).
    pub fn survey(&self, plan: &Plan, scripts: &[Script], progress: &Progress) -> Result<Vec<bool>, Failure> {
        if !self.resumed {
            return Ok(vec![false; plan.runs.len()]);
        }
        let step = progress.step("reading what is there", plan.runs.len() as u64);
        let mut standings = Vec::with_capacity(plan.runs.len());
        for (n, (run, script)) in plan.runs.iter().zip(scripts).enumerate() {
            standings.push(standing(&self.dir, run, script.overrun)?);
            step.at(n as u64 + 1);
        }
        step.finish();
        let mut there = Vec::with_capacity(standings.len());
        for (run, standing) in plan.runs.iter().zip(standings) {
            let why = match standing {
                Standing::Complete(_) => {
                    there.push(true);
                    continue;
                }
                // Incidents may have come without a recording.
                Standing::Missing => "it left no recording".to_owned(),
                Standing::Unusable(why) => why,
            };
            if let Some(to) = set_aside(&self.dir, &run.name, &why)? {
                progress.say(&format!("{}: {why}; what it left is now {}", run.name, to.display()));
            }
            there.push(false);
        }
        Ok(there)
    }

    /// The runs of `campaign.toml` that the plan does not know, in their order: people add their own to be identified from. One whose
    /// recording is gone is none any more. Both is said.
    ///
    /// # Errors
    /// A `campaign.toml` that can't be read (2): to write it anew would lose what stands in it.
    pub fn others(&self, plan: &Plan, progress: &Progress) -> Result<Vec<RunEntry>, Failure> {
        let mut runs = Campaign::named_runs(&self.dir).map_err(|e| Failure::of(Kind::Input, &e))?;
        runs.retain(|run| !plan.runs.iter().any(|planned| same_file(&planned.file, &run.file)));
        let (kept, gone): (Vec<_>, Vec<_>) = runs.into_iter().partition(|run| self.dir.join(&run.file).is_file());
        for (runs, follows) in [(&kept, "kept"), (&gone, "left out, their recordings are gone")] {
            if !runs.is_empty() {
                let files: Vec<&str> = runs.iter().map(|run| run.file.as_str()).collect();
                let files = files.join(", ");
                progress.say(&format!("{CAMPAIGN_FILE} names runs that are not in {PLAN_FILE}, {follows}: {files}"));
            }
        }
        Ok(kept)
    }
}

/// Whether two names inside the folder are of one file: `./a.mcap` is `a.mcap`.
fn same_file(a: &str, b: &str) -> bool {
    fn parts(name: &str) -> impl Iterator<Item = Component<'_>> {
        Path::new(name).components().filter(|part| *part != Component::CurDir)
    }
    parts(a).eq(parts(b))
}

/// Makes the folder of a new campaign.
///
/// # Errors
/// It holds a campaign already, which is never overwritten, or the system refuses (2).
pub fn make_folder(dir: &Path) -> Result<(), Failure> {
    if dir.join(CAMPAIGN_FILE).exists() {
        let message = format!(
            "{}: expected a folder without a campaign, got one with {CAMPAIGN_FILE}; a measurement is never overwritten, \
             choose another folder or remove this one",
            dir.display()
        );
        return Err(Failure::new(Kind::Input, message));
    }
    create(dir)
}

fn create(dir: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(dir).map_err(|error| {
        let message = format!("{}: expected to create this folder, got \"{error}\"; choose another one", dir.display());
        Failure::new(Kind::Input, message)
    })
}

/// Refuses a folder in which recordings of these names lie that are nobody's.
pub(super) fn nothing_there<'a>(dir: &Path, names: impl Iterator<Item = &'a str>) -> Result<(), Failure> {
    for name in names {
        let file = file_of(name);
        let part = format!("{file}.part");
        if let Some(there) = [file, part].iter().map(|file| dir.join(file)).find(|path| path.exists()) {
            let message = format!(
                "{}: expected no recording of this name before the run, got one; a measurement is never overwritten, move it \
                 away or choose another folder",
                there.display()
            );
            return Err(Failure::new(Kind::Input, message));
        }
    }
    Ok(())
}

fn lock(dir: &Path) -> Result<File, Failure> {
    let input = |what: String| Failure::new(Kind::Input, format!("{}: {what}", dir.display()));
    let file = File::open(dir).map_err(|error| {
        input(format!(
            "expected a folder that can be read, got \"{error}\"; check its permissions, or name another --out"
        ))
    })?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => {
            Err(input("another process records into this folder; wait for it, or choose another folder".to_owned()))
        }
        Err(TryLockError::Error(error)) => Err(input(format!("expected to claim this folder, got \"{error}\""))),
    }
}

fn same(dir: &Path, planned: &Plan, now: &Plan) -> Result<(), Failure> {
    let differences = planned.differences(now);
    if differences.is_empty() {
        return Ok(());
    }
    let message = format!(
        "{}: expected the campaign of {PLAN_FILE}, got another one: {}; call it as it was begun to go on with it, or record \
         into another folder",
        dir.display(),
        differences.join("; ")
    );
    Err(Failure::new(Kind::Input, message))
}
