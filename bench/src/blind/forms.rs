//! Other forms of effects that the library has. A name is the claim, not the equation: another simulator writes the same friction or the
//! same leak in another way, and the diagnosis must name it all the same. None of them is a case of a law in the library, general forms
//! (`Law::REFINED`) included: what another simulator writes need not be one either.

mod chambers;
mod pump;

use chambers::DisplacementStraightens;
use model::effects::{Balance, Effect, Header, Law, Parameter};
use model::port::{AMBIENT_BAR, Arrival, Port, PortKind, Rest};
use model::scalar::Scalar;
use pump::{PumpLagSecondOrder, PumpWarmingByLosses, PumpWarmingTwoMasses};

/// The id that each form stands for, and the form.
pub static FORMS: &[(&str, &dyn Effect)] = &[
    ("elastic_hysteresis", &StickSlip),
    ("stribeck_friction", &StribeckLogistic),
    ("pressure_friction", &PressureFrictionRational),
    ("end_stop", &EndStopPadded),
    ("wall_creep", &WallCreepThreeTimes),
    ("displacement_pressure", &DisplacementStraightens),
    ("cross_leakage", &CrossLeakageGap),
    ("external_leakage", &ExternalLeakageGap),
    ("trapped_air", &TrappedAirPolytropic),
    ("pump_lag", &PumpLagSecondOrder),
    ("pump_warming", &PumpWarmingTwoMasses),
    ("pump_warming", &PumpWarmingByLosses),
    ("pressure_drift", &PressureDriftTwoTimes),
];

/// The name by which an effect must be found: of a form the id that it stands for, of any other its own.
pub fn name_of(effect: &dyn Effect) -> &'static str {
    let id = effect.header().id;
    FORMS.iter().find(|(_, form)| form.header().id == id).map_or(id, |(name, _)| name)
}

const VALIDITY: &str = "stands in for another simulator's form";
const MEASURE: &str = "as the effect of that name";

const fn size(name: &'static str, unit: &'static str, upper: f64, typical: f64) -> Parameter {
    Parameter { name, unit, lower: 0.0, upper, typical, size: true }
}

const fn shape(name: &'static str, unit: &'static str, lower: f64, upper: f64, typical: f64) -> Parameter {
    Parameter { name, unit, lower, upper, typical, size: false }
}

/// Header of a form; what all have in common.
const fn header(
    id: &'static str,
    balance: Balance,
    ports: &'static [PortKind],
    equation: &'static str,
    parameters: &'static [Parameter],
    states: usize,
    starts: &'static [&'static [f64]],
) -> Header {
    Header {
        id,
        balance,
        ports,
        summary: "another form of a known effect",
        equation,
        validity: VALIDITY,
        measure: MEASURE,
        literature: "",
        parameters,
        states,
        starts,
        passive: false,
    }
}

/// Hysteresis of four elements that stick and slip, on ways that differ by a factor of 25 and follow no law (Iwan, J. Appl. Mech. 33, 1966), each of them rounded
/// off a little: the branches have four bends.
struct StickSlip;

impl StickSlip {
    /// Of each element: its share of the torque, and of the way.
    const ELEMENTS: [(f64, f64); 4] = [(0.2, 0.2), (0.3, 0.5), (0.3, 1.7), (0.2, 5.0)];

    /// z' of an element whose way is `d`.
    fn rate<S: Scalar>(z: S, w: S, d: S) -> S {
        let square = z * z;
        (w - w.abs() * z * square * square) / d
    }
}

impl Law for StickSlip {
    const HEADER: Header = header(
        "elastic_hysteresis_stick_slip",
        Balance::Torque,
        &[PortKind::Mechanical],
        "M -= k*(0.2*z1 + 0.3*z2 + 0.3*z3 + 0.2*z4), 0.2*d*z1' = w - abs(w)*z1^5, 0.5*d*z2', 1.7*d*z3' and 5*d*z4' alike",
        &[size("k", "Nm", 10.0, 0.2), shape("d", "rad", 0.002, 1.5, 0.1)],
        4,
        &[&[0.1, 0.05], &[0.3, 0.15], &[0.3, 0.4]],
    );

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            for (i, (torque, way)) in Self::ELEMENTS.into_iter().enumerate() {
                dx[i] = Self::rate(x[i], m.velocity_rad_s, k[1] * way);
                m.torque_nm -= k[0] * x[i] * torque;
            }
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x.fill(S::zero());
        // along the way on which the lever was led, in steps that are short against d
        let Arrival::Led(way_rad) = rest.arrival else { return };
        for leg in way_rad.windows(2) {
            let way = leg[1] - leg[0];
            let steps = (way.abs() / (0.008 * k[1].value())).ceil().min(12_500.0);
            for _ in 0..steps as usize {
                for (z, (_, share)) in x.iter_mut().zip(Self::ELEMENTS) {
                    *z += Self::rate(*z, S::constant(way / steps), k[1] * share);
                }
            }
        }
    }
}

