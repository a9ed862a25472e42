//! General forms: the library's where they are neutral, and what each of their own parameters means.

use super::*;

#[test]
fn a_refined_form_is_the_library_s_at_its_neutral_values() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut forms = 0;
    for effect in listed() {
        let Some(refined) = effect.refined() else { continue };
        let (plain, general) = (effect.header(), refined.effect.header());
        forms += 1;
        assert_eq!((general.id, general.balance), (plain.id, plain.balance));
        let (same, own) = general.parameters.split_at(plain.parameters.len());
        assert!(same.iter().zip(plain.parameters).all(|(a, b)| a.name == b.name), "{}", plain.id);
        assert!(own.iter().all(|p| !p.size), "{}: a form alone does nothing", plain.id);
        let within = |(p, v): (&Parameter, &f64)| (p.lower..=p.upper).contains(v);
        assert!(own.len() == refined.neutral.len() && own.iter().zip(refined.neutral).all(within), "{}", plain.id);
        assert!(refined.away.iter().all(|(factors, _)| factors.len() == same.len()), "{}", plain.id);
        for found in plain.starts {
            let all = refined.all_starts(found);
            assert_eq!(all.len(), refined.starts.len() + refined.away.len() + general.starts.len());
            for start in all {
                assert_eq!(start.len(), general.parameters.len(), "{}", plain.id);
                assert!(general.parameters.iter().zip(&start).all(within), "{}: {start:?}", plain.id);
            }
        }
        assert!(find_form(plain.id, |name| name == own[0].name).is_some_and(|e| std::ptr::eq(e.header(), general)));
        assert!(find_form(plain.id, |name| name == same[0].name).is_some_and(|e| std::ptr::eq(e.header(), plain)));
        let base = Parameters::example().to_vector();
        for start in plain.starts {
            let whole = [start, refined.neutral].concat();
            for input in inputs(&mut rng) {
                let plant = state(&mut rng);
                let moved = |effect: &'static dyn Effect, k: &[f64]| {
                    let set = set(effect, k);
                    // at other pressures than the effect's memory, which thus acts
                    let mut x = with_rest_states(&input, &base, &set, &plant);
                    x[crate::rec::state::PRESSURE1] += 0.4;
                    x[crate::rec::state::PRESSURE2] -= 0.3;
                    let all = everything(&input, &base, &set, 40.0, &x);
                    // states of its own apart
                    [&all[..STATES], &all[x.len()..]].concat()
                };
                for (a, b) in moved(*effect, start).iter().zip(moved(refined.effect, &whole)) {
                    assert!((a - b).abs() <= 1e-4 * (1.0 + a.abs()), "{}: {a} {b}", plain.id);
                }
            }
        }
    }
    assert!(forms > 0);
}

fn general(id: &str) -> &'static dyn Effect {
    find(id).and_then(|e| e.refined()).expect("it has a general form").effect
}

/// Torque on the lever, Nm.
fn torque(id: &str, k: &[f64], angle_rad: f64, velocity_rad_s: f64) -> f64 {
    let mut m = MechanicalPort::at(1.0, angle_rad, velocity_rad_s);
    general(id).act_value(k, &[], &mut [], &mut Port::Mechanical(&mut m));
    m.torque_nm
}

/// Flow into each chamber, ml/s, at these gauge pressures; `dx` gets the rates of the effect's states `x`.
fn flow(id: &str, k: &[f64], gauge_bar: [f64; 2], x: &[f64], dx: &mut [f64]) -> [f64; 2] {
    let mut h = HydraulicPort::at(1.0, gauge_bar.map(|p| AMBIENT_BAR + p));
    general(id).act_value(k, x, dx, &mut Port::Hydraulic(&mut h));
    h.flow_ml_s
}

fn alike(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-3 * b.abs(), "{a} for {b}");
}

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
fn a_leak_goes_with_its_power_of_pressure_and_what_leaves_one_chamber_enters_the_other() {
    for m in [0.5, 0.7, 1.0] {
        let cross = |dp: f64| flow("cross_leakage", &[0.3, 1e-3, m, 2.0], [2.0 + dp, 2.0], &[], &mut []);
        let [out, into] = cross(1.0);
        assert_eq!(out, -into);
        alike(out, -0.3);
        alike(cross(2.0)[0] / out, 2f64.powf(m));
        alike(cross(-1.0)[0], -out);
        let outside = |p: f64| flow("external_leakage", &[0.2, 0.05, m, 1e-3, 2.0], [p, 1.0], &[], &mut []);
        alike(outside(1.0)[0], -0.2);
        alike(outside(1.0)[1], -0.05);
        alike(outside(4.0)[0] / outside(1.0)[0], 4f64.powf(m));
        assert_eq!(outside(0.0)[0], 0.0, "nothing leaves at ambient pressure");
    }
}

