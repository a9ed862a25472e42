//! Terms without a name in the flow through pump and line.

use super::{MEASURE, VALIDITY, each_alone, grown, term, through_orifice, typical};
use crate::effects::{Balance, Header, Law, Parameter};
use crate::port::{Port, PortKind, Rest};
use crate::rec::STORED_FROM_BAR;
use crate::scalar::Scalar;

static PUMP: [Parameter; 18] = [
    term("voltage2", "ml/s", 0.05),
    term("voltage_square_odd", "ml/s", 0.05),
    term("voltage3", "ml/s", 0.05),
    term("dp_voltage2", "ml/(s bar)", 0.05),
    term("dp_square_odd", "ml/(s bar^2)", 0.02),
    term("dp3", "ml/(s bar^3)", 0.01),
    term("time_dp", "ml/(s bar)", 0.02),
    term("time_voltage", "ml/s", 0.05),
    term("past_voltage_fast", "ml/s", 0.5),
    term("past_voltage_slow", "ml/s", 0.2),
    term("after_opening", "ml/s", 2.0),
    term("after_closing", "ml/s", 2.0),
    term("dp_root", "ml/(s sqrt(bar))", 0.05),
    term("bypass_root", "ml/(s sqrt(bar))", 2.0),
    term("after_bypass_opening", "ml/(s bar)", 2.0),
    term("after_bypass_closing", "ml/(s bar)", 2.0),
    term("voltage_intake", "ml/(s bar)", 0.05),
    term("voltage_low_intake", "ml bar^2/s", 0.1),
];
static PUMP_STARTS: [[f64; 18]; 18] = typical(&PUMP);

/// Vapour of the oil, nearly: no pump draws from less.
const LEAST_BAR: f64 = 0.2;

/// Flow through pump and line.
pub struct EmpiricalPump;

