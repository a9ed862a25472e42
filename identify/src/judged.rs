//! Which effects a campaign can't judge: those that would not show in its runs even at a usual size.

use model::effects::{Balance, Effect};
use rayon::prelude::*;
use recordings::Protocol;
use serde::Serialize;

use crate::figure::Table;
use crate::figures::section;
use crate::figures::text::number;
use crate::problem::Problem;
use crate::score::Scene;

/// An effect that this campaign says nothing about.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NotJudged {
    /// Id of the library.
    pub id: &'static str,
    /// Its balance.
    pub balance: &'static str,
    /// By how many standard errors it would show at most at a usual size, beside what the base parameters take up.
    pub shows: f64,
    /// The runs that would tell.
    pub needed: String,
}

/// A single effect shows from so many standard errors on: the largest of a whole library's by chance stays below that in 99 of 100 campaigns.
const SHOWS: f64 = 4.0;

/// The effects of `library` whose directions, orthogonal to everything that was fitted, have no weight in the data at any of the sizes
/// and shapes that their headers call usual. `seen`: by how many standard errors of the noise they show in a part of the runs, where that is known.
pub fn not_judged(
    library: &[&'static dyn Effect],
    problem: &Problem,
    scene: &Scene,
    misfit: f64,
    seen: &[(&'static str, f64)],
) -> Vec<NotJudged> {
    let recorded: Vec<Protocol> = problem.stretches.iter().filter_map(|s| s.protocol).collect();
    let shows = |effect: &'static dyn Effect| {
        let known = seen.iter().find(|(id, _)| *id == effect.header().id);
        let mut most = known.map_or(0.0, |(_, seen)| seen / misfit.max(1.0).sqrt());
        if most >= SHOWS {
            return most;
        }
        // the last ones are the largest
        for start in effect.header().starts.iter().rev() {
            if let Some(d) = scene.direction(effect, start) {
                most = most.max((d.square / misfit.max(1.0)).sqrt());
            }
            if most >= SHOWS {
                break;
            }
        }
        most
    };
    let judged: Vec<(&'static dyn Effect, f64)> = library.par_iter().map(|e| (*e, shows(*e))).collect();
    let hidden = judged.into_iter().filter(|(_, shows)| *shows < SHOWS);
    hidden
        .map(|(effect, shows)| {
            let header = effect.header();
            NotJudged {
                id: header.id,
                balance: header.balance.as_str(),
                shows,
                needed: needed(header.balance, header.measure, &recorded),
            }
        })
        .collect()
}

/// The protocols of this balance that are not in the campaign, and how the effect is measured.
fn needed(balance: Balance, measure: &str, recorded: &[Protocol]) -> String {
    use Protocol::*;
    let telling: &[Protocol] = match balance {
        Balance::Torque => &[TorqueMap, ConstantFlow, SquareWave],
        Balance::Flow => &[ClampSteps, VolumeMap, RandomSteps],
        Balance::Pump => &[PumpMap, RandomSteps],
        Balance::Sensor => &[TorqueMap, SquareWave, RandomSteps],
    };
    let missing: Vec<&str> = telling.iter().filter(|p| !recorded.contains(p)).map(|p| p.as_str()).collect();
    if missing.is_empty() {
        format!("{measure}; in a longer run, or with larger amplitude, than those recorded")
    } else {
        format!("a run of {} (role identify), which this campaign lacks: {measure}", missing.join(" or "))
    }
}

/// One line; `None` where everything can be judged.
pub fn said(hidden: &[NotJudged]) -> Option<String> {
    let each: Vec<String> = hidden.iter().map(|h| format!("{} (needed: {})", h.id, h.needed)).collect();
    (!hidden.is_empty()).then(|| format!("This campaign can't judge {}.", each.join("; ")))
}

/// For the report.
pub fn table(hidden: &[NotJudged]) -> Table {
    let rows = hidden.iter().map(|h| vec![h.id.into(), h.balance.into(), number(h.shows, 2), h.needed.clone()]);
    Table {
        section: section::RESULT.into(),
        title: "Effects that this campaign can't judge".into(),
        caption: format!(
            "Even at a usual size they would show by less than {SHOWS} standard errors beside what the base parameters take up. No finding is no \
             evidence against them."
        ),
        columns: ["effect", "balance", "shows, std. errors", "needed"].map(String::from).to_vec(),
        rows: rows.collect(),
    }
}