#[test]
fn a_leak_is_laminar_far_below_its_transition_and_the_more_gradual_the_smaller_s_is() {
    let cross = |dp: f64, s: f64| -flow("cross_leakage", &[0.3, 0.1, 0.5, s], [2.0 + dp, 2.0], &[], &mut [])[0];
    let outside = |g: f64, s: f64| -flow("external_leakage", &[0.3, 0.0, 0.5, 0.1, s], [g, 0.0], &[], &mut [])[0];
    for through in [&cross as &dyn Fn(f64, f64) -> f64, &outside] {
        for s in [0.7, 1.0, 2.0] {
            alike(through(1e-6, s) / through(5e-7, s), 2.0);
            assert!((through(4e4, s) / through(1e4, s) - 2.0).abs() < 1e-3);
        }
        assert!(through(0.1, 0.7) < through(0.1, 1.0) && through(0.1, 1.0) < through(0.1, 2.0));
    }
}

#[test]
fn warming_is_half_done_after_its_time_constant_where_it_is_a_hyperbola_and_may_be_steady() {
    let slip = |time_s: f64, s: f64| {
        let mut line = line(time_s, 1.0);
        general("pump_warming").act_value(&[0.4, 60.0, s], &[], &mut [], &mut Port::Line(&mut line));
        -line.flow_ml_s
    };
    alike(slip(60.0, 1.0), 0.2);
    alike(slip(180.0, 1.0), 0.3);
    alike(slip(60.0, 0.0), 0.4 * (1.0 - (-1f64).exp()));
    alike(slip(30.0, -1.0), 0.2);
    alike(slip(600.0, -1.0), 0.4);
    // the series meets the quotient
    let near = |s: f64| slip(60.0, s);
    assert!((near(1.001e-3) - near(0.999e-3)).abs() < 1e-6 && near(0.999e-3) != near(0.0));
    for s in [-0.05, 0.0, 0.5, 1.0, 4.0] {
        assert_eq!(slip(0.0, s), 0.0, "cold");
        // all warm alike at first: k/tau
        alike(slip(0.01, s), 0.4 / 60.0 * 0.01);
        assert!(slip(600.0, s) < 0.4 && slip(600.0, s) > slip(300.0, s));
    }
}

#[test]
fn a_zero_that_drifts_steadily_goes_as_far_in_every_minute_and_begins_as_one_that_settles() {
    let off = |time_s: f64, s: f64| {
        let mut shown = SensorPort { time_s, angle_deg: 0.0, pressure_bar: [2.0, 3.0] };
        general("pressure_drift").act_value(
            &[0.1, 0.3, 0.0, -0.2, 40.0, s],
            &[],
            &mut [],
            &mut Port::Sensor(&mut shown),
        );
        [shown.pressure_bar[0] - 2.0, shown.pressure_bar[1] - 3.0]
    };
    for s in [0.0, 0.4, 1.0] {
        assert_eq!(off(0.0, s), [0.1, 0.0].map(|o| 2.0 + o - 2.0), "at switch-on the constant part alone");
        alike(off(0.04, s)[1], -0.2 * 1e-3);
    }
    alike(off(80.0, 1.0)[1] / off(40.0, 1.0)[1], 2.0);
    alike(off(400.0, 0.0)[1], -0.2);
    let halves = off(100.0, 0.0)[1] + off(100.0, 1.0)[1];
    alike(off(100.0, 0.5)[1], 0.5 * halves);
}

#[test]
fn a_wall_of_two_branches_takes_what_both_capacities_hold_each_in_its_time() {
    let (capacity, tau, share, ratio) = (0.4, 0.5, 0.3, 6.0);
    let k = [capacity, tau, share, ratio];
    let pressed = [2.0, 1.0];
    let (mut x, mut dx) = ([0.0; 4], [0.0; 4]);
    let first = flow("wall_creep", &k, pressed, &x, &mut dx);
    alike(first[0], -pressed[0] * (capacity / tau + share * capacity / (ratio * tau)));
    let (step, mut taken) = (1e-3, [0.0; 2]);
    for n in 0..60_000 {
        if n == 3_000 {
            // the slow branch after its time constant
            alike(x[2], pressed[0] * share * capacity * (1.0 - (-1f64).exp()));
        }
        let into = flow("wall_creep", &k, pressed, &x, &mut dx);
        for i in 0..2 {
            taken[i] -= step * into[i];
        }
        x.iter_mut().zip(dx).for_each(|(x, rate)| *x += step * rate);
    }
    for (taken, pressed) in taken.into_iter().zip(pressed) {
        alike(taken, pressed * capacity * (1.0 + share));
    }
}

