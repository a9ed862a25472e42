//! The oil of a campaign: a closed circuit loses none.

use recordings::{Protocol, Recording, Role};

use super::closure::taken_up_ml;
use super::{Check, Material};
use crate::noise::mean;

/// Time over which a path is averaged, s, and its ends.
const STEP_S: f64 = 0.01;
const END_S: f64 = 0.2;
/// Oil (ml a minute) below which a loss does not matter.
const MATTERS_ML_MIN: f64 = 0.02;

pub(super) fn checks(m: &Material) -> Vec<Check> {
    let (id, unit) = ("oil_balance", "ml/min");
    let what = "oil that both chambers gain over the dynamic runs by eqs. (13), (14)";
    let fit = &m.identified.fit;
    let k = fit.layout.parameters(&fit.point.theta).to_vector();
    let closed = [Protocol::ConstantFlow, Protocol::SquareWave, Protocol::RandomSteps];
    let runs = m.loaded.runs.iter();
    let runs = runs.filter(|r| r.entry.role == Role::Identify && closed.contains(&r.entry.protocol));
    let rates: Vec<f64> = runs.filter_map(|r| rate_ml_min(&k, &r.recording)).collect();
    let n = rates.len() as f64;
    if rates.len() < 3 {
        return vec![Check::open(id, what, unit, "three dynamic runs with role identify are needed")];
    }
    let average = rates.iter().sum::<f64>() / n;
    let spread = (rates.iter().map(|r| (r - average).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt();
    let say = [
        "no oil is missing at the end of the runs",
        "oil comes or goes, or the chambers close their cycles otherwise than eqs. (13), (14): leakage to the outside, air, a creeping \
         wall, a drifting pressure sensor, displacement_pressure",
    ];
    vec![Check::measured(id, what, (average, spread), unit, MATTERS_ML_MIN, say)]
}

/// Gain of both chambers along the measured path, from end to end.
fn rate_ml_min(k: &[f64], r: &Recording) -> Option<f64> {
    let (&start, &end) = r.time_s.first().zip(r.time_s.last())?;
    let mut path: Vec<[f64; 3]> = Vec::new();
    let mut first = 0;
    while first < r.len() {
        // the ends are averaged longer: their noise counts in full
        let t = r.time_s[first];
        let length = if t < start + END_S || t > end - END_S { END_S } else { STEP_S };
        let next = first + r.time_s[first..].partition_point(|v| *v < t + length - 1e-9).max(1);
        let of = |v: &[f64]| mean(v[first..next].iter().copied()).0;
        let x = [of(&r.angle_deg).to_radians(), of(&r.pressure1_bar), of(&r.pressure2_bar)];
        if x.iter().all(|v| v.is_finite()) {
            path.push(x);
        }
        first = next;
    }
    let gain: f64 = taken_up_ml(k, &path).iter().sum();
    (gain.is_finite() && end - start > 5.0).then(|| gain / (end - start) * 60.0)
}
