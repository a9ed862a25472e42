//! The characteristics of the REC actuator's parts, as functions of the parameter vector ([`crate::parameters::NAMES`]).

use crate::parameters::index::*;
use crate::scalar::Scalar;

/// From this pressure (bar absolute) the oil stored by pressure is counted: a middle pressure of the paper.
pub const STORED_FROM_BAR: f64 = 2.5;

pub(crate) const DEGREES: f64 = 180.0 / std::f64::consts::PI;

/// Torque, eq. (2), odd in (phi, dp), Nm.
#[inline(always)]
pub fn torque<S: Scalar>(k: &[S], angle_rad: S, dp_bar: S) -> S {
    (k[M1] * dp_bar.abs() + k[M2]) * angle_rad + k[M3] * dp_bar
}

/// Capacities of both chambers, eq. (13), ml/bar; the second is the first mirrored.
#[inline(always)]
pub fn capacity<S: Scalar>(k: &[S], angle_rad: S, pressure_bar: [S; 2]) -> [S; 2] {
    let bend = (k[A1] * (angle_rad * DEGREES)).exp();
    let scale = if k[A2].value() == 0.0 { S::constant(1.0) - k[A2] } else { (-k[A2]).exp() };
    let of = |p: S| k[H1] * p.powf(k[H2]) + k[H3];
    [scale / bend * of(pressure_bar[0]), scale * bend * of(pressure_bar[1])]
}

/// Displacements of both chambers, eq. (14), ml/rad.
#[inline(always)]
pub fn displacement<S: Scalar>(k: &[S], angle_rad: S) -> [S; 2] {
    let even = k[V1] * angle_rad;
    [even + k[V2], even - k[V2]]
}

/// Pump flow, eq. (10) with its dead zone, ml/s, and whether the pump delivers (is out of the dead zone).
#[inline(always)]
pub fn pump_flow<S: Scalar>(k: &[S], voltage_v: S, dp_bar: S) -> (S, bool) {
    let slip = k[F3] * dp_bar;
    let drive = k[F1] * voltage_v.abs() + k[F4] + k[F2] * voltage_v * dp_bar;
    if drive.value() > 0.0 && voltage_v.value() != 0.0 {
        (if voltage_v.value() > 0.0 { slip + drive } else { slip - drive }, true)
    } else {
        (slip, false)
    }
}

/// Losses, eq. (16), odd in the velocity, Nm, and the branch: 0 within |w| < a, 1 above, 2 below.
#[inline(always)]
pub fn losses<S: Scalar>(k: &[S], velocity_rad_s: S) -> (S, u32) {
    let w = velocity_rad_s;
    let a = k[A].value();
    if w.value() >= a {
        ((k[L1] * w + k[L2]) * w + k[L3], 1)
    } else if w.value() <= -a {
        ((k[L2] - k[L1] * w) * w - k[L3], 2)
    } else {
        (k[L4] * w, 0)
    }
}

/// Slope over the angle (ml/rad) of the oil that pressure has stored since [`STORED_FROM_BAR`]:
/// d/dphi of exp(-(a1 phi + a2)) * integral of (h1 p^h2 + h3) dp. It is what C_v lacks for eqs. (13) and (14) to have a
/// common volume function.
pub fn stored_slope<S: Scalar>(k: &[S], angle_rad: S, pressure_bar: [S; 2]) -> [S; 2] {
    let bend = (k[A1] * (angle_rad * DEGREES)).exp();
    let scale = (-k[A2]).exp();
    let rate = k[A1] * DEGREES;
    let n = k[H2] + 1.0;
    let stored = |p: S| {
        let log = (p / STORED_FROM_BAR).ln();
        // (p^n - q^n)/n, continuous at n = 0
        let power =
            if n.value().abs() < 1e-6 { log } else { ((n * log).exp() - 1.0) / n * (n * STORED_FROM_BAR.ln()).exp() };
        k[H1] * power + k[H3] * (p - STORED_FROM_BAR)
    };
    [-(rate * scale / bend) * stored(pressure_bar[0]), rate * scale * bend * stored(pressure_bar[1])]
}
