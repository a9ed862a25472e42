//! Each form is what its equation says: values at known points, limits, balance of oil, rest.

use super::*;
use model::effects;
use model::port::{ActuatorPort, HydraulicPort, LinePort, MechanicalPort, Ran, SensorPort};

#[test]
fn each_form_stands_for_an_effect_of_its_balance_and_is_another() {
    for (name, form) in FORMS {
        let effect = effects::find(name).expect("a name of the library");
        assert_eq!(effect.header().balance, form.header().balance, "{name}");
        assert_eq!(name_of(*form), *name);
        assert_eq!(name_of(effect), *name);
        assert!(effects::find(form.header().id).is_none());
        let sizes = form.header().parameters.len();
        assert!(form.header().starts.iter().all(|s| s.len() == sizes), "{name}");
    }
}

fn alike(a: f64, b: f64) {
    assert!((a - b).abs() <= 1e-6 * (1.0 + b.abs()), "{a} for {b}");
}

/// Torque on the lever, Nm, at 3 bar of load; `dx` gets the rates of the form's states `x`.
fn torque(form: &dyn Effect, k: &[f64], lever: (f64, f64), x: &[f64], dx: &mut [f64]) -> f64 {
    let mut m = MechanicalPort { load_bar: 3.0, ..MechanicalPort::at(1.0, lever.0, lever.1) };
    form.act_value(k, x, dx, &mut Port::Mechanical(&mut m));
    m.torque_nm
}

/// Chambers at these gauge pressures after the form has acted; `dx` gets the rates of its states `x`.
fn chambers(form: &dyn Effect, k: &[f64], gauge_bar: [f64; 2], x: &[f64], dx: &mut [f64]) -> HydraulicPort<f64> {
    let mut h = HydraulicPort::at(1.0, gauge_bar.map(|p| AMBIENT_BAR + p));
    form.act_value(k, x, dx, &mut Port::Hydraulic(&mut h));
    h
}

/// A free lever at rest in the middle between chambers at these pressures, bar absolute.
fn still(pressure_bar: [f64; 2]) -> Rest<'static, f64> {
    let (angle_rad, actuator_torque_nm, torque_nm, voltage_v) = (0.0, 0.0, 0.0, 0.0);
    Rest {
        arrival: Arrival::Free,
        ran: &[],
        angle_rad,
        pressure_bar,
        actuator_torque_nm,
        torque_nm,
        voltage_v,
        brake_open: true,
        bypass_open: false,
    }
}

#[test]
fn hysteresis_saturates_at_its_size_and_rests_where_the_way_there_left_it() {
    let (k, step) = ([0.4, 0.1], 1e-4);
    let (mut x, mut dx) = ([0.0; 4], [0.0; 4]);
    let way = [0.0f64, 1.2, 1.02, 1.15];
    for leg in way.windows(2) {
        let w = (leg[1] - leg[0]).signum();
        for _ in 0..((leg[1] - leg[0]).abs() / step).round() as usize {
            torque(&StickSlip, &k, (0.0, w), &x, &mut dx);
            x = [0, 1, 2, 3].map(|i| x[i] + step * dx[i]);
            assert!(x.iter().all(|z| z.abs() <= 1.0), "{x:?}");
        }
        if leg[1] == 1.2 {
            assert!(x.iter().all(|z| *z > 0.98), "after twice the longest way: {x:?}");
            let held = 0.2 * x[0] + 0.3 * x[1] + 0.3 * x[2] + 0.2 * x[3];
            alike(torque(&StickSlip, &k, (0.0, 0.0), &x, &mut dx), -k[0] * held);
            assert_eq!(dx, [0.0; 4], "nothing relaxes while the lever stands");
        }
    }
    let rest = Rest { arrival: Arrival::Led(&way), angle_rad: 1.15, ..still([2.0; 2]) };
    let mut led = [7.0; 4];
    StickSlip.rest(&k, &rest, &mut led);
    assert!(led.iter().zip(x).all(|(a, b)| (a - b).abs() < 0.02), "{led:?} for {x:?}");
}

#[test]
fn friction_opposes_the_motion_and_falls_as_its_equation_says() {
    let peak = |w: f64| torque(&StribeckLogistic, &[0.6, 0.3, 0.002], (0.0, w), &[], &mut []);
    // 2/(1 + exp(w/w_v)) of it is left
    for w in [0.3, 0.9] {
        alike(peak(w), -0.6 * 2.0 / (1.0 + (w / 0.3f64).exp()));
    }
    let pressed = |w: f64| torque(&PressureFrictionRational, &[0.2, 0.02], (0.0, w), &[], &mut []);
    alike(pressed(0.02), -0.2 * 3.0 * 0.5f64.sqrt());
    assert!((pressed(20.0) + 0.6).abs() < 1e-5);
    for friction in [&peak as &dyn Fn(f64) -> f64, &pressed] {
        assert_eq!(friction(0.0), 0.0);
        for w in [1e-3, 0.05, 0.4, 3.0] {
            assert!(friction(w) < 0.0, "{w}");
            assert_eq!(friction(-w), -friction(w));
        }
    }
}