/// A peak that falls as a logistic function, 2/(1 + exp(w/w_v)): straight at first, exponentially far off.
struct StribeckLogistic;

impl Law for StribeckLogistic {
    const HEADER: Header = header(
        "stribeck_friction_logistic",
        Balance::Torque,
        &[PortKind::Mechanical],
        "M -= k*(1 - tanh(abs(w)/(2*w_v)))*tanh(w/w_s)",
        &[size("k", "Nm", 10.0, 0.2), shape("w_v", "rad/s", 0.01, 3.0, 0.1), shape("w_s", "rad/s", 0.002, 0.2, 0.02)],
        0,
        &[&[0.1, 0.1, 0.02], &[0.3, 0.3, 0.02], &[0.3, 0.6, 0.01]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let w = m.velocity_rad_s;
            let fallen = (w.abs() / k[1] * 0.5).tanh();
            m.torque_nm -= k[0] * (S::constant(1.0) - fallen) * (w / k[2]).tanh();
        }
    }
}

/// The Coulomb level smoothed by w/sqrt(w^2 + w_s^2).
struct PressureFrictionRational;

impl Law for PressureFrictionRational {
    const HEADER: Header = header(
        "pressure_friction_rational",
        Balance::Torque,
        &[PortKind::Mechanical],
        "M -= k*max(0, p1 + p2 - 2*p_amb)*w/sqrt(w^2 + w_s^2)",
        &[size("k", "Nm/bar", 5.0, 0.1), shape("w_s", "rad/s", 0.002, 0.2, 0.02)],
        0,
        &[&[0.05, 0.02], &[0.3, 0.03]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let w = m.velocity_rad_s;
            m.torque_nm -= k[0] * m.load_bar.at_least(0.0) * w / (w * w + k[1] * k[1]).sqrt();
        }
    }
}

/// Depth at which a pad is pressed flat, rad.
const PAD_RAD: f64 = 0.08;
/// Stiffness of what is behind the pad, in terms of the pad's.
const BEHIND_PAD: f64 = 4.0;

/// A pad before a harder stop: the stiffness has a step in it.
struct EndStopPadded;

