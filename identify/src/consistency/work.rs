//! Virtual work: M dphi = p dV along a path without losses, so dM/dp1 = 0.1 C_v1 (1 bar ml = 0.1 J).

use model::parameters::{COUNT, index};
use recordings::{Protocol, Role};

use super::{Check, Material, Outcome};
use crate::figures::text::number;
use crate::noise::mean;
use crate::prepare::segments;

/// Share of the torque below which the map's departure from virtual work does not matter.
const MATTERS: f64 = 0.05;

pub(super) fn checks(m: &Material) -> Vec<Check> {
    vec![middle(m), map(m)]
}

/// m3 against 0.1 v2: the middle of the map.
fn middle(m: &Material) -> Check {
    let what = "m3 - 0.1 v2: torque and displacement at angle 0";
    let fit = &m.identified.fit;
    let k = fit.layout.parameters(&fit.point.theta).to_vector();
    let mut slope = [0.0; COUNT];
    slope[index::M3] = 1.0;
    slope[index::V2] = -0.1;
    match m.uncertainty.of_combination(&slope) {
        Some(std) => {
            let value = k[index::M3] - 0.1 * k[index::V2];
            let matters = 0.02 * k[index::M3].abs();
            let say = [
                "virtual work holds: the pressure's work is the torque's",
                "not all of the pressure's work reaches the lever: the wall stores energy that depends on pressure, or torque and \
                 volume are not on one scale (check the force sensor's lever arm and the cylinder)",
            ];
            Check::measured("virtual_work", what, (value, std), "Nm/bar", matters, say)
        }
        None => Check::open("virtual_work", what, "Nm/bar", "m3 or v2 is not determined"),
    }
}

/// Over the points of the torque map: what eq. (2) says of the pressures beyond the work of eq. (14).
fn map(m: &Material) -> Check {
    let (id, what, unit) = (
        "virtual_work_map",
        "torque by pressure, eq. (2), less that by virtual work with eq. (14), over the torque map",
        "Nm RMS",
    );
    let fit = &m.identified.fit;
    let p = fit.layout.parameters(&fit.point.theta);
    let mut off = (0.0, 0usize);
    let mut all = 0.0;
    let mut worst = (0.0f64, 0.0);
    let runs = m.loaded.runs.iter();
    for r in runs.filter(|r| r.entry.role == Role::Identify && r.entry.protocol == Protocol::TorqueMap) {
        let r = &r.recording;
        for (first, end) in segments(r) {
            let late = end - (end - first).div_ceil(3);
            let of = |v: &[f64]| mean(v[late..end].iter().copied()).0;
            let (angle, p1, p2) = (of(&r.angle_deg).to_radians(), of(&r.pressure1_bar), of(&r.pressure2_bar));
            let held = mean(r.torque_nm[late..end].iter().copied()).1 * 2 > end - late;
            if !(held && angle.is_finite() && p1.is_finite() && p2.is_finite()) {
                continue;
            }
            let dp = p1 - p2;
            let by_map = p.torque.m1 * dp.abs() * angle + p.torque.m3 * dp;
            // from equal middle pressures on: integral of 0.1 C_v over both pressures
            let middle = model::rec::STORED_FROM_BAR;
            let by_work = 0.1 * (p.displacement.v2 * dp + p.displacement.v1 * angle * (p1 + p2 - 2.0 * middle));
            off.0 += (by_map - by_work).powi(2);
            off.1 += 1;
            all += by_map * by_map;
            if (by_map - by_work).abs() > worst.0 {
                worst = ((by_map - by_work).abs(), angle.to_degrees());
            }
        }
    }
    if off.1 < 3 || all <= 0.0 {
        return Check::open(id, what, unit, "a torque-map run is needed");
    }
    let value = (off.0 / off.1 as f64).sqrt();
    let share = (off.0 / all).sqrt();
    let outcome = if share > MATTERS { Outcome::Fails } else { Outcome::Holds };
    let meaning = format!(
        "{} of the pressures' torque; largest {} Nm at {} deg. {}",
        format_args!("{} %", number(100.0 * share, 2)),
        number(worst.0, 2),
        number(worst.1, 2),
        match outcome {
            Outcome::Fails =>
                "The m1 term of eq. (2) and the v1 term of eq. (14) do not come from one volume V(p, phi): the torque \
                 characteristic holds as a fit, not as physics",
            _ => "Torque and volume characteristics belong together",
        }
    );
    Check { id, what: what.into(), value: Some(value), std: None, unit, outcome, meaning }
}
