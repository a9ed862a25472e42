//! Residual analysis of a validation run: is what the model leaves white, and independent of the inputs?

use recordings::Recording;

use crate::noise::mean;
use crate::prepare::{Channel, Stand};
use crate::validate::{Simulated, ValidatedRun};

/// Longest lag, s.
const LONGEST_S: f64 = 1.0;
/// Level of the tests.
const LEVEL: f64 = 0.01;

/// One channel of a run.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Whiteness {
    /// The run's file.
    pub run: String,
    /// Column.
    pub channel: &'static str,
    /// Time of a lag, s: that of the blocks over which the residual is averaged.
    pub lag_s: f64,
    /// Correlation of the residual with itself, from lag 1 on.
    pub auto: Vec<f64>,
    /// Size that 99 % of the lags of white noise stay below.
    pub band: f64,
    /// Share of the lags beyond the band.
    pub beyond: f64,
    /// p-value of Ljung and Box's test that all lags are 0.
    pub p_white: f64,
    /// With each input that changes in this run.
    pub cross: Vec<Cross>,
}

/// Correlation of a residual with an input.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Cross {
    /// `voltage_v`, `brake_open` or `bypass_open`.
    pub input: &'static str,
    /// From lag 0 on: the input before the residual.
    pub correlation: Vec<f64>,
    /// Size that all lags together of an independent residual stay below in 99 % of runs, the colour of both allowed for.
    pub band: f64,
    /// Largest size, and its lag.
    pub largest: f64,
    /// s
    pub at_s: f64,
}

impl Whiteness {
    /// No test at level 1 % says otherwise.
    pub fn is_white(&self) -> bool {
        self.p_white >= LEVEL
    }

    /// No input correlates beyond its band.
    pub fn is_independent(&self) -> bool {
        self.cross.iter().all(|c| c.largest <= c.band)
    }
}

/// Of each channel of a run whose lever is free, as far as `simulated` says it.
pub fn whiteness(run: &ValidatedRun, simulated: &Simulated, recording: &Recording) -> Vec<Whiteness> {
    let prepared = &run.prepared;
    let [stretch] = &prepared.stretches[..] else { return Vec::new() };
    if stretch.stand != Stand::Free || stretch.blocks.len() < 50 {
        return Vec::new();
    }
    let rows = &simulated.rows[0];
    let blocks = || stretch.blocks.windows(2).map(|b| b[0]..b[1]);
    let spacing_s = (stretch.time_s[stretch.rows() - 1] - stretch.time_s[0]) / (stretch.blocks.len() - 1) as f64;
    let lags = ((LONGEST_S / spacing_s) as usize).clamp(5, (stretch.blocks.len() / 10).max(5));
    let of_input = |value: &dyn Fn(usize) -> f64| -> Vec<f64> { blocks().map(|b| mean(b.map(value)).0).collect() };
    let inputs = [
        ("voltage_v", of_input(&|i| recording.voltage_v[i])),
        ("brake_open", of_input(&|i| f64::from(u8::from(recording.brake_open[i])))),
        ("bypass_open", of_input(&|i| f64::from(u8::from(recording.bypass_open[i])))),
    ];
    let mut out = Vec::new();
    for score in &simulated.scores {
        let c = score.channel.index();
        let residual: Vec<f64> = blocks().map(|b| mean(b.map(|i| stretch.measured[c][i] - rows[i][c])).0).collect();
        let Some(e) = Series::of(&residual) else { continue };
        let auto: Vec<f64> = (1..=lags).map(|k| e.with(&e, k)).collect();
        let n = e.count as f64;
        let band = 2.576 / n.sqrt();
        let q: f64 = auto.iter().enumerate().map(|(i, r)| n * (n + 2.0) * r * r / (n - (i + 1) as f64)).sum();
        let mut cross = Vec::new();
        for (input, values) in &inputs {
            let Some(x) = Series::of(values) else { continue };
            let correlation: Vec<f64> = (0..=lags).map(|k| e.with(&x, k)).collect();
            // Bartlett: two independent series that both have colour
            let colour: f64 = 1.0 + 2.0 * (1..=lags).map(|k| e.with(&e, k) * x.with(&x, k)).sum::<f64>();
            let one = (colour.max(1.0) / n).sqrt();
            let (lag, largest) = correlation
                .iter()
                .enumerate()
                .map(|(k, r)| (k, r.abs()))
                .fold((0, 0.0), |m, v| if v.1 > m.1 { v } else { m });
            let band = one * normal_point(LEVEL / (2.0 * correlation.len() as f64));
            cross.push(Cross { input, correlation, band, largest, at_s: lag as f64 * spacing_s });
        }
        out.push(Whiteness {
            run: prepared.file.clone(),
            channel: score.channel.column(),
            lag_s: spacing_s,
            beyond: auto.iter().filter(|r| r.abs() > band).count() as f64 / auto.len() as f64,
            p_white: chi_square_beyond(q, lags as f64),
            auto,
            band,
            cross,
        });
    }
    out
}

