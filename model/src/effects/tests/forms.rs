//! General forms: the library's where they are neutral, and what each of their own parameters means.

use super::*;

mod hydraulic;
mod mechanical;
mod pump;

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
        let parameters = general.parameters;
        let placed = |v: &[f64]| v.len() == parameters.len() && parameters.iter().zip(v).all(within);
        assert!(refined.screened.iter().all(|v| placed(v) && v[same.len()..] != *refined.neutral), "{}", plain.id);
        for found in plain.starts {
            let all = refined.all_starts(found);
            assert_eq!(all.len(), refined.starts.len() + refined.away.len() + general.starts.len());
            let beside = refined.beside(found);
            assert_eq!(beside.len(), refined.starts.len());
            for (place, start) in beside.iter().zip(refined.starts) {
                let (same, own) = place.split_at(found.len());
                let off = |values: &[f64]| values.iter().zip(refined.neutral).map(|(v, n)| v - n).collect::<Vec<_>>();
                let near = off(own).iter().zip(off(start)).all(|(d, whole)| (d - 0.05 * whole).abs() < 1e-12);
                assert!(same == *found && near, "{}: {place:?}", plain.id);
            }
            for start in all.into_iter().chain(beside) {
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
