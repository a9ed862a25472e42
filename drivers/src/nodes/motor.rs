//! What the amplifier measures of its motor: an emulation by a gear pump and a brushed motor of the size that the plant asks for.
//!
//! | quantity | by |
//! |---|---|
//! | speed | flow / displacement |
//! | current | torque / torque constant, with torque = displacement / 2 pi * pressure difference + friction against the motion |
//! | duty | voltage / supply |
//! | supply | the setting `full_scale_v` |

use crate::amplifier::Telemetry;
use crate::emulated::Pump;
use std::f64::consts::TAU;

/// Displacement of the pump, ml a revolution.
const DISPLACEMENT_ML: f64 = 0.5;
/// Torque constant of the motor, Nm/A: 24 V at 3000 revolutions a minute.
const TORQUE_NM_A: f64 = 0.076;
/// Friction of motor and pump, Nm.
const FRICTION_NM: f64 = 0.02;
const TEMPERATURE_C: f32 = 32.0;

/// Telemetry of a motor that drives this pump out of this supply (V, > 0).
pub fn telemetry(pump: &Pump, supply_v: f64) -> Telemetry {
    let Pump { voltage_v, difference_bar, flow_ml_s } = *pump;
    let speed_rpm = 60.0 * flow_ml_s / DISPLACEMENT_ML;
    // 1 bar = 1e5 N/m^2, 1 ml = 1e-6 m^3.
    let load_nm = DISPLACEMENT_ML * 1e-6 / TAU * difference_bar * 1e5;
    let friction_nm = if voltage_v == 0.0 { 0.0 } else { FRICTION_NM.copysign(voltage_v) };
    let current_a = if voltage_v == 0.0 { 0.0 } else { (load_nm + friction_nm) / TORQUE_NM_A };
    Telemetry {
        supply_v: supply_v as f32,
        motor_current_a: current_a as f32,
        speed_rpm: speed_rpm as f32,
        duty: (voltage_v / supply_v) as f32,
        temperature_c: TEMPERATURE_C,
        fault: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pump_against_pressure_takes_more_current_and_turns_with_its_flow() {
        let light = telemetry(&Pump { voltage_v: 12.0, difference_bar: 0.0, flow_ml_s: 5.0 }, 24.0);
        let heavy = telemetry(&Pump { voltage_v: 12.0, difference_bar: 2.0, flow_ml_s: 5.0 }, 24.0);
        assert!(heavy.motor_current_a > light.motor_current_a && light.motor_current_a > 0.0);
        assert_eq!((light.duty, light.speed_rpm, light.supply_v), (0.5, 600.0, 24.0));
        let back = telemetry(&Pump { voltage_v: -12.0, difference_bar: -2.0, flow_ml_s: -5.0 }, 24.0);
        assert_eq!((back.motor_current_a, back.speed_rpm), (-heavy.motor_current_a, -heavy.speed_rpm));
        let rest = telemetry(&Pump { voltage_v: 0.0, difference_bar: 2.0, flow_ml_s: 0.0 }, 24.0);
        assert_eq!((rest.motor_current_a, rest.duty), (0.0, 0.0));
    }
}
