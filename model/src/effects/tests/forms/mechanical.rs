//! Forms of torques on the lever.

use super::*;

#[test]
fn a_contact_presses_as_a_linear_one_at_the_usual_depth_at_either_end() {
    let of = |n: f64, e: f64, c: f64| [10.0, 10.0, 30.0, n, e, c, 0.02];
    let at = |depth_rad: f64, n: f64, b: f64| {
        torque("end_stop", &[10.0, 10.0, 30.0, n, 0.0, 0.0, b], 30f64.to_radians() + depth_rad, 0.0)
    };
    for n in [0.8, 1.0, 1.5, 2.0, 4.0, 30.0] {
        for b in [0.003, 0.02, 0.5] {
            alike(at(0.05, n, b), -10.0 * 0.05);
            assert_eq!(at(-0.01, n, b), 0.0, "before it touches");
        }
        assert_eq!(torque("end_stop", &of(n, 0.0, 0.0), -0.6, 0.0), -torque("end_stop", &of(n, 0.0, 0.0), 0.6, 0.0));
    }
    // linear; a power far beyond b; exponential over b
    alike(at(0.1, 1.0, 0.003) / at(0.05, 1.0, 0.5), 2.0);
    for n in [0.8, 1.5, 3.0] {
        alike(at(800.0, n, 0.003) / at(400.0, n, 0.003), 2f64.powf(n));
    }
    let grows = at(0.11, 30.0, 0.05) / at(0.01, 30.0, 0.05);
    assert!((grows / (2.2f64.exp_m1() / 0.2f64.exp_m1()) - 1.0).abs() < 0.1, "{grows}");
    // the positive end 3 degrees later, the negative one 3 degrees sooner
    let sooner = |degrees: f64| torque("end_stop", &of(1.0, 3.0, 0.0), degrees.to_radians(), 0.0);
    assert_eq!(sooner(32.0), 0.0);
    alike(-sooner(36.0), sooner(-30.0));
    // pushed in it resists more than it gives back, and it never pulls
    let moving = |w: f64, side: f64| side * torque("end_stop", &of(1.0, 0.0, 0.5), 0.6 * side, w * side);
    for side in [1.0, -1.0] {
        alike(moving(1.0, side) / moving(0.0, side), 1.5);
        alike(moving(-1.0, side) / moving(0.0, side), 0.5);
        assert_eq!(moving(-3.0, side), 0.0);
    }
}

#[test]
fn a_friction_s_peak_falls_with_its_power_of_velocity() {
    // far above w_s the sign is all that the smoothing leaves
    let at = |w: f64, delta: f64, q: f64| torque("stribeck_friction", &[0.7, 0.5, 0.002, delta, q], 0.0, w);
    for delta in [0.5, 1.0, 2.0, 4.0] {
        alike(at(0.5, delta, 0.0), -0.7 * (-1f64).exp());
        alike(at(1.0, delta, 0.0), -0.7 * (-2f64.powf(delta)).exp());
        alike(at(1.0, delta, 1.0), -0.7 / (1.0 + 2f64.powf(delta)));
        alike(at(1.0, delta, 0.5), -0.7 / (1.0 + 0.5 * 2f64.powf(delta)).powi(2));
        assert_eq!(at(0.0, delta, 1.0), 0.0, "at rest it does nothing");
    }
}

#[test]
fn friction_by_pressure_grows_with_its_power_of_load_and_its_share_of_speed() {
    let at = |load_bar: f64, w: f64, m: f64, v: f64| {
        let mut port = MechanicalPort { load_bar, ..MechanicalPort::at(1.0, 0.0, w) };
        general("pressure_friction").act_value(&[0.2, 0.02, m, v], &[], &mut [], &mut Port::Mechanical(&mut port));
        port.torque_nm
    };
    for (m, v) in [(1.0, 0.0), (0.5, 1.0), (2.0, 0.4)] {
        alike(at(3.0, 1.0, m, v), -0.6);
        alike(at(6.0, 1.0, m, v) / at(3.0, 1.0, m, v), 2f64.powf(m));
        assert_eq!(at(3.0, 0.0, m, v), 0.0);
        assert_eq!(at(3.0, -0.7, m, v), -at(3.0, 0.7, m, v));
    }
    alike(at(3.0, 0.5, 1.0, 1.0), -0.3);
    alike(at(3.0, 0.5, 1.0, 0.0), -0.6);
}
