//! How far two rivals are apart in a run, after the best that a refit could do.

use model::integrate::SimulationError;
use nalgebra::DMatrix;
use recordings::{Plane, Protocol, Recording};

use super::Rival;
use crate::noise::median;
use crate::normal::covariance;
use crate::prepare::{Channel, Stand, Unusable, stretches};
use crate::problem::Problem;
use crate::score::clusters;

/// What a campaign knows of a rival.
pub struct Prior<'a> {
    /// The rival.
    pub rival: &'a Rival,
    /// Information on its parameters (normal matrix, initial values eliminated), in noise variances.
    information: DMatrix<f64>,
    /// Size of the campaign's residuals over the noise, squared, at least 1: colour and what no rival explains make them larger.
    misfit: f64,
}

impl<'a> Prior<'a> {
    /// Linearises the rival on the campaign.
    ///
    /// # Errors
    /// It can't be simulated there.
    pub fn of(campaign: &Problem, rival: &'a Rival) -> Result<Self, SimulationError> {
        let fit = &rival.fit;
        let pieces = campaign.linearise(&fit.layout, &fit.point)?;
        let information = campaign.normal(&pieces, fit.layout.len(), &fit.point).matrix;
        let misfit = (fit.cost / campaign.targets().max(1) as f64).max(1.0);
        Ok(Prior { rival, information, misfit })
    }
}

/// How a run tells two rivals apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// Expected significance of the better fit of the true one, standard errors.
    pub z: f64,
    /// RMS of the difference over all samples of the run that no refit takes up, noise floors.
    pub noise_floors: f64,
    /// Share of the mean square of the difference that no refit takes up.
    pub share: f64,
}

impl Separation {
    /// The one that separates less: the run must do whichever rival is true.
    pub fn lesser(self, other: Separation) -> Separation {
        if other.z < self.z { other } else { self }
    }
}

/// How far `wrong` stays behind in a run that goes as `truth` says. `run`: what the run would give ([`would_give`]).
///
/// # Errors
/// One of them can't be simulated with the run's inputs.
pub fn separation(truth: &Prior, wrong: &Prior, run: &Problem) -> Result<Separation, SimulationError> {
    let (t, w) = (&truth.rival.fit, &wrong.rival.fit);
    let point = run.point(w.point.theta.clone());
    let shown = run.residuals(&t.layout, &run.point(t.point.theta.clone()))?;
    let mut pieces = run.linearise(&w.layout, &point)?;
    // the size of a residual that is no noise says how much the noise must be widened
    let widened = truth.misfit.min(wrong.misfit).sqrt();
    let mut whole = 0.0;
    for (piece, shown) in pieces.iter_mut().zip(&shown) {
        for (r, s) in piece.residual.iter_mut().zip(shown) {
            // (measured - wrong) - (measured - true)
            *r = (*r - s) / widened;
            whole += *r * *r;
        }
        piece.slope.iter_mut().for_each(|v| *v /= widened);
    }
    let columns = w.layout.len();
    let normal = run.normal(&pieces, columns, &point);
    let information = &wrong.information / (widened * widened) + &normal.matrix;
    let step = covariance(&information).map(|v| if v.is_finite() { v } else { 0.0 }) * &normal.gradient;
    let initial = normal.initial_step(&step);
    let (of, count) = clusters(run);
    let mut left = vec![0.0; count];
    for ((piece, initial), of) in pieces.iter().zip(&initial).zip(&of) {
        for ((row, r), c) in piece.slope.chunks(columns + 3).zip(&piece.residual).zip(of) {
            let fitted: f64 = row[..columns].iter().zip(step.iter()).map(|(a, b)| a * b).sum();
            let own: f64 = row[columns..].iter().zip(initial).map(|(a, b)| a * b).sum();
            left[*c] += (r - fitted - own).powi(2);
        }
    }
    let total: f64 = left.iter().sum();
    // a cluster's difference of costs has the mean d and the variance 4 d; the diagnosis takes its standard error from the clusters
    let spread: f64 = left.iter().map(|d| d * d + 4.0 * d).sum();
    let samples: usize = run.stretches.iter().flat_map(|s| &s.targets).map(|t| t.samples).sum();
    Ok(Separation {
        z: if spread > 0.0 { total / spread.sqrt() } else { 0.0 },
        noise_floors: widened * (total / samples.max(1) as f64).sqrt(),
        share: if whole > 0.0 { (total / whole).min(1.0) } else { 0.0 },
    })
}

/// What a run would give to fit: `predicted` holds its inputs, and where sensors show inputs (clamped angles, pressures on the bench)
/// their values, without noise. Noise and rate are those of the campaign's like runs.
///
/// # Errors
/// The protocol can't use such a run.
pub fn would_give(
    campaign: &Problem,
    protocol: Protocol,
    plane: Plane,
    predicted: &Recording,
) -> Result<Problem, Unusable> {
    let mut run = Problem::default();
    for mut s in stretches(0, "the candidate run", protocol, plane, predicted)? {
        let std = typical_std(campaign, s.stand);
        // as many samples in a target as the campaign's sensors would have given in that time
        let ours = interval(&s.time_s);
        let like = campaign.stretches.iter().filter(|c| c.stand == s.stand || s.stand != Stand::Free);
        let mut theirs: Vec<f64> = like.map(|c| interval(&c.time_s)).filter(|v| *v > 0.0).collect();
        let theirs = if theirs.is_empty() { ours } else { median(&mut theirs) };
        for t in &mut s.targets {
            if t.channel != Channel::Volume {
                t.samples = ((t.samples as f64 * ours / theirs).round() as usize).max(1);
            }
        }
        if s.stand == Stand::Free {
            let rest = s.voltage_v.iter().position(|u| *u != 0.0).unwrap_or(s.rows()).max(1);
            let samples = (rest as f64 * ours / theirs).max(1.0);
            for (j, channel) in [Channel::Angle, Channel::Pressure1, Channel::Pressure2].into_iter().enumerate() {
                let unit = if j == 0 { std::f64::consts::PI / 180.0 } else { 1.0 };
                s.initial_std[j] = 2.0 * std[channel.index()] * unit / samples.sqrt();
            }
        }
        run.std.push(std.to_vec());
        run.steps.push(vec![0.0; 5]);
        run.stretches.push(s);
    }
    Ok(run)
}

/// Noise of one sample by channel: the median over the campaign's stretches of this kind, else over all.
fn typical_std(campaign: &Problem, stand: Stand) -> [f64; 5] {
    Channel::ALL.map(|c| {
        let of = |like: bool| -> Vec<f64> {
            let both = campaign.stretches.iter().zip(&campaign.std);
            both.filter(|(s, _)| !like || s.stand == stand).map(|(_, std)| std[c.index()]).collect()
        };
        let mut own = of(true);
        if own.is_empty() {
            own = of(false);
        }
        median(&mut own).max(1e-9)
    })
}

fn interval(time_s: &[f64]) -> f64 {
    match time_s {
        [first, .., last] => (last - first) / (time_s.len() - 1) as f64,
        _ => 0.0,
    }
}
