//! How large the structured part of the residual is, where it sits, and whether it is more than noise.

use model::integrate::SimulationError;
use recordings::Protocol;

use crate::colour::{Colour, colours};
use crate::fit::Fit;
use crate::prepare::{Channel, Stand};
use crate::problem::Problem;

/// Structured residual below this many noise floors (RMS) does not matter.
pub const MATERIAL: f64 = 0.1;

/// The residual of one channel of one run.
#[derive(Clone, Debug)]
pub struct Part {
    /// Position of the run in the campaign.
    pub run: usize,
    /// Protocol of the run.
    pub protocol: Option<Protocol>,
    /// The lever is free.
    pub free: bool,
    /// Channel.
    pub channel: Channel,
    /// Mean square of the structured part of the residual, in units of the noise of one sample squared. May come out
    /// slightly negative where there is none.
    pub structured: f64,
    /// Samples that it is the mean of.
    pub samples: f64,
    /// `structured` over its standard error if there were none, the noise's colour allowed for.
    pub significance: f64,
}

/// Structured residual by run and channel: the mean product of blocks that are so far apart that the sensors' noise has
/// forgotten itself.
///
/// What is no misfit of the plant is taken off: what little is left of the noise's colour at that distance, and what the steps of
/// an encoder leave that no noise dithers. `colours`: by [`Channel`], where the lever is free. A misfit that swings back within that distance shows as
/// a product further below zero than noise has it ([`structured`]).
pub fn parts(problem: &Problem, residuals: &[Vec<f64>], colours: &[Colour]) -> Vec<Part> {
    let mut out: Vec<Part> = Vec::new();
    let runs: std::collections::BTreeSet<usize> = problem.stretches.iter().map(|s| s.run).collect();
    let white = Colour::white();
    for run in runs {
        for channel in problem.channels() {
            let (mut sum, mut noise, mut most, mut weight, mut pairs) = (0.0, 0.0, 0.0, 0.0, 0usize);
            let mut error = 0.0;
            let mut free = false;
            let mut protocol = None;
            let mut there = false;
            let mut steps = 0.0;
            for (n, s) in problem.stretches.iter().enumerate().filter(|(_, s)| s.run == run) {
                free = s.stand == Stand::Free;
                protocol = s.protocol;
                there = true;
                steps = problem.steps[n][channel.index()];
                let colour = if free { &colours[channel.index()] } else { &white };
                let lag = colour.forgotten();
                let taken = if free { colour.at(lag).max(0.0) } else { 0.0 };
                let own: Vec<usize> = (0..s.targets.len()).filter(|&t| s.targets[t].channel == channel).collect();
                for (before, after) in own.iter().zip(own.iter().skip(lag)) {
                    sum += residuals[n][*after] * residuals[n][*before];
                    noise += taken;
                    most += colour.at(0);
                    weight += s.targets[*after].samples as f64;
                    pairs += 1;
                }
                error = colour.spread(lag);
            }
            if !there || pairs < 10 {
                continue;
            }
            let chance = error * (pairs as f64).sqrt();
            let total = structured(sum, noise + steps * weight, most, chance);
            let significance = total / chance;
            out.push(Part { run, protocol, free, channel, structured: total / weight, samples: weight, significance });
        }
    }
    out
}

/// Of a sum of products what is more than the sensors' own: `noise`, what these leave at the lag that it was taken at. `most`: what they leave at lag 0; `chance`:
/// the sum's standard error if there were no misfit.
///
/// A series' products at a lag are never larger than at lag 0, whatever their sign. So a sum that is below zero by more than the noise has at lag 0 (mains hum that
/// turns round from block to block has a part of that) is of a misfit that swings, whose square is at least what is beyond.
fn structured(sum: f64, noise: f64, most: f64, chance: f64) -> f64 {
    let swings = -sum - most;
    if swings > CERTAIN * chance { swings } else { sum - noise }
}

/// How much of a misfit counts: all where the lever is free. Where angle or pressures are inputs their own errors show as misfit too: a fifth (RMS)
/// counts of what the oil does, which follows every one of them, and a half of what the torque sensor shows.
fn weight(part: &Part) -> f64 {
    match part.channel {
        _ if part.free => 1.0,
        Channel::Torque => 0.25,
        _ => 0.04,
    }
}

