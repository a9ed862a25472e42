//! Virtual work as a judge of units: a chamber that turns the lever by dphi takes in dV, so M dphi = p dV, and torque a bar of pressure
//! difference and volume a radian are one quantity (1 bar ml = 0.1 J). A unit that is wrong by a factor shows there whatever the rig's
//! size, and the energy that the wall stores does not.

use recordings::{Campaign, Protocol, Recording};

use super::Implausible;
use crate::noise::mean;
use crate::prepare::segments;

/// Torque and volume may disagree by this factor: a wall that stores energy makes some ten percent of it, a wrong unit at least 10.
const FACTOR: f64 = 5.0;

/// Judges campaigns with a torque-map and a volume-map.
///
/// # Errors
/// Torque, volume, angle and pressure do not fit together.
pub(super) fn judge(campaign: &Campaign, recordings: &[Recording]) -> Result<(), Implausible> {
    let of = |p: Protocol| campaign.runs.iter().zip(recordings).filter(move |(e, _)| e.protocol == p);
    let (Some((map, torque)), Some((sweeps, volume))) =
        (of(Protocol::TorqueMap).next(), of(Protocol::VolumeMap).next())
    else {
        return Ok(());
    };
    let (Some(m3), Some(v2)) = (torque_nm_bar(torque), volume_ml_rad(volume)) else { return Ok(()) };
    let ratio = 0.1 * v2 / m3;
    if (1.0 / FACTOR..=FACTOR).contains(&ratio) {
        return Ok(());
    }
    let likely = [
        (57.2958, "angle_deg in rad (multiply it by 57.2958)"),
        (0.0174533, "angle_deg in a unit of 57 to the degree"),
        (1e-3, "torque_nm in mNm, or volume_ml in l (multiply by 0.001 or by 1000)"),
        (1e3, "volume_ml in mm3 (multiply it by 0.001)"),
        (14.5, "the pressures in psi (multiply them by 0.0689476)"),
        (100.0, "the pressures in kPa (multiply them by 0.01)"),
        (0.1, "the pressures in MPa (multiply them by 10)"),
    ];
    let near = likely.iter().min_by(|a, b| (ratio / a.0).ln().abs().total_cmp(&(ratio / b.0).ln().abs()));
    let near = near.filter(|(f, _)| (ratio / f).ln().abs() < FACTOR.ln() / 2.0);
    Err(Implausible {
        file: format!("{} and {}", campaign.dir.join(&map.file).display(), campaign.dir.join(&sweeps.file).display()),
        column: "torque_nm, volume_ml, angle_deg or a pressure".into(),
        expected: format!(
            "torque per pressure difference and oil per angle that agree within a factor of {FACTOR} (virtual work: m3 = 0.1 v2)"
        ),
        got: format!("m3 = {m3:.3} Nm/bar and 0.1 v2 = {:.3} Nm/bar", 0.1 * v2),
        remedy: near.map_or("check the units of these columns".into(), |(_, what)| format!("likely {what}")),
    })
}

/// Slope of the clamp's torque over p1 - p2 within the segments at one angle, Nm/bar.
fn torque_nm_bar(r: &Recording) -> Option<f64> {
    let mut points: Vec<(f64, f64, f64)> = Vec::new();
    for (first, end) in segments(r) {
        let late = first + (end - first) / 2..end;
        let (torque, n) = mean(r.torque_nm[late.clone()].iter().copied());
        let dp = mean(late.clone().map(|i| r.pressure1_bar[i] - r.pressure2_bar[i])).0;
        let angle = mean(r.angle_deg[late].iter().copied()).0;
        if n >= 5 && dp.is_finite() && angle.is_finite() {
            points.push((angle, dp, torque));
        }
    }
    // the angle's own torque is left out by its neighbours in the list, which stand at the same clamp
    let (mut xx, mut xy, mut n) = (0.0, 0.0, 0);
    let range = points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.0), h.max(p.0)));
    for pair in points.windows(2) {
        if (pair[1].0 - pair[0].0).abs() <= 0.02 * (range.1 - range.0) || range.1 == range.0 {
            let (x, y) = (pair[1].1 - pair[0].1, pair[1].2 - pair[0].2);
            xx += x * x;
            xy += x * y;
            n += 1;
        }
    }
    (n >= 3 && xx > 0.0).then(|| (xy / xx).abs()).filter(|v| *v > 0.0)
}

/// Slope over the angle of the oil in chamber 1 at the angle where both pressures are equal, ml/rad.
fn volume_ml_rad(r: &Recording) -> Option<f64> {
    let mut points = Vec::new();
    for (first, end) in segments(r) {
        let (volume, n) = mean(r.volume_ml[first..end].iter().copied());
        if n == 0 {
            continue;
        }
        let dp = |i: usize| r.pressure1_bar[i] - r.pressure2_bar[i];
        let nearest = (first..end)
            .filter(|&i| dp(i).is_finite() && r.angle_deg[i].is_finite())
            .min_by(|&a, &b| dp(a).abs().total_cmp(&dp(b).abs()))?;
        points.push((r.angle_deg[nearest].to_radians(), volume));
    }
    if points.len() < 3 {
        return None;
    }
    let n = points.len() as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let (xx, xy) = points.iter().fold((0.0, 0.0), |(a, b), p| (a + (p.0 - x).powi(2), b + (p.0 - x) * (p.1 - y)));
    (xx > 0.0).then(|| (xy / xx).abs()).filter(|v| *v > 0.0)
}
