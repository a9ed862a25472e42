//! Free-run validation: a run simulated from the mean of its initial rest with nothing fed back, and scored.

use rayon::prelude::*;

use model::integrate::SimulationError;
use recordings::{CAMPAIGN_FILE, Role};

use crate::fit::Fit;
use crate::identification::{IdentifyError, Loaded};
use crate::predict::predict_rows;
use crate::prepare::{Channel, Stretch, stretches};

/// How well one channel of a run is predicted, over all of its samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// The channel.
    pub channel: Channel,
    /// Samples compared; missing ones are passed over.
    pub samples: usize,
    /// Root mean square error, in the channel's unit.
    pub rmse: f64,
    /// Largest error, in the channel's unit.
    pub largest: f64,
    /// 100 % = no error, 0 % = no better than the channel's own mean. `None` where the channel does not change.
    pub fit_percent: Option<f64>,
}

/// A run as a model says it.
#[derive(Clone, Debug)]
pub struct Simulated {
    /// By stretch and row: angle (deg), pressures (bar absolute), torque (Nm), volume (ml).
    pub rows: Vec<Vec<[f64; 5]>>,
    /// Of each channel that was measured and is not an input.
    pub scores: Vec<Score>,
}

/// A run to be simulated, cut into stretches (one where the lever is free).
#[derive(Clone, Debug)]
pub struct Prepared {
    /// Position in the campaign.
    pub run: usize,
    /// The run's file.
    pub file: String,
    /// Its stretches.
    pub stretches: Vec<Stretch>,
}

/// A run beside the models.
#[derive(Clone, Debug)]
pub struct ValidatedRun {
    /// The run.
    pub prepared: Prepared,
    /// By [`Channel`]: noise of one sample, in the channel's unit.
    pub noise_floor: [f64; 5],
    /// The reference model.
    pub before: Result<Simulated, SimulationError>,
    /// The model with what was added; `None` where nothing was diagnosed.
    pub after: Option<Result<Simulated, SimulationError>>,
}

/// One channel of a run, before and after.
#[derive(Clone, Copy, Debug)]
pub struct Compared {
    /// The reference model's.
    pub before: Score,
    /// With what was added.
    pub after: Option<Score>,
    /// In the channel's unit.
    pub noise_floor: f64,
}

/// The run at this position, ready to be simulated.
///
/// # Errors
/// [`IdentifyError::Unusable`], as for [`stretches`].
pub fn prepare_run(loaded: &Loaded, run: usize) -> Result<Prepared, IdentifyError> {
    let r = &loaded.runs[run];
    let stretches = stretches(run, &r.entry.file, r.entry.protocol, r.entry.plane, &r.recording)?;
    Ok(Prepared { run, file: r.entry.file.clone(), stretches })
}

/// The runs with role validate, ready to be simulated.
///
/// # Errors
/// There is none, or one of them can't be used.
pub fn prepare_validation(loaded: &Loaded) -> Result<Vec<Prepared>, IdentifyError> {
    let runs: Vec<usize> = (0..loaded.runs.len()).filter(|&n| loaded.runs[n].entry.role == Role::Validate).collect();
    if runs.is_empty() {
        return Err(IdentifyError::Missing {
            campaign: loaded.campaign.dir.join(CAMPAIGN_FILE).display().to_string(),
            why: format!(
                "expected at least one [[run]] with role = \"validate\", got none of {}; add a run that is not fitted, a \
                 square-wave say, or change the role of one",
                loaded.runs.len()
            ),
        });
    }
    runs.into_iter().map(|run| prepare_run(loaded, run)).collect()
}

/// Free run of a prepared run with a fitted model, from the mean of its initial rest, uncorrected.
///
/// # Errors
/// The model leaves the range in which it holds: a pressure falls to zero.
pub fn simulate(prepared: &Prepared, fit: &Fit) -> Result<Simulated, SimulationError> {
    let rows = prepared
        .stretches
        .par_iter()
        .map(|s| predict_rows(s, &fit.layout, &fit.point.theta, &[0.0; 3]))
        .collect::<Result<Vec<_>, _>>()?;
    let scores = Channel::ALL.into_iter().filter_map(|c| score(&prepared.stretches, &rows, c)).collect();
    Ok(Simulated { rows, scores })
}

