//! Turns a script's target into a voltage: open loop, or constant flow through the inverted pump characteristic.

use model::parameters::Pump;
use rt_core::{Controller, Measurement, Step, Target, Tick};

/// Voltage as the script says it, or for a flow through the inverted eq. (10) at the measured pressure difference.
///
/// The pump's parameters come from a measured pump map. Without them a flow target is answered with NaN, which the
/// supervisor takes for what it is: no valid command.
#[derive(Clone, Copy, Debug)]
pub struct PumpController {
    pump: Option<Pump>,
    /// Last measured pressure difference, bar: bridges samples in which a pressure is missing.
    dp_bar: f64,
}

impl PumpController {
    /// Open loop only.
    pub fn open_loop() -> Self {
        PumpController { pump: None, dp_bar: f64::NAN }
    }

    /// Flow targets too, with this pump.
    pub fn with_pump(pump: Pump) -> Self {
        PumpController { pump: Some(pump), dp_bar: f64::NAN }
    }
}

impl Controller for PumpController {
    fn control(&mut self, _now: Tick, measured: &Measurement, step: &Step) -> f64 {
        let dp_bar = measured.pressure1_bar - measured.pressure2_bar;
        if dp_bar.is_finite() {
            self.dp_bar = dp_bar;
        }
        match (step.target, &self.pump) {
            (Target::VoltageV(voltage_v), _) => voltage_v,
            (Target::FlowMlS(flow_ml_s), Some(pump)) => voltage_for_flow(pump, flow_ml_s, self.dp_bar),
            _ => f64::NAN,
        }
    }
}

/// The voltage (V, within +-u_max) at which the pump delivers `flow_ml_s` (ml/s, from chamber 2 to chamber 1) against
/// `dp_bar` = p1 - p2 (bar): eq. (10) solved for u. Where no voltage within the range reaches the flow, the end of the range
/// that comes closest; 0 where the slip alone is the flow.
///
/// NaN in, NaN out.
pub fn voltage_for_flow(pump: &Pump, flow_ml_s: f64, dp_bar: f64) -> f64 {
    // What the gears have to deliver beside the slip: sgn(u) (f1 |u| + f4 + f2 u dp).
    let driven_ml_s = flow_ml_s - pump.f3 * dp_bar;
    if driven_ml_s == 0.0 || driven_ml_s.is_nan() {
        return driven_ml_s;
    }
    let sign = driven_ml_s.signum();
    let gain_ml_s_v = pump.f1 + sign * pump.f2 * dp_bar;
    let wanted_ml_s = driven_ml_s.abs() - pump.f4;
    if wanted_ml_s <= 0.0 {
        // f4 > 0: the pump would deliver more than this at the smallest voltage.
        return 0.0;
    }
    let size_v = if gain_ml_s_v > 0.0 { wanted_ml_s / gain_ml_s_v } else { f64::INFINITY };
    sign * size_v.min(pump.u_max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Parameters;
    use model::rec::pump_flow;
    use rt_core::Fixture;

    fn step(target: Target) -> Step {
        Step { target, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0, index: 0, last: false }
    }

    fn measured(pressure1_bar: f64, pressure2_bar: f64) -> Measurement {
        Measurement { pressure1_bar, pressure2_bar, ..Measurement::NONE }
    }

    #[test]
    fn the_pump_of_the_model_delivers_what_was_asked_for() {
        let parameters = Parameters::example();
        let k = parameters.to_vector();
        let mut reached = 0;
        for tenths in -150..=150 {
            for dp in [-4.0, -1.5, 0.0, 0.3, 4.0] {
                let flow_ml_s = f64::from(tenths) * 0.1;
                let voltage_v = voltage_for_flow(&parameters.pump, flow_ml_s, dp);
                assert!(voltage_v.abs() <= parameters.pump.u_max);
                let (delivered, _) = pump_flow(&k, voltage_v, dp);
                if voltage_v.abs() < parameters.pump.u_max {
                    assert!((delivered - flow_ml_s).abs() < 1e-9, "{flow_ml_s} ml/s at {dp} bar: got {delivered}");
                    reached += 1;
                } else {
                    // At the limit it falls short, towards the slip.
                    assert!(voltage_v.signum() * (flow_ml_s - delivered) >= -1e-9);
                }
            }
        }
        assert!(reached > 1000, "most of the range is reachable: {reached}");
    }

    #[test]
    fn it_is_odd_in_flow_and_pressure_difference() {
        let pump = Parameters::example().pump;
        for (flow, dp) in [(3.0, 1.0), (0.5, -2.0), (14.0, 3.0), (0.0, 1.0)] {
            assert_eq!(voltage_for_flow(&pump, flow, dp), -voltage_for_flow(&pump, -flow, -dp));
        }
    }

    #[test]
    fn unreachable_flows_end_at_the_limit() {
        let mut pump = Parameters::example().pump;
        assert_eq!(voltage_for_flow(&pump, 100.0, 0.0), pump.u_max);
        assert_eq!(voltage_for_flow(&pump, -100.0, 0.0), -pump.u_max);
        pump.f2 = -1.0; // no gain left at 1 bar
        assert_eq!(voltage_for_flow(&pump, 5.0, 1.0), pump.u_max);
        pump.f2 = 0.0;
        pump.f4 = 0.6; // delivers 0.6 ml/s at once
        assert_eq!(voltage_for_flow(&pump, 0.3, 0.0), 0.0);
    }

    #[test]
    fn a_flow_without_a_pump_is_no_command() {
        let now = Tick::at(0);
        let flow = step(Target::FlowMlS(3.0));
        assert!(PumpController::open_loop().control(now, &measured(2.0, 2.0), &flow).is_nan());
        let volts = step(Target::VoltageV(-7.5));
        assert_eq!(PumpController::open_loop().control(now, &Measurement::NONE, &volts), -7.5);
    }

    #[test]
    fn a_missing_pressure_is_bridged_but_never_invented() {
        let now = Tick::at(0);
        let flow = step(Target::FlowMlS(3.0));
        let mut controller = PumpController::with_pump(Parameters::example().pump);
        assert!(controller.control(now, &Measurement::NONE, &flow).is_nan(), "nothing was measured yet");
        let at_2_bar = controller.control(now, &measured(4.0, 2.0), &flow);
        assert_eq!(controller.control(now, &measured(4.0, f64::NAN), &flow), at_2_bar);
        assert_ne!(controller.control(now, &measured(3.0, 2.0), &flow), at_2_bar);
    }
}