#[test]
fn air_goes_into_solution_by_a_share_per_bar_of_pressure_and_comes_back() {
    let k = [0.8, 0.3, 0.2, 5.0];
    let gauge_bar = [2.0, 0.0];
    let (mut x, mut dx) = ([0.0; 2], [0.0; 2]);
    let flowing = flow("trapped_air", &k, gauge_bar, &x, &mut dx);
    alike(dx[0], 0.8 * 0.2 * 2.0 / 5.0);
    // what dissolves leaves room for oil, as much as the free air took
    alike(flowing[0], -dx[0] * AMBIENT_BAR / (AMBIENT_BAR + 2.0));
    assert_eq!((dx[1], flowing[1]), (0.0, 0.0), "at ambient pressure nothing dissolves");
    for _ in 0..60_000 {
        flow("trapped_air", &k, gauge_bar, &x, &mut dx);
        x.iter_mut().zip(&dx).for_each(|(x, d)| *x += 1e-3 * d);
    }
    alike(x[0], 0.8 * 0.2 * 2.0);
    let capacity = |x: &[f64]| {
        let mut h = HydraulicPort::at(1.0, gauge_bar.map(|p| AMBIENT_BAR + p));
        let before = h.capacity_ml_bar;
        general("trapped_air").act_value(&k, x, &mut [0.0; 2], &mut Port::Hydraulic(&mut h));
        [h.capacity_ml_bar[0] - before[0], h.capacity_ml_bar[1] - before[1]]
    };
    alike(capacity(&x)[0] / capacity(&[0.0; 2])[0], 1.0 - 0.2 * 2.0);
    assert_eq!(capacity(&[0.9, 0.0])[0], 0.0, "no less than no air is free");
    // back at ambient pressure it comes out again, and drives oil out
    assert!(flow("trapped_air", &k, [0.0; 2], &x, &mut dx)[0] > 0.0 && dx[0] < 0.0);
}

/// Steps the pump's voltage from 0 to `volts`: the voltage that the pump sees after each 0.1 ms.
fn stepped(k: &[f64], volts: f64) -> Vec<f64> {
    let (mut x, mut dx) = ([0.0; 3], [0.0; 3]);
    let step = |_| {
        let mut a = ActuatorPort { time_s: 1.0, voltage_v: volts, brake_opening: 1.0, bypass_opening: 0.0 };
        general("pump_lag").act_value(k, &x, &mut dx, &mut Port::Actuator(&mut a));
        x.iter_mut().zip(&dx).for_each(|(x, d)| *x += 1e-4 * d);
        a.voltage_v
    };
    (0..5_000).map(step).collect()
}

#[test]
fn a_pump_is_late_by_lag_or_dead_time_and_no_faster_than_its_ramp() {
    // the area between command and answer is the mean delay
    let delay = |k: &[f64]| stepped(k, 2.0).iter().map(|u| (1.0 - u / 2.0) * 1e-4).sum::<f64>();
    for (tau, dead) in [(0.01, 0.6), (0.02, 0.0), (0.01, 1.0), (0.0025, 0.2)] {
        let mean = delay(&[tau, dead, 0.0]);
        assert!((mean - tau).abs() < 1.1e-4, "{mean} for {tau}");
    }
    // a dead time is one: next to nothing before it, nearly all after it
    let dead = stepped(&[0.05, 1.0, 0.0], 1.0);
    assert!(dead[..150].iter().all(|u| u.abs() < 0.25) && (dead[800] - 1.0).abs() < 0.1, "{} {}", dead[150], dead[800]);
    // on a ramp of 500 V/s twice the step takes twice the time
    let ramped = |volts: f64| {
        let seen = stepped(&[1e-3, 0.0, 2.0], volts);
        let steepest = seen.windows(2).map(|w| (w[1] - w[0]) / 1e-4).fold(0.0, f64::max);
        (steepest, seen.iter().position(|u| *u > 0.5 * volts).expect("it gets there"))
    };
    let ((small, soon), (large, late)) = (ramped(5.0), ramped(10.0));
    assert!(small < 500.0 && large < 500.0 && large > 400.0, "{small} {large} V/s");
    assert!((late as f64 / soon as f64 - 2.0).abs() < 0.2, "{soon} {late}");
}

