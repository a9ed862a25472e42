//! How large the structured part of the residual is, where it sits, and whether it is more than noise.

use recordings::Protocol;

use crate::prepare::{Channel, Stand};
use crate::problem::Problem;

/// The residual of one channel of one run.
#[derive(Clone, Debug)]
pub struct Part {
    /// Position of the run in the campaign.
    pub run: usize,
    /// Protocol of the run, if it is of the REC rig.
    pub protocol: Option<Protocol>,
    /// The lever is free.
    pub free: bool,
    /// Channel.
    pub channel: Channel,
    /// Mean square of the structured part of the residual, in units of the noise of one sample squared. May come out
    /// slightly negative where there is none.
    pub structured: f64,
    /// `structured` over its standard error without structure.
    pub significance: f64,
}

/// Structured residual by run and channel: the mean product of neighbouring blocks, whose noise is independent.
///
/// What is no misfit of the plant is taken off: the colour of the sensors' noise as it shows during the initial rests, and
/// what the steps of an encoder leave that no noise dithers.
pub fn parts(problem: &Problem, residuals: &[Vec<f64>], clusters: &[Vec<usize>]) -> Vec<Part> {
    let colour = colour_at_rest(problem);
    let mut out: Vec<Part> = Vec::new();
    let runs: std::collections::BTreeSet<usize> = problem.stretches.iter().map(|s| s.run).collect();
    for run in runs {
        for channel in problem.channels() {
            let mut sums: std::collections::BTreeMap<usize, f64> = Default::default();
            let (mut weight, mut pairs) = (0.0, 0usize);
            let mut free = false;
            let mut protocol = None;
            let mut there = false;
            let mut steps = 0.0;
            for (n, s) in problem.stretches.iter().enumerate().filter(|(_, s)| s.run == run) {
                free = s.stand == Stand::Free;
                protocol = s.protocol;
                there = true;
                steps = problem.steps[n][channel.index()];
                let taken = if free { colour[channel.index()] } else { 0.0 };
                let mut last: Option<f64> = None;
                for (t, target) in s.targets.iter().enumerate().filter(|(_, t)| t.channel == channel) {
                    let r = residuals[n][t];
                    if let Some(before) = last {
                        *sums.entry(clusters[n][t]).or_default() += r * before - taken;
                        weight += target.samples as f64;
                        pairs += 1;
                    }
                    last = Some(r);
                }
            }
            if !there || pairs < 10 {
                continue;
            }
            let total: f64 = sums.values().sum::<f64>() - steps * weight;
            // white noise alone spreads the sum by sqrt(pairs)
            let error = (pairs as f64).sqrt();
            out.push(Part { run, protocol, free, channel, structured: total / weight, significance: total / error });
        }
    }
    out
}

/// Mean product of neighbouring blocks before the first motion, by channel, where it is more than chance: the colour of
/// the noise itself. Taken from the measured values about their own straight line, not from the residual: a model that
/// is wrong at rest must not pass for noise.
fn colour_at_rest(problem: &Problem) -> Vec<f64> {
    let count = problem.channels().len();
    let mut sums = vec![0.0; count];
    let mut pairs = vec![0usize; count];
    for (n, s) in problem.stretches.iter().enumerate().filter(|(_, s)| s.stand == Stand::Free) {
        let moved = problem.plant.rest_rows(s);
        for channel in problem.channels() {
            let rest: Vec<f64> = (0..s.targets.len())
                .filter(|&t| s.targets[t].channel == channel && s.targets[t].middle < moved)
                .map(|t| s.targets[t].measured / problem.target_std(n, t))
                .collect();
            if rest.len() < 20 {
                continue;
            }
            let level = about_line(&rest);
            sums[channel.index()] += level.windows(2).map(|w| w[0] * w[1]).sum::<f64>();
            pairs[channel.index()] += rest.len() - 1;
        }
    }
    let of = |c: usize| {
        let n = pairs[c] as f64;
        if n > 0.0 && sums[c] > 3.0 * n.sqrt() { sums[c] / n } else { 0.0 }
    };
    (0..count).map(of).collect()
}

/// Values less their least-squares line over the index.
fn about_line(values: &[f64]) -> Vec<f64> {
    let n = values.len() as f64;
    let middle = (n - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / n;
    let (mut tt, mut tv) = (0.0, 0.0);
    for (i, v) in values.iter().enumerate() {
        tt += (i as f64 - middle).powi(2);
        tv += (i as f64 - middle) * (v - mean);
    }
    values.iter().enumerate().map(|(i, v)| v - mean - tv / tt * (i as f64 - middle)).collect()
}

/// How much of a misfit counts: all where the lever is free; where angle or pressures are inputs a fifth (RMS), for there
/// the inputs' own errors show as misfit too.
fn weight(part: &Part) -> f64 {
    if part.free { 1.0 } else { 0.04 }
}

/// Largest structured residual that is more than noise, in units of the noise of one sample (RMS), weighted.
pub fn largest(parts: &[Part]) -> f64 {
    let rms = |p: &Part| (weight(p) * p.structured.max(0.0)).sqrt();
    parts.iter().filter(|p| p.significance > 5.0).map(rms).fold(0.0, f64::max)
}

/// Sum of the structured mean squares, weighted.
pub fn total(parts: &[Part]) -> f64 {
    parts.iter().map(|p| weight(p) * p.structured.max(0.0)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_leaves_nothing_and_the_rest_keeps_its_size() {
        assert!(about_line(&[1.0, 3.0, 5.0, 7.0]).iter().all(|v| v.abs() < 1e-12));
        let wave: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let left: f64 = about_line(&wave).iter().map(|v| v * v).sum();
        assert!((left - 100.0).abs() < 1.0, "{left}");
    }
}