impl Law for EndStopPadded {
    const HEADER: Header = header(
        "end_stop_padded",
        Balance::Torque,
        &[PortKind::Mechanical],
        "M -= k*(d + 4*max(0, d - 0.08 rad))*sign(phi), d = max(0, abs(phi) - phi_c)",
        &[size("k", "Nm/rad", 500.0, 10.0), shape("phi_c", "deg", 15.0, 60.0, 30.0)],
        0,
        &[&[4.0, 24.0], &[10.0, 27.0], &[10.0, 32.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let depth = (m.angle_rad.abs() - k[1] * (std::f64::consts::PI / 180.0)).at_least(0.0);
            let behind = (depth - PAD_RAD).at_least(0.0) * BEHIND_PAD;
            let sign = if m.angle_rad.value() < 0.0 { -1.0 } else { 1.0 };
            m.torque_nm -= k[0] * (depth + behind) * sign;
        }
    }
}

/// Share of the capacity and time constant, in terms of the first, of each Kelvin-Voigt branch.
const BRANCHES: [(f64, f64); 3] = [(0.5, 1.0), (0.3, 4.0), (0.2, 16.0)];

/// Three Kelvin-Voigt branches, each slower by a factor of 4.
struct WallCreepThreeTimes;

impl Law for WallCreepThreeTimes {
    const HEADER: Header = header(
        "wall_creep_three_times",
        Balance::Flow,
        &[PortKind::Hydraulic],
        "as wall_creep, with 0.5*C_c at tau, 0.3*C_c at 4*tau and 0.2*C_c at 16*tau",
        &[size("C_c", "ml/bar", 30.0, 0.3), shape("tau", "s", 0.05, 30.0, 0.6)],
        6,
        &[&[0.1, 0.15], &[0.2, 0.4], &[0.2, 1.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (n, x) in x.iter().enumerate() {
                let (i, (share, slower)) = (n % 2, BRANCHES[n / 2]);
                let gauge = h.pressure_bar[i] - AMBIENT_BAR;
                dx[n] = (k[0] * gauge * share - *x) / (k[1] * slower);
                h.flow_ml_s[i] -= dx[n];
            }
        }
    }

    fn rest<S: Scalar>(&self, k: &[S], rest: &Rest<S>, x: &mut [S]) {
        for (n, x) in x.iter_mut().enumerate() {
            *x = k[0] * rest.gauge_bar(n % 2) * BRANCHES[n / 2].0;
        }
    }
}

/// Flow through a laminar gap and an orifice in series, with q in terms of what the gap alone lets through at 1 bar: abs(dp) = q + q^2/e. The
/// two take the same share at q = e.
fn gap_and_orifice<S: Scalar>(dp_bar: S, even_bar: f64) -> S {
    // the root without a difference of like numbers
    let root = (dp_bar.abs() * (4.0 / even_bar) + 1.0).sqrt();
    dp_bar * 2.0 / (root + 1.0)
}

/// A laminar gap in series with an orifice.
struct CrossLeakageGap;

impl Law for CrossLeakageGap {
    const HEADER: Header = header(
        "cross_leakage_gap",
        Balance::Flow,
        &[PortKind::Hydraulic],
        "abs(dp) = q/k + (q/k)^2/0.1 from chamber 1 to chamber 2; none where the chambers are shut off one by one",
        &[size("k", "ml/(s bar)", 40.0, 0.2)],
        0,
        &[&[0.03], &[0.3]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port
            && !h.shut_off
        {
            let dp = h.pressure_bar[0] - h.pressure_bar[1];
            let leak = k[0] * gap_and_orifice(dp, 0.1);
            h.flow_ml_s[0] -= leak;
            h.flow_ml_s[1] += leak;
        }
    }
}

/// A leak through a laminar gap and an orifice behind it.
struct ExternalLeakageGap;

impl Law for ExternalLeakageGap {
    const HEADER: Header = header(
        "external_leakage_gap",
        Balance::Flow,
        &[PortKind::Hydraulic],
        "g = q_i/k_i + (q_i/k_i)^2/0.5 out of chamber i, g its gauge pressure",
        &[size("k1", "ml/(s bar)", 5.0, 0.01), size("k2", "ml/(s bar)", 5.0, 0.01)],
        0,
        &[&[0.005, 0.0], &[0.0, 0.005], &[0.004, 0.004]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (i, k) in k.iter().enumerate() {
                let gauge = h.pressure_bar[i] - AMBIENT_BAR;
                h.flow_ml_s[i] -= *k * gap_and_orifice(gauge, 0.5);
            }
        }
    }
}

/// Air that is compressed faster than it gives up its heat.
struct TrappedAirPolytropic;

impl Law for TrappedAirPolytropic {
    const HEADER: Header = header(
        "trapped_air_polytropic",
        Balance::Flow,
        &[PortKind::Hydraulic],
        "C_hi += V_ai*(p_amb/p_i)^(1/1.25)/(1.25*p_i)",
        &[size("V_a1", "ml", 60.0, 0.5), size("V_a2", "ml", 60.0, 0.5)],
        0,
        &[&[0.5, 0.0], &[0.0, 0.5], &[1.0, 0.4]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            for (i, volume) in k.iter().enumerate() {
                let p = h.pressure_bar[i];
                let share = (S::constant(AMBIENT_BAR) / p).powf(S::constant(1.0 / 1.25));
                h.capacity_ml_bar[i] += *volume * share / (p * 1.25);
            }
        }
    }
}

/// A bridge that warms soon, in a housing that follows late.
struct PressureDriftTwoTimes;

impl Law for PressureDriftTwoTimes {
    const HEADER: Header = header(
        "pressure_drift_two_times",
        Balance::Sensor,
        &[PortKind::Sensor],
        "p_i shown = p_i + o_i + d_i*(1 - 0.5*exp(-t/tau) - 0.5*exp(-t/(10*tau)))",
        &[
            Parameter { name: "o1", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.02, size: true },
            Parameter { name: "d1", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.05, size: true },
            Parameter { name: "o2", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.02, size: true },
            Parameter { name: "d2", unit: "bar", lower: -2.0, upper: 2.0, typical: 0.05, size: true },
            shape("tau", "s", 2.0, 60.0, 10.0),
        ],
        0,
        &[&[0.0, 0.05, 0.0, 0.0, 10.0], &[0.03, 0.0, 0.0, 0.0, 20.0], &[0.0, 0.0, 0.02, -0.03, 6.0]],
    );

    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Sensor(s) = port {
            let time = S::constant(s.time_s) / k[4];
            let grown = -((-time).exp() + (time * -0.1).exp()) * 0.5 + 1.0;
            for i in 0..2 {
                s.pressure_bar[i] += k[2 * i] + k[2 * i + 1] * grown;
            }
        }
    }
}

#[cfg(test)]
mod tests;