#[test]
fn a_valve_whose_armature_travels_first_opens_late_and_then_soon() {
    // openings of the brake after each 0.1 ms from the command to open, and then to close
    let switched = |k: &[f64], from: f64| {
        let [mut brake, mut bypass] = [([from], [0.0]); 2];
        let step = |_| {
            let to = 1.0 - from;
            let mut a = ActuatorPort { time_s: 1.0, voltage_v: 0.0, brake_opening: to, bypass_opening: to };
            for (id, (x, dx)) in [("brake_valve_lag", &mut brake), ("bypass_valve_lag", &mut bypass)] {
                general(id).act_value(k, x, dx, &mut Port::Actuator(&mut a));
                x[0] += 1e-4 * dx[0];
            }
            assert_eq!(a.brake_opening, a.bypass_opening, "the valves are alike");
            a.brake_opening
        };
        (0..4_000).map(step).collect::<Vec<f64>>()
    };
    let when = |seen: &[f64], beyond: f64| seen.iter().position(|y| *y > beyond).map(|n| n as f64 * 1e-4);
    let (open_s, close_s) = (0.04, 0.02);
    for s in [0.0, 0.2, 0.45] {
        let opening = switched(&[open_s, close_s, s, 0.0], 0.0);
        let closing: Vec<f64> = switched(&[open_s, close_s, s, 0.0], 1.0).iter().map(|y| 1.0 - y).collect();
        for (seen, tau) in [(&opening, open_s), (&closing, close_s)] {
            assert!(seen.iter().all(|y| (0.0..=1.0).contains(y)));
            let half = when(seen, 0.5).expect("it opens half");
            assert!((half - tau * 2f64.ln()).abs() < 3e-4, "{half}");
            let begins = when(seen, 0.0).expect("it begins");
            assert!((begins - tau * (1.0 / (1.0 - s)).ln()).abs() < 3e-4, "{begins}");
            let whole = when(seen, 0.999);
            assert!(s == 0.0 || whole.is_some_and(|t| (t - tau * (1.0 / s).ln()).abs() < 1e-3), "{whole:?}");
        }
    }
    // one that goes most of its way at one speed is as late in the mean, and opens evenly
    for even in [0.0, 0.4, 0.8] {
        let opening = switched(&[open_s, close_s, 0.0, even], 0.0);
        let mean_s = opening.iter().map(|y| (1.0 - y) * 1e-4).sum::<f64>();
        assert!((mean_s - open_s).abs() < 2e-4, "{mean_s}");
        let fifth = |n: usize| when(&opening, 0.2 * n as f64).expect("it gets there");
        let bend = (fifth(3) - fifth(2)) / (fifth(2) - fifth(1));
        assert!(if even == 0.8 { (bend - 1.0).abs() < 0.01 } else { bend > 1.1 }, "{even}: {bend}");
    }
}

/// A line at rest at the chambers' end, over half a second: its flow at each 0.02 ms.
fn line_flow(k: &[f64], slip: f64, delivered: f64) -> Vec<f64> {
    let (mut x, mut dx) = ([0.0; 2], [0.0; 2]);
    let step = |_| {
        let mut l = LinePort { flow_ml_s: delivered, slip_ml_s_bar: slip, ..LinePort::open(1.0, 12.0, 0.0) };
        general("line_inertance").act_value(k, &x, &mut dx, &mut Port::Line(&mut l));
        // symplectic: neither feeds the swing nor damps it
        x[1] += 2e-5 * dx[1];
        let mut l = LinePort { flow_ml_s: delivered, slip_ml_s_bar: slip, ..LinePort::open(1.0, 12.0, 0.0) };
        general("line_inertance").act_value(k, &x, &mut dx, &mut Port::Line(&mut l));
        x[0] += 2e-5 * dx[0];
        l.flow_ml_s
    };
    (0..25_000).map(step).collect()
}

