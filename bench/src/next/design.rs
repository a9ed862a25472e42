//! The choice of the next run.

use super::NEXT_FILE;
use super::candidates::{Candidate, Room, candidates};
use super::play::{as_plant, play};
use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::rig_file::Rig;
use identify::analysis::Analysis;
use identify::design::{
    ENOUGH, Offer, Prior, Question, Rival, Separation, choose, question, rivals, separation, would_give,
};
use identify::figures::text::number;
use identify::findings::{NextRun, Separates};
use identify::identification::Loaded;
use identify::problem::Problem;
use model::ModelFile;
use profiles::Script;
use rayon::prelude::*;
use std::str::FromStr;

/// Longest rig time of a run that is proposed, s.
const LONGEST_S: f64 = 240.0;

/// What the design came to.
pub struct Designed {
    /// The script, or none where no run on offer separates the rivals.
    pub script: Option<String>,
    /// Rig time of the run without preparation, s.
    pub seconds: f64,
    /// One sentence for findings, report and screen.
    pub said: String,
    /// In numbers.
    pub run: Option<NextRun>,
}

/// A rival ready to be compared.
struct Hypothesis<'a> {
    prior: Prior<'a>,
    plant: ModelFile,
}

/// The run out of all on offer that best settles what the diagnosis leaves open, within the rig's limits. `None` where its verdict stands.
/// `name`: of the script.
///
/// # Errors
/// A rival can't be simulated on the campaign it was fitted to (1).
pub fn design(
    loaded: &Loaded,
    analysis: &Analysis,
    rig: &Rig,
    name: &str,
    progress: &Progress,
) -> Result<Option<Designed>, Failure> {
    let Some(diagnosis) = &analysis.diagnosis else { return Ok(None) };
    let Some(question) = question(diagnosis) else { return Ok(None) };
    let internal = |e: model::integrate::SimulationError| Failure::new(Kind::Internal, format!("rivals: {e}"));
    let step = progress.step("rivals", 0);
    let all = rivals(&analysis.identified, diagnosis, &question, &|text| progress.say(text)).map_err(internal)?;
    step.done(&format!("{} rivals fitted", all.len()));
    if all.len() < 2 {
        return Ok(None);
    }
    let room = Room::of(loaded, &rig.limits);
    design_for(&analysis.identified.problem, &all, &question, &room, rig, name, progress).map(Some)
}

/// The run out of all on offer within `room` that tells these rivals apart, the first against each of the others.
///
/// # Errors
/// A rival can't be simulated on the campaign it was fitted to (1).
pub fn design_for(
    campaign: &Problem,
    all: &[Rival],
    question: &Question,
    room: &Room,
    rig: &Rig,
    name: &str,
    progress: &Progress,
) -> Result<Designed, Failure> {
    let internal = |e: model::integrate::SimulationError| Failure::new(Kind::Internal, format!("rivals: {e}"));
    let step = progress.step("next run", 0);
    let hypotheses: Vec<Hypothesis> = all
        .iter()
        .map(|rival| Ok(Hypothesis { prior: Prior::of(campaign, rival)?, plant: as_plant(rival) }))
        .collect::<Result<_, _>>()
        .map_err(internal)?;
    let on_offer = candidates(room);
    let tried: Vec<Tried> = on_offer
        .par_iter()
        .with_max_len(1)
        .filter_map(|candidate| Tried::of(candidate, candidate.passes, name, rig, campaign, &hypotheses))
        .collect();
    let offers: Vec<Offer> = tried.iter().map(Tried::lengthened).collect();
    let chosen = choose(&offers).and_then(|n| {
        let passes = tried[n].passes_for_enough();
        let at_length = Tried::of(tried[n].candidate, passes, name, rig, campaign, &hypotheses);
        at_length.or_else(|| Tried::of(tried[n].candidate, tried[n].candidate.passes, name, rig, campaign, &hypotheses))
    });
    step.done(&format!("{} of {} runs on offer stay within the limits on every rival", tried.len(), on_offer.len()));
    Ok(match chosen {
        Some(tried) => tried.designed(all, question),
        None => nothing(all, &offers, &tried),
    })
}

/// A candidate that was played on every rival.
struct Tried<'a> {
    candidate: &'a Candidate,
    script: Script,
    passes: usize,
    /// Longest of the dry runs, s.
    seconds: f64,
    /// The first rival against each of the others.
    pairs: Vec<(f64, Separation)>,
}

