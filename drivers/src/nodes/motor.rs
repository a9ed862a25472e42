//! What the amplifier measures of its motor: an emulation by a gear pump and a brushed motor of the size that the plant asks for, in balance at
//! every instant.
//!
//! | quantity | by |
//! |---|---|
//! | load torque | displacement / 2 pi * pressure difference |
//! | current | (load torque + friction against the motion) / torque constant; at a standstill voltage / resistance |
//! | speed | (voltage - resistance * current) / torque constant |
//! | duty | voltage / supply |
//!
//! So what the supply gives (duty * supply * current) is what heats the winding plus what goes to the shaft, and that is what moves the oil
//! plus what the friction takes. A load that drives the motor feeds the supply.
//!
//! Not modelled: the supply does not sag; inertia and inductance (a few ms) are none; the temperature of the output stage does not change. Flow
//! is the plant's, by its own equation: what the speed is ahead of it leaks back through the gears. With the brake valve closed the pump is
//! taken to press against the same difference as with an open one.

use crate::amplifier::Telemetry;
use crate::emulated::Pump;
use std::f64::consts::TAU;

/// Displacement of the pump, ml a revolution.
const DISPLACEMENT_ML: f64 = 0.5;
/// Torque constant of the motor, Nm/A, and its speed constant, Vs/rad. With 24 V the pump moves 16 ml/s: what the plant's pump delivers at most,
/// and a seventh for leakage.
const TORQUE_NM_A: f64 = 0.115;
/// Resistance of the winding, ohm.
const RESISTANCE_OHM: f64 = 3.0;
/// Friction of motor and pump, Nm.
const FRICTION_NM: f64 = 0.02;
/// The output stage, always.
const TEMPERATURE_C: f32 = 32.0;
/// rad/s to 1/min.
const RPM: f64 = 60.0 / TAU;

/// Telemetry of a motor that drives this pump out of this supply (V, > 0).
pub fn telemetry(pump: &Pump, supply_v: f64) -> Telemetry {
    let Motion { current_a, speed_rad_s } = motion(pump);
    Telemetry {
        supply_v: supply_v as f32,
        motor_current_a: current_a as f32,
        speed_rpm: (RPM * speed_rad_s) as f32,
        duty: (pump.voltage_v / supply_v) as f32,
        temperature_c: TEMPERATURE_C,
        fault: None,
    }
}

/// The motor as it runs.
struct Motion {
    current_a: f64,
    speed_rad_s: f64,
}

fn motion(pump: &Pump) -> Motion {
    let voltage_v = pump.voltage_v;
    let load_nm = load_nm(pump);
    let standing_a = voltage_v / RESISTANCE_OHM;
    let surplus_nm = TORQUE_NM_A * standing_a - load_nm;
    if surplus_nm.abs() <= FRICTION_NM {
        return Motion { current_a: standing_a, speed_rad_s: 0.0 };
    }
    // It turns the way in which it would begin to.
    let current_a = (load_nm + FRICTION_NM.copysign(surplus_nm)) / TORQUE_NM_A;
    Motion { current_a, speed_rad_s: (voltage_v - RESISTANCE_OHM * current_a) / TORQUE_NM_A }
}