impl Law for EmpiricalPump {
    const HEADER: Header = Header {
        id: "empirical_pump",
        balance: Balance::Pump,
        ports: &[PortKind::Line],
        summary: "a smooth flow through pump and valves over voltage, its past, the pressures, the valves' past, and time",
        equation: "Q += opening of the brake valve * sum of c_i * term_i, and what the valves pass, or do not yet, after they were switched; voltage in units of 24 V",
        validity: VALIDITY,
        measure: MEASURE,
        literature: "",
        parameters: &PUMP,
        states: 4,
        starts: &each_alone(&PUMP_STARTS),
        passive: false,
    };

    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Line(l) = port {
            let u = l.voltage_v / 24.0;
            dx[0] = (u - x[0]) / 0.01;
            dx[1] = (u - x[1]) / 0.2;
            // what a valve passes shortly after it was switched; it need not open as it closes
            dx[2] = (l.opening - x[2]) / 0.05;
            let past = x[2] - l.opening;
            l.flow_ml_s += if past.value() < 0.0 { k[10] } else { k[11] } * past * u;
            dx[3] = (l.bypass_opening - x[3]) / 0.05;
            let past = x[3] - l.bypass_opening;
            let dp = l.dp_bar();
            l.flow_ml_s += if past.value() < 0.0 { k[14] } else { k[15] } * past * dp;
            if l.bypass_opening.value() > 0.0 {
                l.flow_ml_s += k[13] * through_orifice(dp) * l.bypass_opening;
            }
            // the side that the pump draws from: with little pressure there it fills less
            let intake = l.pressure_bar[if u.value() > 0.0 { 1 } else { 0 }].at_least(LEAST_BAR);
            // through the brake valve as what the pump delivers: none of it where that is closed, also while the bypass is open
            l.flow_ml_s += (k[0] * u * u
                + k[1] * u * u.abs()
                + k[2] * u * u * u
                + k[3] * dp * u * u
                + (k[4] * dp.abs() + k[5] * dp * dp) * dp
                + k[12] * through_orifice(dp)
                + (k[6] * dp + k[7] * u) * grown(l.time_s)
                + (k[16] * (intake - STORED_FROM_BAR) + k[17] / (intake * intake)) * u
                + k[8] * (x[0] - u)
                + k[9] * (x[1] - u))
                * l.opening;
        }
    }

    fn rest<S: Scalar>(&self, _k: &[S], rest: &Rest<S>, x: &mut [S]) {
        x.fill(S::constant(rest.voltage_v / 24.0));
        x[2] = S::constant(f64::from(u8::from(rest.brake_open)));
        x[3] = S::constant(f64::from(u8::from(rest.bypass_open)));
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::alone;
    use super::*;
    use crate::port::LinePort;

    const VOLTAGE_V: f64 = 12.0;

    /// Flow that a term alone adds at this opening, and how the valve's memory moves.
    fn past(term: &str, x: &[f64; 4], opening: f64) -> (f64, f64) {
        let k = alone::<EmpiricalPump>(term, 3.0);
        let mut line = LinePort { opening, open: opening > 0.0, ..LinePort::open(1.0, VOLTAGE_V, 0.7) };
        let mut dx = [0.0; 4];
        EmpiricalPump.act(&k, x, &mut dx, &mut Port::Line(&mut line));
        (line.flow_ml_s, dx[2])
    }

    #[test]
    fn a_valve_s_past_acts_after_its_switch_alone_and_is_forgotten() {
        let settled = |opening: f64| [VOLTAGE_V / 24.0, VOLTAGE_V / 24.0, opening, 0.0];
        for term in ["after_opening", "after_closing"] {
            for opening in [0.0, 1.0] {
                assert_eq!(past(term, &settled(opening), opening), (0.0, 0.0), "a valve that stands");
            }
        }
        let (closed, falls) = past("after_closing", &settled(1.0), 0.0);
        let (opened, rises) = past("after_opening", &settled(0.0), 1.0);
        assert!(closed > 0.0 && closed == -opened, "oil still passes, or does not yet");
        assert!((falls, rises) == (-20.0, 20.0), "forgotten with 50 ms, 1/s");
        assert_eq!(past("after_opening", &settled(1.0), 0.0).0, 0.0, "a valve may close at once");
        assert_eq!(past("after_closing", &settled(0.0), 1.0).0, 0.0, "or open at once");
    }

    #[test]
    fn a_bypass_has_its_own_law_and_its_own_past() {
        let flow = |term: &str, was: f64, opening: f64, dp_bar: f64| {
            let k = alone::<EmpiricalPump>(term, 3.0);
            let mut line = LinePort { bypass_opening: opening, ..LinePort::open(1.0, 0.0, dp_bar) };
            let mut dx = [0.0; 4];
            EmpiricalPump.act(&k, &[0.0, 0.0, 1.0, was], &mut dx, &mut Port::Line(&mut line));
            (line.flow_ml_s, dx[3])
        };
        assert!((flow("bypass_root", 1.0, 1.0, 4.0).0 - 6.0).abs() < 1e-3, "3 times the root of 4 bar");
        assert_eq!(flow("bypass_root", 0.0, 0.0, 4.0).0, 0.0, "a closed one passes nothing");
        for term in ["after_bypass_opening", "after_bypass_closing"] {
            assert_eq!((flow(term, 1.0, 1.0, 2.0), flow(term, 0.0, 0.0, 2.0)), ((0.0, 0.0), (0.0, 0.0)), "it stands");
        }
        assert_eq!(flow("after_bypass_closing", 1.0, 0.0, 2.0), (6.0, -20.0));
        assert_eq!(flow("after_bypass_opening", 0.0, 1.0, 2.0), (-6.0, 20.0));
        assert_eq!(
            (flow("after_bypass_closing", 0.0, 1.0, 2.0).0, flow("after_bypass_opening", 1.0, 0.0, 2.0).0),
            (0.0, 0.0)
        );
    }

    #[test]
    fn a_closed_brake_stops_what_the_pump_delivers_also_beside_an_open_bypass() {
        for term in &PUMP {
            let k = alone::<EmpiricalPump>(term.name, 3.0);
            let flow = |opening: f64| {
                let mut line = LinePort { opening, bypass_opening: 1.0, ..LinePort::open(1.0, VOLTAGE_V, 0.7) };
                let x = [0.1, -0.2, opening, 1.0];
                EmpiricalPump.act(&k, &x, &mut [0.0; 4], &mut Port::Line(&mut line));
                line.flow_ml_s
            };
            match term.name {
                "bypass_root" => assert!(flow(0.0) != 0.0 && flow(0.0) == flow(1.0), "it does not pass the brake"),
                name if name.starts_with("after_") => assert_eq!(flow(0.0), 0.0, "{name}: the valves stand"),
                name => {
                    assert_eq!(flow(0.0), 0.0, "{name}");
                    assert!(flow(1.0) != 0.0 && (flow(0.25) / flow(1.0) - 0.25).abs() < 1e-12, "{name}");
                }
            }
        }
    }

    #[test]
    fn what_fills_less_at_low_pressure_goes_by_the_side_that_the_pump_draws_from() {
        let flow = |term: &str, voltage_v: f64, pressure_bar: [f64; 2]| {
            let k = alone::<EmpiricalPump>(term, -0.8);
            let mut line = LinePort { pressure_bar, ..LinePort::open(1.0, voltage_v, 0.0) };
            let u = voltage_v / 24.0;
            EmpiricalPump.act(&k, &[u, u, 1.0, 0.0], &mut [0.0; 4], &mut Port::Line(&mut line));
            line.flow_ml_s
        };
        // drawn from 2 bar, and from 4
        for (term, low, high) in [("voltage_low_intake", 0.1, 0.025), ("voltage_intake", -0.2, 0.6)] {
            let lost = |pressure_bar| -flow(term, 12.0, pressure_bar);
            assert!((lost([4.0, 2.0]) - low).abs() < 1e-12 && (lost([2.0, 4.0]) - high).abs() < 1e-12, "{term}");
            assert!((flow(term, -12.0, [2.0, 4.0]) - low).abs() < 1e-12, "{term}: the sides are alike");
            assert_eq!(flow(term, 0.0, [2.0, 4.0]), 0.0, "{term}: a pump at rest draws nothing");
        }
        assert!(flow("voltage_low_intake", 12.0, [2.0, 0.0]).is_finite(), "an empty chamber");
    }

    #[test]
    fn a_slip_turns_with_the_pressure() {
        let slip = |term: &str, dp_bar: f64| {
            let k = alone::<EmpiricalPump>(term, -0.5);
            let mut line = LinePort::open(1.0, 0.0, dp_bar);
            EmpiricalPump.act(&k, &[0.0, 0.0, 1.0, 0.0], &mut [0.0; 4], &mut Port::Line(&mut line));
            line.flow_ml_s
        };
        assert_eq!(
            (slip("dp_square_odd", 0.0), slip("dp_square_odd", 2.0), slip("dp_square_odd", -2.0)),
            (0.0, -2.0, 2.0)
        );
        assert_eq!((slip("dp_root", 0.0), slip("dp_root", 4.0) + slip("dp_root", -4.0)), (0.0, 0.0));
        assert!((slip("dp_root", 4.0) + 1.0).abs() < 1e-3, "half the root of 4 bar");
    }
}
