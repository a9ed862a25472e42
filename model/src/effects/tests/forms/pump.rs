//! Forms of the pump, its valves and its line.

use super::*;

#[test]
fn warming_is_half_done_after_its_time_constant_where_it_is_a_hyperbola_and_may_be_steady() {
    let slip = |time_s: f64, s: f64| {
        let mut line = line(time_s, 1.0);
        general("pump_warming").act_value(&[0.4, 60.0, s, 0.0, 0.0], &[0.7], &mut [0.0], &mut Port::Line(&mut line));
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
fn warming_by_what_the_pump_does_goes_with_the_square_of_its_voltage_and_remembers_what_it_did() {
    let k = [0.4, 60.0, 0.0, 1.0, 0.0];
    let form = general("pump_warming");
    // state and slip at 1 bar after each of these in turn, in steps of 5 ms from cold
    let run = |ran: &[Ran]| {
        let (mut x, mut slip) = ([0.0], 0.0);
        for ran in ran {
            for _ in 0..(ran.for_s / 5e-3).round() as usize {
                let mut dx = [0.0];
                let mut l = LinePort::open(7.0, ran.voltage_v, 1.0);
                form.act_value(&k, &x, &mut dx, &mut Port::Line(&mut l));
                (x[0], slip) = (x[0] + 5e-3 * dx[0], -l.flow_ml_s);
            }
        }
        (x[0], slip)
    };
    let ran = |for_s: f64, voltage_v: f64| Ran { for_s, voltage_v };
    alike(run(&[ran(900.0, 12.0)]).1, 0.4);
    alike(run(&[ran(900.0, -6.0)]).1, 0.1);
    alike(run(&[ran(60.0, 24.0)]).1, 1.6 * (1.0 - (-1f64).exp()));
    assert_eq!(run(&[ran(60.0, 0.0)]), (0.0, 0.0), "it stands still");
    let history = [ran(20.0, 9.0), ran(35.0, 0.0), ran(10.0, -15.0), ran(0.5, 3.0)];
    let rest = Rest {
        arrival: Arrival::Free,
        ran: &history,
        angle_rad: 0.0,
        pressure_bar: [2.0; 2],
        actuator_torque_nm: 0.0,
        torque_nm: 0.0,
        voltage_v: 3.0,
        brake_open: true,
        bypass_open: false,
    };
    let mut x = [f64::NAN];
    form.rest_value(&k, &rest, &mut x);
    alike(x[0], run(&history).0);
}

#[test]
fn oil_that_thins_exponentially_slips_the_more_the_warmer_it_is_and_alike_at_first() {
    // after ten hours by running, W = 1, and by its losses, W = x
    let slip = |c: f64, w: f64, x: f64| {
        let mut line = line(36_000.0, 1.0);
        general("pump_warming").act_value(&[0.4, 60.0, 0.0, w, c], &[x], &mut [0.0], &mut Port::Line(&mut line));
        -line.flow_ml_s
    };
    for (w, x, warmth) in [(0.0, 0.3, 1.0), (1.0, 0.3, 0.3), (1.0, 2.0, 2.0), (0.5, 2.0, 1.5)] {
        alike(slip(0.0, w, x), 0.4 * warmth);
        for c in [-1.0f64, 0.4, 2.0] {
            alike(slip(c, w, x), 0.4 * ((c * warmth).exp() - 1.0) / c);
            assert!(slip(c, w, x) > 0.0 && (slip(c, w, x) > slip(0.0, w, x)) == (c > 0.0), "it is passive");
        }
        // the series meets the quotient
        let near = |c: f64| slip(c, w, x) / slip(0.0, w, x);
        assert!((near(0.999e-3 / warmth) - near(1.001e-3 / warmth)).abs() < 2e-6);
        assert!(near(1e-4) > 1.0 && (near(1e-4) - 1.0) < 1.1e-4 * warmth);
    }
    assert_eq!(slip(2.0, 1.0, 0.0), 0.0, "cold");
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
