//! Terms without a name in the balance of the chambers' oil.

use super::{MEASURE, VALIDITY, each_alone, term, through_orifice, typical};
use crate::effects::{Balance, Header, Law, Parameter};
use crate::port::{AMBIENT_BAR, Port, PortKind, Rest};
use crate::scalar::Scalar;

static FLOW: [Parameter; 23] = [
    term("leak_both", "ml/(s bar)", 0.002),
    term("leak_difference", "ml/(s bar)", 0.002),
    term("leak_square", "ml/(s bar^2)", 0.001),
    term("transfer", "ml/(s bar)", 0.01),
    term("transfer_cubic", "ml/(s bar^3)", 0.01),
    term("capacity_low_pressure", "ml bar", 0.1),
    term("capacity_low_pressure_difference", "ml bar", 0.1),
    term("capacity_difference", "ml/bar", 0.02),
    term("capacity_angle2", "ml/bar", 0.05),
    term("capacity_angle4", "ml/bar", 0.05),
    term("displacement_pressure", "ml/(rad bar)", 0.2),
    term("displacement_difference", "ml/rad", 0.2),
    term("displacement_angle2", "ml/rad", 0.5),
    term("past_pressure", "ml/(s bar)", 0.02),
    term("transfer_root", "ml/(s sqrt(bar))", 0.02),
    term("leak_over2", "ml/(s bar)", 0.005),
    term("leak_over3", "ml/(s bar)", 0.005),
    term("leak_over4", "ml/(s bar)", 0.005),
    term("past_pressure_slow", "ml/(s bar)", 0.02),
    term("transfer_one_way", "ml/(s bar)", 0.01),
    term("transfer_over", "ml/(s bar)", 0.01),
    term("transfer_back_over", "ml/(s bar)", 0.01),
    term("capacity_common", "ml/bar", 0.02),
];
static FLOW_STARTS: [[f64; 23]; 23] = typical(&FLOW);

/// Pressures from which on a leak may grow faster: a valve that weeps, a joint that gapes.
const OPENS_BAR: [f64; 3] = [2.0, 3.0, 4.0];
/// Time over which the rate of the pressure difference is taken, s: short against all that a lever does.
const COMMON_S: f64 = 0.03;
/// Pressure that cracks a valve between the chambers.
const CRACKS_BAR: f64 = 0.5;

/// Flows into the chambers, their capacity and displacement.
pub struct EmpiricalFlow;