/// Standard errors from which a part is more than noise.
const CERTAIN: f64 = 5.0;

/// The largest structured residual that is more than noise, by its weight.
pub fn leading(parts: &[Part]) -> Option<&Part> {
    parts.iter().filter(|p| p.significance > CERTAIN).max_by(|a, b| weighted(a).total_cmp(&weighted(b)))
}

/// How large that is, in units of the noise of one sample (RMS), weighted.
pub fn largest(parts: &[Part]) -> f64 {
    leading(parts).map_or(0.0, |p| weighted(p).sqrt())
}

/// What the structured residual adds to the cost, weighted.
pub fn cost(parts: &[Part]) -> f64 {
    parts.iter().map(|p| weighted(p) * p.samples).sum()
}

/// [`largest`] of what a fit leaves of this problem, the noise's colour estimated beside it.
///
/// # Errors
/// The model can't be simulated there.
pub fn left_by(problem: &Problem, fit: &Fit) -> Result<f64, SimulationError> {
    parts_left_by(problem, fit).map(|parts| largest(&parts))
}

/// The [`parts`] of what a fit leaves of this problem, the noise's colour estimated beside it.
///
/// # Errors
/// The model can't be simulated there.
pub fn parts_left_by(problem: &Problem, fit: &Fit) -> Result<Vec<Part>, SimulationError> {
    let residuals = problem.residuals(&fit.layout, &fit.point)?;
    Ok(parts(problem, &residuals, &colours(problem, &residuals)))
}

fn weighted(part: &Part) -> f64 {
    weight(part) * part.structured.max(0.0)
}

/// Sum of the structured mean squares, weighted.
pub fn total(parts: &[Part]) -> f64 {
    parts.iter().map(weighted).sum()
}

/// Sum of the structured mean squares, each run's each channel alike: what tells one balance from another. Where the lever is led no torque moves the
/// oil, and the bench's pump has no chambers; the errors of inputs are the same for all.
pub fn unweighted(parts: &[Part]) -> f64 {
    parts.iter().map(|part| part.structured.max(0.0)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(free: bool, channel: Channel, structured: f64, samples: f64) -> Part {
        let (run, protocol) = (0, None);
        Part { run, protocol, free, channel, structured, samples, significance: 10.0 }
    }

    #[test]
    fn a_misfit_that_swings_back_is_one_and_noise_that_does_is_none() {
        let of = |sum: f64| structured(sum, 2.0, 100.0, 4.0);
        assert_eq!(of(30.0), 28.0);
        assert_eq!(of(-10.0), -12.0);
        assert_eq!(of(-100.0), -102.0, "hum that turns round from block to block, and nothing else");
        assert_eq!(of(-119.0), -121.0, "which chance may have enlarged");
        assert_eq!(of(-400.0), 300.0);
    }

    #[test]
    fn cost_is_that_of_all_samples_and_where_there_are_inputs_a_part_counts() {
        let free = |structured, samples| part(true, Channel::Angle, structured, samples);
        // a bias of 0.3 standard deviations of a sample costs its square a sample
        assert!((cost(&[free(0.09, 1000.0)]) - 90.0).abs() < 1e-9);
        assert_eq!(cost(&[free(-0.01, 1000.0)]), 0.0, "less than noise is none");
        let both = [free(0.09, 1000.0), free(0.09, 500.0)];
        assert!((cost(&both) - 135.0).abs() < 1e-9);
        assert!((largest(&both) - 0.3).abs() < 1e-12, "which the largest does not add up");
        let led = |channel| largest(&[part(false, channel, 4.0, 100.0)]);
        assert!((led(Channel::Pressure1) - 0.4).abs() < 1e-12, "where the lever is led its angle is an input");
        assert!((led(Channel::Torque) - 1.0).abs() < 1e-12);
        let mixed = [free(0.09, 1000.0), free(-0.01, 1000.0), part(false, Channel::Volume, 4.0, 10.0)];
        assert!((total(&mixed) - 0.25).abs() < 1e-12 && (unweighted(&mixed) - 4.09).abs() < 1e-12);
    }
}