impl<'a> Tried<'a> {
    /// `None`: it does not fit the rig, trips or fails on one of the rivals, or can't be used.
    fn of(
        candidate: &'a Candidate,
        passes: usize,
        name: &str,
        rig: &Rig,
        campaign: &Problem,
        hypotheses: &[Hypothesis],
    ) -> Option<Tried<'a>> {
        let script = Script::parse(&candidate.script(name, passes), NEXT_FILE).ok()?;
        let mut seconds = 0.0f64;
        let mut runs: Vec<Problem> = Vec::new();
        for h in hypotheses {
            let (prediction, recording) = play(&script, rig, &h.plant, SEED).ok()?;
            if prediction.trip.is_some() || prediction.failed.is_some() {
                return None;
            }
            seconds = seconds.max(prediction.duration_s());
            let protocol = recordings::Protocol::from_str(script.protocol.as_str()).ok()?;
            let plane = recordings::Plane::from_str(script.plane.as_str()).ok()?;
            runs.push(would_give(campaign, protocol, plane, &recording).ok()?);
        }
        let first = &hypotheses[0];
        let mut pairs = Vec::new();
        for (other, run) in hypotheses.iter().zip(&runs).skip(1) {
            let one = separation(&first.prior, &other.prior, &runs[0]).ok()?;
            let two = separation(&other.prior, &first.prior, run).ok()?;
            pairs.push((other.prior.rival.probability.max(0.01), one.lesser(two)));
        }
        Some(Tried { candidate, script, passes, seconds, pairs })
    }

    /// Passes at which the pair that matters most is expected to be told apart by enough, within the longest time. Standard errors grow
    /// with the root of the time.
    fn passes_for_enough(&self) -> usize {
        let z = self.pairs.iter().map(|(_, s)| s.z).fold(f64::INFINITY, f64::min).max(1e-3);
        let most = (LONGEST_S / self.seconds).max(1.0);
        let factor = if self.candidate.grows { (ENOUGH / z).powi(2).clamp(1.0, most) } else { 1.0 };
        ((self.passes as f64 * factor).ceil() as usize).max(self.passes)
    }

    /// As an offer of that length.
    fn lengthened(&self) -> Offer {
        let factor = self.passes_for_enough() as f64 / self.passes as f64;
        let longer = |s: Separation| Separation { z: s.z * factor.sqrt(), ..s };
        Offer {
            seconds: self.seconds * factor + self.candidate.preparation_s,
            pairs: self.pairs.iter().map(|(w, s)| (*w, longer(*s))).collect(),
        }
    }

    fn designed(self, all: &[Rival], question: &Question) -> Designed {
        let separates: Vec<Separates> = all[1..]
            .iter()
            .zip(&self.pairs)
            .map(|(other, (_, s))| Separates {
                between: [all[0].name(), other.name()],
                standard_errors: s.z,
                noise_floors: s.noise_floors,
            })
            .collect();
        let expected: Vec<String> = separates
            .iter()
            .map(|s| {
                let (z, floors) = (number(s.standard_errors, 2), number(s.noise_floors, 2));
                format!("{} from {} by {z} standard errors ({floors} noise floors RMS)", s.between[0], s.between[1])
            })
            .collect();
        let what = match question {
            Question::Which(_) => "expected to tell",
            Question::Whether(_) => "expected to decide whether there is an effect at all and to tell",
        };
        let about = &self.candidate.about;
        let said = format!("{NEXT_FILE}: {about}, {:.0} s; {what} {}", self.seconds, expected.join(", "));
        let share = self.pairs.iter().map(|(_, s)| s.share).fold(f64::INFINITY, f64::min);
        let why = format!(
            "of the runs on offer that stay within the rig's limits whichever rival is true, it settles most for its time; {:.0} % of the difference of \
             the predictions is left after the best refit that the campaign and the run allow",
            100.0 * share
        );
        let run = NextRun {
            file: NEXT_FILE.into(),
            about: about.clone(),
            protocol: self.script.protocol.as_str().into(),
            plane: self.script.plane.as_str().into(),
            seconds: self.seconds,
            separates,
            why,
        };
        Designed { script: Some(self.script.text.clone()), seconds: self.seconds, said, run: Some(run) }
    }
}

/// Seed of the random steps in dry runs, and in the run that follows.
pub const SEED: u64 = 1;

fn nothing(all: &[Rival], offers: &[Offer], tried: &[Tried]) -> Designed {
    let names: Vec<String> = all.iter().map(Rival::name).collect();
    let best = (0..offers.len()).max_by(|&a, &b| offers[a].settles().total_cmp(&offers[b].settles()));
    let best = best.map_or(String::new(), |n| {
        let z = offers[n].pairs.iter().map(|(_, s)| s.z).fold(0.0, f64::max);
        format!(": the best ({}) is expected to reach {} standard errors", tried[n].candidate.about, number(z, 2))
    });
    let said = format!("no run on offer within the rig's limits tells {} apart{best}", names.join(", "));
    Designed { script: None, seconds: 0.0, said, run: None }
}