#[test]
fn a_padded_stop_has_the_pad_s_stiffness_and_five_times_of_it_behind_the_pad_at_either_end() {
    let (k, contact) = ([8.0, 30.0], 30f64.to_radians());
    let at = |depth: f64| torque(&EndStopPadded, &k, (contact + depth, 0.0), &[], &mut []);
    let slope = |depth: f64| (at(depth + 1e-5) - at(depth - 1e-5)) / 2e-5;
    assert_eq!(at(-1e-6), 0.0);
    assert!((slope(0.04) + 8.0).abs() < 1e-6 && (slope(0.12) + 40.0).abs() < 1e-6);
    alike(at(PAD_RAD), -8.0 * PAD_RAD);
    assert_eq!(torque(&EndStopPadded, &k, (-0.6, 0.0), &[], &mut []), -at(0.6 - contact));
}

#[test]
fn a_displacement_grows_with_pressure_up_to_its_bound_in_one_chamber_as_it_falls_in_the_other() {
    let k = [0.4, 3.0];
    let of = |gauge: [f64; 2]| chambers(&DisplacementStraightens, &k, gauge, &[], &mut []).displacement_ml_rad;
    let [one, other] = of([3.0, 3.0]);
    alike(one, 0.4 * 3.0 / 2.0);
    assert_eq!(other, -one);
    assert!((of([1e-6, 0.0])[0] / 0.4e-6 - 1.0).abs() < 1e-5 && of([-0.5, 0.0]) == [0.0; 2]);
    assert!(of([1e6, 0.0])[0] < 0.4 * 3.0 && of([1e6, 0.0])[0] > 0.399 * 3.0);
}

#[test]
fn creep_s_branches_take_the_whole_capacity_and_rest_is_at_equilibrium() {
    alike(BRANCHES.iter().map(|(share, _)| share).sum(), 1.0);
    let (k, gauge, step) = ([0.3, 0.4], [2.0, 0.5], 1e-2);
    let rest = still(gauge.map(|g| AMBIENT_BAR + g));
    let (mut x, mut dx, mut taken) = ([0.0; 6], [0.0; 6], [0.0; 2]);
    for _ in 0..10_000 {
        let into = chambers(&WallCreepThreeTimes, &k, gauge, &x, &mut dx).flow_ml_s;
        x.iter_mut().zip(dx).for_each(|(x, rate)| *x += step * rate);
        taken.iter_mut().zip(into).for_each(|(taken, into)| *taken -= step * into);
    }
    let mut still = [7.0; 6];
    WallCreepThreeTimes.rest(&k, &rest, &mut still);
    for i in 0..2 {
        assert!((taken[i] - k[0] * gauge[i]).abs() < 1e-4, "{taken:?}");
    }
    assert!(x.iter().zip(still).all(|(x, still)| (x - still).abs() < 1e-4), "{x:?} {still:?}");
    let flow = chambers(&WallCreepThreeTimes, &k, gauge, &still, &mut dx).flow_ml_s;
    assert!(dx.iter().chain(&flow).all(|rate| rate.abs() < 1e-12), "{dx:?} {flow:?}");
}

#[test]
fn a_gap_and_an_orifice_in_series_share_the_pressure() {
    for even in [0.1, 0.5] {
        for dp in [1e-6f64, 0.01, 0.3, 2.0, 5.0] {
            let q = gap_and_orifice(dp, even);
            alike(q + q * q / even, dp);
            assert_eq!(gap_and_orifice(-dp, even), -q);
        }
        // the gap alone at little pressure, the orifice alone at much
        alike(gap_and_orifice(1e-9, even) * 1e9, 1.0);
        assert!((gap_and_orifice(1e6, even) / (1e6 * even).sqrt() - 1.0).abs() < 1e-3);
        alike(gap_and_orifice(2.0 * even, even), even);
    }
}

#[test]
fn leaks_lose_no_oil_between_chambers_and_none_at_ambient_pressure() {
    let [out, into] = chambers(&CrossLeakageGap, &[0.3], [2.0, 1.0], &[], &mut []).flow_ml_s;
    assert_eq!(out, -into);
    alike(out, -0.3 * gap_and_orifice(1.0, 0.1));
    let mut shut = HydraulicPort { shut_off: true, ..HydraulicPort::at(1.0, [3.0, 2.0]) };
    CrossLeakageGap.act(&[0.3], &[], &mut [], &mut Port::Hydraulic(&mut shut));
    assert_eq!(shut.flow_ml_s, [0.0; 2]);
    let outside = chambers(&ExternalLeakageGap, &[0.2, 0.1], [2.0, 0.0], &[], &mut []).flow_ml_s;
    alike(outside[0], -0.2 * gap_and_orifice(2.0, 0.5));
    assert_eq!(outside[1], 0.0);
}