fn load_nm(pump: &Pump) -> f64 {
    // 1 bar = 1e5 N/m^2, 1 ml = 1e-6 m^3.
    DISPLACEMENT_ML * 1e-6 / TAU * pump.difference_bar * 1e5
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Parameters;

    const SUPPLY_V: f64 = 24.0;

    /// The pump of these parameters over all that it may be asked.
    fn pumps(parameters: &Parameters) -> impl Iterator<Item = Pump> {
        let k = parameters.to_vector();
        (-48..=48).flat_map(move |half_v| {
            (-24..=24).map(move |quarter_bar| {
                let (voltage_v, difference_bar) = (0.5 * f64::from(half_v), 0.25 * f64::from(quarter_bar));
                let flow_ml_s = model::rec::pump_flow(&k, voltage_v, difference_bar).0;
                Pump { voltage_v, difference_bar, flow_ml_s }
            })
        })
    }

    #[test]
    fn the_supply_gives_what_winding_oil_and_friction_take() {
        for pump in pumps(&Parameters::example()) {
            let told = telemetry(&pump, SUPPLY_V);
            let (current_a, speed_rad_s) = (f64::from(told.motor_current_a), f64::from(told.speed_rpm) / RPM);
            let supply_w = f64::from(told.duty) * f64::from(told.supply_v) * current_a;
            let copper_w = RESISTANCE_OHM * current_a * current_a;
            let shaft_w = TORQUE_NM_A * current_a * speed_rad_s;
            // 0.1: bar ml/s to W.
            let geometric_ml_s = DISPLACEMENT_ML * speed_rad_s / TAU;
            let oil_w = 0.1 * geometric_ml_s * pump.difference_bar;
            let friction_w = FRICTION_NM * speed_rad_s.abs();
            let near = |a: f64, b: f64| (a - b).abs() < 1e-4 * (1.0 + a.abs());
            assert!(near(supply_w, copper_w + shaft_w), "{pump:?}: {supply_w} W, {copper_w} + {shaft_w} W");
            assert!(near(shaft_w, oil_w + friction_w), "{pump:?}: {shaft_w} W, {oil_w} + {friction_w} W");
            assert!(current_a.abs() < 9.0 && told.duty.abs() <= 1.0 && told.speed_rpm.abs() < 2500.0, "{told:?}");
        }
    }

    #[test]
    fn the_pump_turns_with_its_voltage_and_never_delivers_more_than_it_displaces_without_help() {
        let example = Parameters::example();
        for spread in [0.9, 1.0, 1.1] {
            let mut parameters = example;
            parameters.pump.f1 *= spread;
            for pump in pumps(&parameters).filter(|pump| pump.voltage_v.abs() >= 2.0) {
                let told = telemetry(&pump, SUPPLY_V);
                let displaced_ml_s = DISPLACEMENT_ML * f64::from(told.speed_rpm) / 60.0;
                let forth = pump.voltage_v.signum();
                assert!(displaced_ml_s * forth >= 0.0, "{pump:?}: {told:?}");
                if pump.difference_bar * forth >= 0.0 {
                    assert!(
                        displaced_ml_s * forth >= pump.flow_ml_s * forth,
                        "{pump:?}: displaces {displaced_ml_s} ml/s"
                    );
                }
                if pump.difference_bar == 0.0 {
                    let efficiency = pump.flow_ml_s / displaced_ml_s;
                    assert!((0.4..=1.0).contains(&efficiency), "{pump:?}: {efficiency}");
                }
            }
        }
    }

    #[test]
    fn a_pump_against_pressure_takes_more_current_and_one_at_rest_none() {
        let light = telemetry(&Pump { voltage_v: 12.0, difference_bar: 0.0, flow_ml_s: 6.7 }, SUPPLY_V);
        let heavy = telemetry(&Pump { voltage_v: 12.0, difference_bar: 2.0, flow_ml_s: 6.3 }, SUPPLY_V);
        assert!(heavy.motor_current_a > light.motor_current_a && light.motor_current_a > 0.0);
        assert!(heavy.speed_rpm < light.speed_rpm);
        assert_eq!((light.duty, light.supply_v), (0.5, 24.0));
        let back = telemetry(&Pump { voltage_v: -12.0, difference_bar: -2.0, flow_ml_s: -6.3 }, SUPPLY_V);
        assert_eq!((back.motor_current_a, back.speed_rpm), (-heavy.motor_current_a, -heavy.speed_rpm));
        let rest = telemetry(&Pump { voltage_v: 0.0, difference_bar: 2.0, flow_ml_s: 0.0 }, SUPPLY_V);
        assert_eq!((rest.motor_current_a, rest.speed_rpm, rest.duty), (0.0, 0.0, 0.0), "friction holds it");
    }
}