/// A channel's residual is shown in figures under this name.
pub fn known(channel: Channel) -> bool {
    matches!(channel, Channel::Angle | Channel::Pressure1 | Channel::Pressure2)
}

/// A series less its mean, missing values 0.
struct Series {
    values: Vec<f64>,
    square: f64,
    count: usize,
}

impl Series {
    /// `None` where it does not change.
    fn of(values: &[f64]) -> Option<Self> {
        let (level, count) = mean(values.iter().copied());
        let values: Vec<f64> = values.iter().map(|v| if v.is_finite() { v - level } else { 0.0 }).collect();
        let square: f64 = values.iter().map(|v| v * v).sum();
        (count > 20 && square > 1e-18 * count as f64).then_some(Series { values, square, count })
    }

    /// Correlation with another series, that one `lag` earlier.
    fn with(&self, earlier: &Series, lag: usize) -> f64 {
        let n = self.values.len();
        let sum: f64 = self.values[lag..].iter().zip(&earlier.values[..n - lag]).map(|(a, b)| a * b).sum();
        sum / (self.square * earlier.square).sqrt()
    }
}

/// Upper tail of a chi-square distribution, by Wilson and Hilferty.
fn chi_square_beyond(value: f64, freedom: f64) -> f64 {
    let v = 2.0 / (9.0 * freedom);
    let z = ((value / freedom).cbrt() - (1.0 - v)) / v.sqrt();
    normal_beyond(z)
}

/// Upper tail of the normal distribution (Abramowitz and Stegun 26.2.17, below 1e-7).
fn normal_beyond(z: f64) -> f64 {
    if z < 0.0 {
        return 1.0 - normal_beyond(-z);
    }
    let t = 1.0 / (1.0 + 0.231_641_9 * z);
    let p = t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    p * (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt()
}

/// The point with this upper tail, by bisection.
fn normal_point(tail: f64) -> f64 {
    let (mut low, mut high) = (0.0, 10.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if normal_beyond(middle) > tail { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn tails_are_those_of_the_tables() {
        assert!((normal_beyond(1.96) - 0.025).abs() < 1e-4 && (normal_beyond(-1.0) - 0.8413).abs() < 1e-4);
        assert!((normal_point(0.005) - 2.5758).abs() < 1e-3);
        assert!((chi_square_beyond(124.34, 100.0) - 0.05).abs() < 1e-3);
    }

    #[test]
    fn a_series_correlates_with_what_it_follows_at_its_lag() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let input: Vec<f64> = (0..4000).map(|_| StandardNormal.sample(&mut rng)).collect();
        let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
        let follows: Vec<f64> = (0..4000).map(|i| if i < 7 { 0.0 } else { input[i - 7] } + noise()).collect();
        let (x, y) = (Series::of(&input).unwrap(), Series::of(&follows).unwrap());
        assert!((y.with(&x, 7) - 0.5f64.sqrt()).abs() < 0.03);
        assert!(y.with(&x, 6).abs() < 0.06 && y.with(&y, 1).abs() < 0.06);
        assert!(Series::of(&[3.0; 100]).is_none());
    }
}
