//! `bench blind --cases N --seed S [--jobs J] [--out FILE.json] [--keep DIR] [--only KIND] [--case K | --from K]
//! [--with FILE.json ...]`, `bench blind --count FILE.json ...`

use super::results::aligned;
use crate::blind::case::Case;
use crate::blind::plan::{Kind, plan};
use crate::blind::store::{Store, of_files};
use crate::blind::table::{Target, at_the_minimum, confusion, covered, seen, targets};
use crate::blind::times::times;
use crate::blind::trial::{DIAGNOSIS, trial};
use crate::failure::{self, Failure};
use crate::progress::Progress;
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Diagnose sealed campaigns of emulated rigs, then open them: how often the verdict is right
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Number of cases; 30 % of them carry no effect
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    cases: u32,
    /// Draws everything; the same seed gives the same cases
    #[arg(long, default_value_t = 1, value_parser = super::seed)]
    seed: u64,
    /// Cases at a time
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    jobs: u8,
    /// Everything about every case, written after each; with a file that is there the run goes on, if it is of the same diagnosis
    #[arg(long, value_name = "FILE.json")]
    out: Option<PathBuf>,
    /// Folder to leave the campaigns in, and beside each its truth
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Only the cases of this kind: none, weak, clear, gross, pair, outside
    #[arg(long, value_name = "KIND")]
    only: Option<Kind>,
    /// Only the case of this number
    #[arg(long, value_name = "K", conflicts_with = "from")]
    case: Option<usize>,
    /// First case: those before it are another machine's
    #[arg(long, value_name = "K", default_value_t = 0)]
    from: usize,
    /// What another machine found of the same seed (its --out); counted as well, and not done again
    #[arg(long = "with", value_name = "FILE.json")]
    others: Vec<PathBuf>,
    /// Counts all cases of these results (their --out), of whatever seeds and diagnoses, and makes none
    #[arg(long, value_name = "FILE.json", num_args = 1.., exclusive = true)]
    count: Vec<PathBuf>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    if !args.count.is_empty() {
        return count(&args.count, progress);
    }
    let wanted = wanted(args)?;
    let store = Store::open(args.out.as_deref(), &args.others, args.seed)?;
    let open: Vec<usize> = wanted.iter().copied().filter(|c| !store.holds(*c)).collect();
    if open.len() < wanted.len() {
        progress.say(&format!("{} of {} cases are there already", wanted.len() - open.len(), wanted.len()));
    }
    if !open.is_empty() {
        store.is_of(DIAGNOSIS)?;
    }
    let store = Mutex::new(store);
    let next = AtomicUsize::new(0);
    let step = progress.step("blind trials", open.len() as u64);
    let work = || -> Result<(), Failure> {
        loop {
            let turn = next.fetch_add(1, Ordering::Relaxed);
            let Some(&case) = open.get(turn) else { return Ok(()) };
            let done = trial(args.seed, case, args.keep.as_deref()).inspect_err(|_| {
                // The others end after the case that they are at.
                next.store(open.len(), Ordering::Relaxed);
            })?;
            progress.result(&done.line());
            store.lock().map_err(|_| defect())?.add(done)?;
            step.at(turn as u64 + 1);
        }
    };
    std::thread::scope(|scope| {
        let jobs: Vec<_> = (0..args.jobs).map(|_| scope.spawn(work)).collect();
        jobs.into_iter().map(|job| job.join().unwrap_or_else(|_| Err(defect()))).collect::<Result<Vec<()>, Failure>>()
    })?;
    step.finish();

    let store = store.into_inner().map_err(|_| defect())?;
    if open.is_empty() && !args.others.is_empty() {
        store.write()?;
    }
    let cases = store.cases();
    let cases: Vec<_> = cases.into_iter().filter(|c| wanted.contains(&c.case)).collect();
    if cases.len() > 1 {
        progress.result("");
        progress.result("short of what is sealed, or of the error of the truth's form:");
        cases.iter().filter(|c| c.falls_short()).for_each(|c| progress.result(&c.line()));
    }
    judge(&tables(&cases, progress), args.case.is_some())
}

/// Says how often the verdicts were right, and how long they took.
fn tables(cases: &[Case], progress: &Progress) -> Vec<Target> {
    progress.result("");
    aligned(&confusion(cases)).iter().for_each(|line| progress.result(line));
    progress.result("");
    let targets = targets(cases);
    targets.iter().for_each(|target| progress.result(&target.line()));
    progress.result("of those, the ones whose effects leave a noise floor or more in the runs that may be fitted:");
    seen(cases).iter().for_each(|(what, share)| progress.result(&format!("{what:44} {share}")));
    progress.result(&format!("{:44} {}", "parameters: 95 % interval holds the truth", covered(cases)));
    progress.result(&format!("{:44} {}", "fits as low as from the true values on", at_the_minimum(cases)));
    progress.result("");
    aligned(&times(cases)).iter().for_each(|line| progress.result(line));
    targets
}

/// The same of what was found before.
fn count(files: &[PathBuf], progress: &Progress) -> Result<(), Failure> {
    let cases = of_files(files)?;
    let seeds: BTreeSet<&str> = cases.keys().map(|(seed, _)| seed.as_str()).collect();
    let diagnoses: BTreeSet<&str> = cases.values().filter_map(|c| c.diagnosis.as_deref()).collect();
    progress.result(&format!(
        "{} cases of {} seeds, by the diagnosis of {} commits",
        cases.len(),
        seeds.len(),
        diagnoses.len()
    ));
    let cases: Vec<Case> = cases.into_values().collect();
    judge(&tables(&cases, progress), false)
}

/// Numbers of the cases that are asked for, in order.
///
/// # Errors
/// There is none (2).
fn wanted(args: &Args) -> Result<Vec<usize>, Failure> {
    if let Some(case) = args.case {
        return Ok(vec![case]);
    }
    let cases = args.cases as usize;
    if args.from >= cases {
        let message = format!("--from {}: expected the number of a case below --cases {cases}", args.from);
        return Err(Failure::new(failure::Kind::Input, message));
    }
    Ok((args.from..cases).filter(|c| args.only.is_none_or(|k| plan(args.seed, *c).kind == k)).collect())
}

/// A single case is looked at, not counted.
fn judge(targets: &[Target], single: bool) -> Result<(), Failure> {
    let missed: Vec<&str> = targets.iter().filter(|t| !t.holds()).map(|t| t.what).collect();
    if single || missed.is_empty() {
        return Ok(());
    }
    Err(Failure::new(failure::Kind::Acceptance, format!("missed: {}", missed.join("; "))))
}

fn defect() -> Failure {
    Failure::new(failure::Kind::Internal, "a case ended by a defect; see above")
}