#[test]
fn air_gives_way_by_what_its_polytrope_loses() {
    let (volume, steps) = (1.5, 10_000);
    let capacity =
        |gauge: f64| chambers(&TrappedAirPolytropic, &[volume, 0.0], [gauge; 2], &[], &mut []).capacity_ml_bar;
    let step = 4.0 / steps as f64;
    let lost: f64 = (0..steps).map(|n| step * capacity((n as f64 + 0.5) * step)[0]).sum();
    alike(lost, volume * (1.0 - (AMBIENT_BAR / (AMBIENT_BAR + 4.0)).powf(1.0 / 1.25)));
    assert_eq!(capacity(1.0)[1], 0.0);
}

#[test]
fn a_lag_of_second_order_starts_level_and_ends_at_the_voltage() {
    let (k, step) = ([0.02], 1e-4);
    let (mut x, mut dx) = ([0.0; 2], [0.0; 2]);
    let shown = |x: &[f64], dx: &mut [f64]| {
        let mut a = ActuatorPort { time_s: 0.0, voltage_v: 12.0, brake_opening: 1.0, bypass_opening: 0.0 };
        PumpLagSecondOrder.act_value(&k, x, dx, &mut Port::Actuator(&mut a));
        a.voltage_v
    };
    shown(&x, &mut dx);
    assert!(dx[0] > 0.0 && dx[1] == 0.0, "no jump, no slope: {dx:?}");
    for _ in 0..5_000 {
        shown(&x, &mut dx);
        x.iter_mut().zip(dx).for_each(|(x, rate)| *x += step * rate);
    }
    alike(shown(&x, &mut dx), 12.0);
}

#[test]
fn warming_begins_cold_and_ends_at_its_slip() {
    let slip = |time_s: f64, dp_bar: f64| {
        let mut line = LinePort::open(time_s, 12.0, dp_bar);
        PumpWarmingTwoMasses.act_value(&[0.4, 20.0], &[], &mut [], &mut Port::Line(&mut line));
        -line.flow_ml_s
    };
    assert_eq!(slip(0.0, 1.0), 0.0);
    assert_eq!(slip(60.0, 0.0), 0.0);
    alike(slip(20.0, 1.0), 0.4 * (1.0 - 0.6 * (-1f64).exp() - 0.4 * (-1f64 / 8.0).exp()));
    assert!((slip(4000.0, -2.0) + 0.8).abs() < 1e-6, "with the pressure's sign");
}

#[test]
fn losses_warm_either_way_and_what_was_done_before_the_rest_counts() {
    let k = [0.4, 20.0];
    let rates = |x: f64, voltage_v: f64| {
        let (mut line, mut dx) = (LinePort::open(3.0, voltage_v, 1.0), [0.0]);
        PumpWarmingByLosses.act_value(&k, &[x], &mut dx, &mut Port::Line(&mut line));
        (dx[0], -line.flow_ml_s)
    };
    assert_eq!(rates(0.0, 0.0), (0.0, 0.0));
    assert_eq!(rates(0.0, -15.0), rates(0.0, 15.0));
    alike(rates(0.0, 30.0).0, 4.0 / 20.0);
    alike(rates(1.0, 15.0).0, 0.0);
    alike(rates(1.0, 15.0).1, 0.4 * ((1.0f64 / 1.2).exp() - 1.0));
    // however warm it is, oil thins by no more than exp(5)
    assert!(rates(1e6, 15.0).1 < 0.4 * 5f64.exp() && rates(50.0, 15.0).1 > 0.4 * 4.5f64.exp());
    let history = [Ran { for_s: 20.0, voltage_v: 15.0 }, Ran { for_s: 40.0, voltage_v: 0.0 }];
    let mut x = [f64::NAN];
    PumpWarmingByLosses.rest(&k, &Rest { ran: &history, ..still([2.0; 2]) }, &mut x);
    alike(x[0], (1.0 - (-1f64).exp()) * (-2f64).exp());
}

#[test]
fn a_zero_drifts_half_soon_and_half_late() {
    let off = |time_s: f64| {
        let mut s = SensorPort { time_s, angle_deg: 5.0, pressure_bar: [2.0, 3.0] };
        let k = [0.05, 0.4, -0.02, -0.2, 10.0];
        PressureDriftTwoTimes.act_value(&k, &[], &mut [], &mut Port::Sensor(&mut s));
        assert_eq!(s.angle_deg, 5.0);
        [s.pressure_bar[0] - 2.0, s.pressure_bar[1] - 3.0]
    };
    for (o, d, sensor) in [(0.05, 0.4, 0), (-0.02, -0.2, 1)] {
        alike(off(0.0)[sensor], o);
        alike(off(10.0)[sensor], o + d * (1.0 - 0.5 * (-1f64).exp() - 0.5 * (-0.1f64).exp()));
        alike(off(2000.0)[sensor], o + d);
    }
}