/// Simulates each run with the reference model and, where there is one, with the model that has something added. A run whose
/// simulation fails is said by its result and spoils no other.
pub fn validate(loaded: &Loaded, runs: Vec<Prepared>, before: &Fit, after: Option<&Fit>) -> Vec<ValidatedRun> {
    runs.into_par_iter()
        .map(|prepared| {
            let (first, second) =
                rayon::join(|| simulate(&prepared, before), || after.map(|after| simulate(&prepared, after)));
            let noise_floor = Channel::ALL.map(|c| loaded.floor_of(prepared.run, c));
            ValidatedRun { prepared, noise_floor, before: first, after: second }
        })
        .collect()
}

impl ValidatedRun {
    /// The run's channels, as far as all simulations that were asked for came to their end.
    pub fn compared(&self) -> Vec<Compared> {
        let Ok(before) = &self.before else { return Vec::new() };
        let after = match &self.after {
            None => None,
            Some(Ok(after)) => Some(after),
            Some(Err(_)) => return Vec::new(),
        };
        before
            .scores
            .iter()
            .map(|score| Compared {
                before: *score,
                after: after.and_then(|a| a.scores.iter().find(|s| s.channel == score.channel).copied()),
                noise_floor: self.noise_floor[score.channel.index()],
            })
            .collect()
    }

    /// What to say where a simulation failed, with the error of the other one where that came to its end.
    pub fn failure(&self) -> Option<String> {
        let (reference, added) = ("the reference model", "the model with what was added");
        let (failed, error, other) = match (&self.before, &self.after) {
            (Err(error), Some(Ok(after))) => (reference, error, Some((added, after))),
            (Err(error), _) => (reference, error, None),
            (Ok(before), Some(Err(error))) => (added, error, Some((reference, before))),
            (Ok(_), _) => return None,
        };
        let file = &self.prepared.file;
        let mut text =
            format!("{file}: the free run with {failed} ended {error}; the run is left out of the validation");
        if let Some((other, (channel, floors))) = other.and_then(|(name, s)| Some((name, self.largest_error(s)?))) {
            text += &format!("; with {other} its largest error is {floors:.2} noise floors, of {}", channel.column());
        }
        Some(text)
    }

    /// The channel whose error is largest in noise floors, with that.
    fn largest_error(&self, simulated: &Simulated) -> Option<(Channel, f64)> {
        let floors = simulated.scores.iter().map(|s| (s.channel, s.rmse / self.noise_floor[s.channel.index()]));
        floors.filter(|(_, f)| f.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Error of one channel over all stretches; `None` where it was not measured or is an input.
fn score(stretches: &[Stretch], rows: &[Vec<[f64; 5]>], channel: Channel) -> Option<Score> {
    let c = channel.index();
    let measured = || {
        let pairs = stretches.iter().zip(rows).filter(|(s, _)| !s.measured[c].is_empty());
        pairs
            .flat_map(move |(s, y)| s.measured[c].iter().zip(y.iter().map(move |y| y[c])))
            .filter(|(m, _)| m.is_finite())
    };
    let (mut samples, mut sum, mut square, mut largest) = (0usize, 0.0, 0.0, 0.0f64);
    for (m, y) in measured() {
        let error: f64 = m - y;
        samples += 1;
        sum += m;
        square += error * error;
        largest = largest.max(error.abs());
    }
    if samples == 0 {
        return None;
    }
    let mean = sum / samples as f64;
    let spread: f64 = measured().map(|(m, _)| (m - mean).powi(2)).sum();
    Some(Score {
        channel,
        samples,
        rmse: (square / samples as f64).sqrt(),
        largest,
        fit_percent: (spread > 0.0).then(|| 100.0 * (1.0 - (square / spread).sqrt())),
    })
}
