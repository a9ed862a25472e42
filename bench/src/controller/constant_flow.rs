//! Constant flow: eq. (10) solved for the voltage.

use model::parameters::Pump;

/// The voltage (V, within +-u_max) at which the pump delivers `flow_ml_s` (ml/s, from chamber 2 to chamber 1) against
/// `dp_bar` = p1 - p2 (bar): eq. (10) solved for u. Where no voltage within the range reaches the flow, the end of the range
/// that comes closest; 0 where the slip alone is the flow.
///
/// NaN in, NaN out.
pub fn voltage_for_flow(pump: &Pump, flow_ml_s: f64, dp_bar: f64) -> f64 {
    voltage_with_rest(pump, flow_ml_s, dp_bar, 0.0)
}

/// [`voltage_for_flow`], but 0 V where the gears would have to deliver less than `rest_ml_s` beside the slip.
pub(super) fn voltage_with_rest(pump: &Pump, flow_ml_s: f64, dp_bar: f64, rest_ml_s: f64) -> f64 {
    // What the gears have to deliver beside the slip: sgn(u) (f1 |u| + f4 + f2 u dp).
    let driven_ml_s = flow_ml_s - pump.f3 * dp_bar;
    if driven_ml_s.is_nan() {
        return driven_ml_s;
    }
    if driven_ml_s == 0.0 || driven_ml_s.abs() < rest_ml_s {
        return 0.0;
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
    use proptest::prelude::*;

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

    proptest! {
        #[test]
        fn it_is_odd_in_flow_and_pressure_difference(flow in -20.0..20.0_f64, dp in -6.0..6.0_f64) {
            let pump = Parameters::example().pump;
            prop_assert_eq!(voltage_for_flow(&pump, flow, dp), -voltage_for_flow(&pump, -flow, -dp));
        }

        #[test]
        fn more_flow_never_needs_less_voltage(flow in -20.0..20.0_f64, more in 0.0..5.0_f64, dp in -6.0..6.0_f64, rest in 0.0..1.0_f64) {
            let pump = Parameters::example().pump;
            let volts = |flow| voltage_with_rest(&pump, flow, dp, rest);
            prop_assert!(volts(flow) <= volts(flow + more));
        }

        #[test]
        fn resting_costs_no_more_flow_than_was_granted(flow in -12.0..12.0_f64, dp in -2.0..2.0_f64, rest in 0.0..1.0_f64) {
            let parameters = Parameters::example();
            let voltage_v = voltage_with_rest(&parameters.pump, flow, dp, rest);
            prop_assume!(voltage_v.abs() < parameters.pump.u_max);
            let (delivered, _) = pump_flow(&parameters.to_vector(), voltage_v, dp);
            prop_assert!((delivered - flow).abs() <= rest + 1e-9, "{flow} ml/s, got {delivered}");
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
}