impl Law for EmpiricalFlow {
    const HEADER: Header = Header {
        id: "empirical_flow",
        balance: Balance::Flow,
        ports: &[PortKind::Hydraulic],
        summary: "flows, capacities and displacements over pressure, its past, and angle",
        equation: "q_i, C_i, C_v,i += sum of c_i * term_i; angle in units of 0.7 rad",
        validity: VALIDITY,
        measure: MEASURE,
        literature: "",
        parameters: &FLOW,
        states: 5,
        starts: &each_alone(&FLOW_STARTS),
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Hydraulic(h) = port {
            let dp = h.pressure_bar[0] - h.pressure_bar[1];
            let a = h.angle_rad / 0.7;
            if !h.shut_off {
                let smooth = k[3] * dp + k[4] * dp * dp * dp + k[14] * through_orifice(dp);
                let over = |dp: S| (dp - CRACKS_BAR).at_least(0.0);
                let transfer = smooth + k[19] * dp.at_least(0.0) + k[20] * over(dp) - k[21] * over(-dp);
                h.flow_ml_s[0] -= transfer;
                h.flow_ml_s[1] += transfer;
            }
            // what a wall between the chambers gives as one of them rises against the other: its capacity times the rate of the difference
            dx[4] = (dp - x[4]) / COMMON_S;
            let common = k[22] * dx[4];
            h.flow_ml_s[0] -= common;
            h.flow_ml_s[1] += common;
            for (i, side) in [(0, 1.0), (1, -1.0)] {
                let p = h.pressure_bar[i];
                let gauge = p - AMBIENT_BAR;
                // half a second's memory of the pressure, as of a joint that gives; four seconds', as of a wall
                dx[i] = (p - x[i]) / 0.5;
                dx[2 + i] = (p - x[2 + i]) / 4.0;
                h.flow_ml_s[i] -= gauge * (k[0] + k[1] * side + k[2] * gauge.abs());
                h.flow_ml_s[i] -= k[13] * (p - x[i]) + k[18] * (p - x[2 + i]);
                for (over, n) in OPENS_BAR.into_iter().zip(15..) {
                    h.flow_ml_s[i] -= k[n] * (p - over).at_least(0.0);
                }
                h.capacity_ml_bar[i] += (k[5] + k[6] * side) / (p * p) + k[7] * side + (k[8] + k[9] * a * a) * a * a;
                h.displacement_ml_rad[i] += k[10] * (p - 2.5) * side + k[11] + k[12] * a * a * side;
            }
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        for i in 0..2 {
            (x[i], x[2 + i]) = (rest.pressure_bar[i], rest.pressure_bar[i]);
        }
        x[4] = rest.pressure_bar[0] - rest.pressure_bar[1];
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::alone;
    use super::*;
    use crate::port::HydraulicPort;

    /// The past of pressures that do not change.
    fn still([p1, p2]: [f64; 2]) -> [f64; 5] {
        [p1, p2, p1, p2, p1 - p2]
    }

    /// Flow and capacity of a term of 0.3 alone.
    fn acts(term: &str, pressure_bar: [f64; 2]) -> ([f64; 2], [f64; 2]) {
        let k = alone::<EmpiricalFlow>(term, 0.3);
        let mut port = HydraulicPort::at(1.0, pressure_bar);
        EmpiricalFlow.act(&k, &still(pressure_bar), &mut [0.0; 5], &mut Port::Hydraulic(&mut port));
        (port.flow_ml_s, port.capacity_ml_bar)
    }

    #[test]
    fn what_one_chamber_lacks_and_what_grows_with_the_square_of_the_pressure_have_their_terms() {
        let (_, both) = acts("capacity_low_pressure", [2.0, 2.0]);
        let (_, apart) = acts("capacity_low_pressure_difference", [2.0, 2.0]);
        assert_eq!((both[0] + apart[0], both[1] + apart[1]), (0.15, 0.0), "air in chamber 1 alone");
        let (flow, _) = acts("leak_square", [AMBIENT_BAR, AMBIENT_BAR + 2.0]);
        assert!(flow[0] == 0.0 && (flow[1] + 1.2).abs() < 1e-12, "out of what is above ambient: {flow:?}");
    }

    #[test]
    fn what_opens_over_a_pressure_is_shut_below() {
        for over in OPENS_BAR {
            let out = |pressure: f64| acts(&format!("leak_over{over}"), [pressure, 1.0]).0[0];
            assert_eq!((out(over - 0.5), out(over)), (0.0, 0.0));
            assert!((out(over + 2.0) + 0.6).abs() < 1e-12, "0.3 times two bar: {}", out(over + 2.0));
        }
    }

    #[test]
    fn what_passes_an_orifice_leaves_one_chamber_and_enters_the_other_unless_it_is_shut_off() {
        let k = alone::<EmpiricalFlow>("transfer_root", 0.3);
        let flow = |pressure_bar: [f64; 2], shut_off: bool| {
            let mut port = HydraulicPort { shut_off, ..HydraulicPort::at(1.0, pressure_bar) };
            EmpiricalFlow.act(&k, &still(pressure_bar), &mut [0.0; 5], &mut Port::Hydraulic(&mut port));
            port.flow_ml_s
        };
        let [one, other] = flow([6.0, 2.0], false);
        assert!((one + 0.6).abs() < 1e-3 && one + other == 0.0, "0.3 times the root of 4 bar: {one} {other}");
        assert_eq!(flow([2.0, 6.0], false), [other, one], "the chambers are alike");
        assert_eq!(flow([3.0, 3.0], false), [0.0, 0.0]);
        assert_eq!(flow([6.0, 2.0], true), [0.0, 0.0]);
    }

    #[test]
    fn what_opens_one_way_is_shut_the_other() {
        for (term, opens_bar, way) in
            [("transfer_one_way", 0.0, 1.0), ("transfer_over", 0.5, 1.0), ("transfer_back_over", 0.5, -1.0)]
        {
            let flow = |dp: f64| acts(term, [3.0 + dp, 3.0]).0;
            let open = flow(2.0 * way);
            assert!(
                (open[0] + 0.3 * (2.0 - opens_bar) * way).abs() < 1e-12 && open[0] + open[1] == 0.0,
                "{term}: {open:?}"
            );
            assert_eq!((flow(-2.0 * way), flow(0.9 * opens_bar * way)), ([0.0, 0.0], [0.0, 0.0]), "{term}");
        }
    }

    #[test]
    fn a_common_wall_takes_from_the_chamber_that_rises_and_gives_to_the_other() {
        let k = alone::<EmpiricalFlow>("capacity_common", 0.3);
        let mut port = HydraulicPort::at(1.0, [3.0, 2.0]);
        let mut x = still([3.0, 2.0]);
        // the difference rises by 2 bar a second
        x[4] -= 2.0 * COMMON_S;
        EmpiricalFlow.act(&k, &x, &mut [0.0; 5], &mut Port::Hydraulic(&mut port));
        assert!((port.flow_ml_s[0] + 0.6).abs() < 1e-9 && port.flow_ml_s[0] + port.flow_ml_s[1] == 0.0);
        assert_eq!(acts("capacity_common", [4.0, 2.0]).0, [0.0, 0.0], "at rest");
    }

    #[test]
    fn a_chamber_s_past_shows_after_a_change_alone_fast_or_slow() {
        for (term, state, per_second) in [("past_pressure", 0, 2.0), ("past_pressure_slow", 2, 0.25)] {
            let k = alone::<EmpiricalFlow>(term, 0.3);
            let flow = |pressure_bar: [f64; 2]| {
                let mut port = HydraulicPort::at(1.0, pressure_bar);
                let mut dx = [0.0; 5];
                EmpiricalFlow.act(&k, &still([2.0, 3.0]), &mut dx, &mut Port::Hydraulic(&mut port));
                (port.flow_ml_s, dx[state])
            };
            assert_eq!(flow([2.0, 3.0]), ([0.0, 0.0], 0.0), "{term} at rest");
            let (out, rate) = flow([3.0, 3.0]);
            assert!((out[0] + 0.3).abs() < 1e-12 && out[1] == 0.0, "{term}: {out:?}");
            assert!((rate - per_second).abs() < 1e-12, "{term} forgets: {rate}");
        }
    }
}
