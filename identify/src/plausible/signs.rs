//! Signs: what the pump does to pressures and lever says which columns are exchanged or inverted.

use recordings::{Campaign, Protocol, Recording};

use super::Implausible;

/// A change of the voltage counts from this share of the largest one on.
const CHANGE: f64 = 0.3;
/// The pressure difference answers within this time, s, the lever within the longer one: several periods of its swing.
const PRESSURE_S: f64 = 0.1;
const LEVER_S: f64 = 0.4;
/// Answers that are needed, and the mean sign beyond which they agree.
const LEAST: usize = 4;
const AGREE: f64 = 0.5;

/// Judges the runs with a free lever, and the torque's and the volume's sign on the bench.
///
/// # Errors
/// The first run whose signs are not the contract's.
pub(super) fn judge(campaign: &Campaign, recordings: &[Recording]) -> Result<(), Implausible> {
    // a free lever tells what is exchanged, the bench only that something is
    let free = |p: Protocol| matches!(p, Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps);
    let runs = || campaign.runs.iter().zip(recordings);
    for (entry, r) in runs().filter(|r| free(r.0.protocol)).chain(runs().filter(|r| !free(r.0.protocol))) {
        let refuse = |column: &str, expected: &str, got: &str, remedy: &str| {
            Err(Implausible {
                file: campaign.dir.join(&entry.file).display().to_string(),
                column: column.into(),
                expected: expected.into(),
                got: got.into(),
                remedy: remedy.into(),
            })
        };
        let rule = "u > 0 to raise pressure 1 over pressure 2 and to turn the lever towards positive angles";
        match entry.protocol {
            Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps => {
                let pressure = answers(r, PRESSURE_S, |i| r.pressure1_bar[i] - r.pressure2_bar[i]);
                let lever = answers(r, LEVER_S, |i| r.angle_deg[i]);
                match (side(&pressure), side(&lever)) {
                    (-1, 1) => {
                        return refuse(
                            "pressure1_bar, pressure2_bar",
                            rule,
                            "the lever does, and p1 - p2 falls instead",
                            "the two columns are likely exchanged: give chamber 1, which expands for positive angles, as pressure1_bar",
                        );
                    }
                    (1, -1) => {
                        return refuse(
                            "angle_deg",
                            rule,
                            "p1 - p2 rises, and the lever turns the other way",
                            "the angle is likely inverted: positive angles expand chamber 1",
                        );
                    }
                    (-1, -1) => {
                        return refuse(
                            "voltage_v",
                            rule,
                            "both the other way round",
                            "the voltage is likely inverted, or the chambers are numbered the other way round and the angle with them",
                        );
                    }
                    _ => {}
                }
            }
            Protocol::TorqueMap => {
                let pairs = (0..r.len()).map(|i| (r.pressure1_bar[i] - r.pressure2_bar[i], r.torque_nm[i]));
                if correlation(pairs.filter(|(a, b)| a.is_finite() && b.is_finite())).is_some_and(|c| c < -AGREE) {
                    return refuse(
                        "torque_nm",
                        "a torque that grows with p1 - p2: chamber 1 turns towards positive angles",
                        "one that falls",
                        "the torque is likely inverted, or the two pressures are exchanged",
                    );
                }
            }
            Protocol::PumpMap => {
                let (mut grows, mut falls) = (0, 0);
                for (first, end) in crate::prepare::segments(r) {
                    let mut read = (first..end).filter(|&i| r.volume_ml[i].is_finite() && r.voltage_v[i] != 0.0);
                    if let (Some(a), Some(b)) = (read.next(), read.next_back()) {
                        grows += usize::from(r.volume_ml[b] > r.volume_ml[a]);
                        falls += usize::from(r.volume_ml[b] < r.volume_ml[a]);
                    }
                }
                if falls >= LEAST && falls > 2 * grows {
                    return refuse(
                        "volume_ml",
                        "a volume that grows in the direction of u, for either sign of u",
                        "one that falls in most segments",
                        "give the delivered volume positive in the direction of u",
                    );
                }
            }
            Protocol::VolumeMap | Protocol::ClampSteps => {}
        }
    }
    Ok(())
}

/// 1 or -1 where the answers agree, else 0.
fn side(answers: &[f64]) -> i32 {
    let mean = answers.iter().sum::<f64>() / answers.len().max(1) as f64;
    if answers.len() < LEAST || mean.abs() < AGREE { 0 } else { mean.signum() as i32 }
}

/// For each large change of the voltage that acts on the chambers: whether `y` moves with it (1) or against it (-1) within `over_s`.
fn answers(r: &Recording, over_s: f64, y: impl Fn(usize) -> f64) -> Vec<f64> {
    let most = r.voltage_v.iter().fold(0.0f64, |m, u| m.max(u.abs()));
    let acts = |i: usize| r.brake_open[i] && !r.bypass_open[i];
    let mut out = Vec::new();
    for i in 1..r.len() {
        let change = r.voltage_v[i] - r.voltage_v[i - 1];
        if change.abs() < CHANGE * most || most == 0.0 || !acts(i - 1) {
            continue;
        }
        let end = r.time_s.partition_point(|t| *t <= r.time_s[i] + over_s).min(r.len() - 1);
        // the voltage stands until then
        if end < i + 2 || (i..end).any(|j| !acts(j) || r.voltage_v[j] != r.voltage_v[i]) {
            continue;
        }
        let size = (end - i).div_ceil(4).max(1);
        let mean = |from: usize, to: usize| crate::noise::mean((from..to).map(&y)).0;
        let (before, after) = (mean(i.saturating_sub(size), i + 1), mean(end + 1 - size, end + 1));
        // what the motion before would have gone on to
        let trend = (y(i) - y(i.saturating_sub(end - i))).clamp(-f64::MAX, f64::MAX);
        let moved = after - before - if trend.is_finite() { trend } else { 0.0 };
        if moved.is_finite() && moved != 0.0 {
            out.push(moved.signum() * change.signum());
        }
    }
    out
}

fn correlation(pairs: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let (mut n, mut x, mut y, mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (a, b) in pairs {
        n += 1.0;
        x += a;
        y += b;
        xx += a * a;
        yy += b * b;
        xy += a * b;
    }
    let (vx, vy) = (xx / n - (x / n).powi(2), yy / n - (y / n).powi(2));
    (n > 20.0 && vx > 0.0 && vy > 0.0).then(|| (xy / n - x * y / n / n) / (vx * vy).sqrt())
}