#[test]
fn a_line_with_oil_to_compress_swings_and_one_without_follows_as_a_lag() {
    let (i, c, slip): (f64, f64, f64) = (0.02, 0.03, 0.05);
    let swing = line_flow(&[i, c, 0.0], slip, 4.0);
    // damping of the node by the pump's slip: 2 D w0 = slip/C
    let (w0, damping) = ((1.0 / (i * c)).sqrt(), 0.5 * slip / c);
    let period = std::f64::consts::TAU / (w0 * w0 - damping * damping).sqrt();
    let peak = swing.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).expect("not empty");
    assert!((peak.0 as f64 * 2e-5 / (0.5 * period) - 1.0).abs() < 0.01, "{} s", peak.0 as f64 * 2e-5);
    alike(peak.1 / 4.0 - 1.0, (-damping * 0.5 * period).exp());
    // a light line, whose own lag is far below a millisecond, swings with its oil all the same: 25.2 Hz
    let light = line_flow(&[2e-3, 0.02, 0.0], 0.142, 4.0);
    let rises: Vec<usize> = (1..light.len()).filter(|n| light[n - 1] < 4.0 && light[*n] >= 4.0).collect();
    let hertz = (rises.len() - 1) as f64 / ((rises[rises.len() - 1] - rises[0]) as f64 * 2e-5);
    let (w0, damping) = ((1.0f64 / (2e-3 * 0.02)).sqrt(), 0.5 * 0.142 / 0.02);
    assert!((hertz * std::f64::consts::TAU / (w0 * w0 - damping * damping).sqrt() - 1.0).abs() < 0.01, "{hertz} Hz");
    let lag = line_flow(&[0.4, 0.0, 0.0], 0.25, 4.0);
    assert!((lag[5_000] - 4.0 * (1.0 - (-1f64).exp())).abs() < 0.06, "{}", lag[5_000]);
    assert!(lag.windows(2).all(|w| w[1] >= w[0]) && (lag[24_999] - 4.0).abs() < 0.04);
}

#[test]
fn a_bypass_at_the_chambers_equalises_at_once_and_one_at_the_pump_through_the_line() {
    let flow = |k: &[f64], opening: f64| {
        let mut l = LinePort {
            flow_ml_s: -80.0,
            bypass_ml_s_bar: 40.0,
            slip_ml_s_bar: 0.2,
            opening,
            ..LinePort::open(1.0, 0.0, 2.0)
        };
        general("line_inertance").act_value(k, &[0.0; 2], &mut [0.0; 2], &mut Port::Line(&mut l));
        l.flow_ml_s
    };
    for opening in [0.0, 1.0] {
        assert_eq!(flow(&[0.4, 0.01, 0.0], opening), -80.0);
        assert_eq!(flow(&[0.4, 0.01, 1.0], opening), 0.0, "the oil in the line stands still at first");
        alike(flow(&[0.4, 0.01, 0.25], opening), -60.0);
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

#[test]
fn a_sensor_of_second_order_is_late_by_its_time_swings_where_its_mass_is_large_and_may_have_two_lags_side_by_side() {
    // pressures after a step of 1 bar at each 0.05 ms
    let stepped = |tau: f64, z: f64, c: f64| {
        let (mut x, mut dx) = ([2.0, 3.0, 0.0, 0.0], [0.0; 4]);
        let step = |_| {
            let mut s = SensorPort { time_s: 1.0, angle_deg: 0.0, pressure_bar: [3.0, 3.0] };
            general("pressure_lag").act_value(&[tau, 0.0, z, c], &x, &mut dx, &mut Port::Sensor(&mut s));
            x.iter_mut().zip(&dx).for_each(|(x, d)| *x += 5e-5 * d);
            assert_eq!(s.pressure_bar[1], 3.0, "the other sensor is fast");
            s.pressure_bar[0] - 2.0
        };
        (0..20_000).map(step).collect::<Vec<f64>>()
    };
    for z in [0.0, 0.25, 0.5, 1.0] {
        let shown = stepped(0.03, z, 0.0);
        let late_s = shown.iter().map(|y| (1.0 - y) * 5e-5).sum::<f64>();
        assert!((late_s - 0.03).abs() < 2e-4, "{late_s}");
        // overshoot of a second order system of damping D = 1/(2*sqrt(z))
        let overshoot = shown.iter().fold(0.0, |most: f64, y| most.max(y - 1.0));
        let d = 0.5 / z.sqrt();
        let expected = if d < 1.0 { (-std::f64::consts::PI * d / (1.0 - d * d).sqrt()).exp() } else { 0.0 };
        assert!((overshoot - expected).abs() < 0.01, "{overshoot} for {expected}");
    }
    // 0.7 of it by a lag of 10 ms, the rest by one of 80 ms
    let (b, fast_s, slow_s) = (0.7, 0.01, 0.08);
    let tau: f64 = fast_s + slow_s;
    let shown = stepped(tau, fast_s * slow_s / (tau * tau), (b * slow_s + (1.0 - b) * fast_s) / tau);
    for (n, y) in shown.iter().enumerate() {
        let t = n as f64 * 5e-5;
        let expected = 1.0 - b * (-t / fast_s).exp() - (1.0 - b) * (-t / slow_s).exp();
        assert!((y - expected).abs() < 0.01, "at {t} s: {y} for {expected}");
    }
}
