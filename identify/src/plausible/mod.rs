//! Whether recordings can be what their columns say, before anything is fitted to them: broken sensors are set aside, wrong units and
//! signs are refused. Otherwise they would end as effects of the plant.
//!
//! | question | judged by | outcome |
//! |---|---|---|
//! | does a sensor stand still, repeat its twin ([`sensors`]), saturate ([`saturation`]) | what the other sensors and the command show meanwhile | the channel or the run is set aside and said |
//! | is the unit the contract's ([`units`]) | physics: no absolute pressure is negative, no hydraulic rig of this kind works at 280,000 bar; the twin sensor and the other runs | error with the likely unit |
//! | are the signs the contract's ([`signs`]) | the pump: `u > 0` raises `p1 - p2` and turns the lever towards positive angles | error with what is exchanged |
//!
//! Ranges are wide, so that an unusual rig passes; what lies within them is left to the fit.

mod saturation;
mod sensors;
mod series;
mod signs;
mod units;
mod work;

use recordings::{Campaign, Recording, Role};

use saturation::Reach;
pub use sensors::{Fault, Sensor, SetAside};

/// A recording that can't be what its columns say.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: column {column}: expected {expected}, got {got}; {remedy}")]
pub struct Implausible {
    /// The run's file with its folder.
    pub file: String,
    /// Column of the contract, or several.
    pub column: String,
    /// Range or sign.
    pub expected: String,
    /// What is there.
    pub got: String,
    /// The likely cause, and what to do.
    pub remedy: String,
}

/// Sets broken sensors aside (their values become missing, or their runs leave the campaign) and refuses wrong units and signs.
/// Returns what was set aside, in the order of the campaign.
///
/// # Errors
/// Units or signs that can't be the contract's; no run is left to be fitted, or none to be validated where there was one.
pub fn examine(campaign: &mut Campaign, recordings: &mut Vec<Recording>) -> Result<Vec<SetAside>, Implausible> {
    let mut found = Vec::new();
    let mut lost = vec![false; recordings.len()];
    let reaches: Vec<Reach> = recordings.iter().map(|r| Reach::of(&r.angle_deg)).collect();
    for (n, (entry, recording)) in campaign.runs.iter().zip(recordings.iter_mut()).enumerate() {
        // what is fitted is not changed by what is only simulated
        let told =
            |other: usize| other != n && (entry.role == Role::Validate || campaign.runs[other].role == entry.role);
        let others = reaches.iter().enumerate().filter(|(other, _)| told(*other)).map(|(_, reach)| *reach);
        let own = sensors::broken(entry, recording, others.fold(Reach::NONE, Reach::with));
        lost[n] = own.iter().any(|s| s.whole_run);
        found.extend(own);
    }
    let kept = |role: Role| (0..lost.len()).filter(|&n| campaign.runs[n].role == role && !lost[n]).count();
    let had = |role: Role| campaign.runs.iter().any(|r| r.role == role);
    for role in [Role::Identify, Role::Validate] {
        if had(role) && kept(role) == 0 {
            return Err(nothing_left(campaign, &found, role));
        }
    }
    let mut keep = lost.iter().map(|l| !l);
    campaign.runs.retain(|_| keep.next() == Some(true));
    let mut keep = lost.iter().map(|l| !l);
    recordings.retain(|_| keep.next() == Some(true));
    units::judge(campaign, recordings)?;
    signs::judge(campaign, recordings)?;
    work::judge(campaign, recordings)?;
    Ok(found)
}

fn nothing_left(campaign: &Campaign, found: &[SetAside], role: Role) -> Implausible {
    let of_role = |s: &&SetAside| s.whole_run && campaign.runs.iter().any(|r| r.file == s.file && r.role == role);
    let broken: Vec<&SetAside> = found.iter().filter(of_role).collect();
    let first = broken[0];
    let others: Vec<String> = broken.iter().skip(1).map(|s| format!("; {}: {}", s.file, s.said())).collect();
    Implausible {
        file: campaign.dir.join(&first.file).display().to_string(),
        column: first.columns(),
        expected: format!("at least one run with role \"{role}\" whose sensors work"),
        got: format!("{}{}", first.why, others.concat()),
        remedy: "repair the sensor and record the run again, or take the run out of the campaign; a broken sensor is no effect of the plant"
            .into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::{Plane, Protocol, RigFacts, RunEntry};

    /// A lever that is driven to and fro by 20 degrees, as an encoder with coarse steps shows it that ends at `limit_deg`, or as a stop that is as hard.
    fn driven(limit_deg: f64) -> Recording {
        let mut r = Recording::default();
        let (mut angle_deg, mut dp_bar) = (0.0_f64, 0.0);
        for row in 0..6000 {
            let half_waves = row / 200;
            let side = if half_waves % 2 == 0 { 1.0 } else { -1.0 };
            let voltage_v = if row < 100 { 0.0 } else { 10.0 * side };
            let ripple_bar = 0.01 * (f64::from(row) * 12.9898).sin();
            r.time_s.push(f64::from(row) * 0.01);
            r.voltage_v.push(voltage_v);
            r.angle_deg.push(((angle_deg / 0.1).round() * 0.1).clamp(-limit_deg, limit_deg));
            r.pressure1_bar.push(3.0 + dp_bar / 2.0 + ripple_bar);
            r.pressure2_bar.push(3.1 - dp_bar / 2.0 + 0.5 * ripple_bar);
            r.torque_nm.push(f64::NAN);
            r.volume_ml.push(f64::NAN);
            r.brake_open.push(true);
            r.bypass_open.push(false);
            r.segment.push(i64::from(half_waves));
            angle_deg += 0.02 * voltage_v;
            dp_bar += 0.1 * (0.1 * voltage_v - dp_bar);
        }
        r
    }

    #[test]
    fn no_run_that_is_only_simulated_decides_what_is_fitted() {
        for (wide, cut) in [(Role::Identify, true), (Role::Validate, false)] {
            let roles = [Role::Identify, wide, Role::Validate];
            let entry = |(n, role): (usize, Role)| RunEntry {
                file: format!("{n}.csv"),
                protocol: Protocol::SquareWave,
                role,
                plane: Plane::Horizontal,
            };
            let rig = RigFacts { inertia_kg_m2: 0.085, gravity_nm: 4.0, u_max_v: 24.0 };
            let runs = roles.into_iter().enumerate().map(entry).collect();
            let mut campaign = Campaign { dir: "made".into(), name: "made".into(), rig, runs };
            let mut recordings = vec![driven(12.0), driven(90.0), driven(12.0)];
            let found = examine(&mut campaign, &mut recordings).unwrap();
            let in_first = found.iter().any(|s| s.file == "0.csv" && s.fault == Fault::Saturated);
            assert_eq!(in_first, cut, "{wide:?}: {found:?}");
            assert!(found.iter().any(|s| s.file == "2.csv"), "what is only simulated is judged by all");
        }
    }
}
