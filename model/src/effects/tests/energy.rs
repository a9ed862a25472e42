//! What effects do with energy and oil.

use super::*;

/// A closed path of all signals: (angle, velocity, pressures, their rates, voltage) at time `t`, period 2 pi s.
struct Path {
    angle: [f64; 2],
    middle_bar: f64,
    pressure: [[f64; 2]; 2],
    phase: [f64; 6],
}

/// Middle of the pressures, bar, and share of their usual swing: above ambient, and for the most part below it, from 0.3 bar on.
const LEVELS: [(f64, f64); 2] = [(3.4, 1.0), (0.95, 0.295)];

impl Path {
    fn random(rng: &mut ChaCha8Rng, (middle_bar, swing): (f64, f64)) -> Self {
        let mut phase = || rng.random_range(0.0..std::f64::consts::TAU);
        let pressure = [[1.6, 0.6], [1.2, 0.9]].map(|each| each.map(|bar| bar * swing));
        Path { phase: [(); 6].map(|()| phase()), angle: [0.8, 0.15], middle_bar, pressure }
    }

    /// Two harmonics, 1 and 3: (value, rate).
    fn wave(&self, amplitude: [f64; 2], phase: usize, t: f64) -> (f64, f64) {
        let (a, b) = (t + self.phase[phase], 3.0 * t + self.phase[phase + 1]);
        (amplitude[0] * a.sin() + amplitude[1] * b.sin(), amplitude[0] * a.cos() + 3.0 * amplitude[1] * b.cos())
    }
}

/// Power (W for the lever, bar ml/s for oil) that an effect draws at one instant of the path.
fn drawn(effect: &dyn Effect, k: &[f64], x: &[f64], dx: &mut [f64], path: &Path, t: f64) -> f64 {
    dx.fill(0.0);
    let (angle_rad, velocity_rad_s) = path.wave(path.angle, 0, t);
    let (p1, rate1) = path.wave(path.pressure[0], 2, t);
    let (p2, rate2) = path.wave(path.pressure[1], 4, t);
    let pressure_bar = [path.middle_bar + p1, path.middle_bar + p2];
    let dp_bar = pressure_bar[0] - pressure_bar[1];
    let mut power = 0.0;
    for port in effect.header().ports {
        match port {
            PortKind::Mechanical => {
                let mut m = MechanicalPort {
                    dp_bar,
                    load_bar: pressure_bar[0] + pressure_bar[1] - 2.0 * AMBIENT_BAR,
                    ..MechanicalPort::at(t, angle_rad, velocity_rad_s)
                };
                effect.act_value(k, x, dx, &mut Port::Mechanical(&mut m));
                power -= m.torque_nm * velocity_rad_s;
            }
            PortKind::Hydraulic => {
                let mut h = HydraulicPort { angle_rad, velocity_rad_s, ..HydraulicPort::at(t, pressure_bar) };
                effect.act_value(k, x, dx, &mut Port::Hydraulic(&mut h));
                for (i, rate) in [rate1, rate2].into_iter().enumerate() {
                    let taken =
                        h.capacity_ml_bar[i] * rate + h.displacement_ml_rad[i] * velocity_rad_s - h.flow_ml_s[i];
                    power += (pressure_bar[i] - AMBIENT_BAR) * taken;
                }
            }
            PortKind::Line => {
                let mut l = line(t, dp_bar);
                effect.act_value(k, x, dx, &mut Port::Line(&mut l));
                power -= l.flow_ml_s * dp_bar;
            }
            PortKind::Actuator | PortKind::Sensor => panic!("{}: no power at this port", effect.header().id),
        }
    }
    power
}

#[test]
fn a_passive_effect_draws_energy_on_every_closed_path() {
    const PERIODS: usize = 8;
    const STEPS: usize = 4000;
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for effect in all().filter(|e| e.header().passive) {
        let h = effect.header();
        let stores_only = h.states == 0 && ["end_stop", "trapped_air"].contains(&h.id);
        for (start, level) in h.starts.iter().flat_map(|s| LEVELS.map(|level| (s, level))) {
            let path = Path::random(&mut rng, level);
            let mut x = vec![0.0; h.states];
            let mut dx = vec![0.0; h.states];
            let step = std::f64::consts::TAU / STEPS as f64;
            let (mut energy, mut moved) = (0.0, 0.0);
            for i in 0..PERIODS * STEPS {
                if i % STEPS == 0 {
                    (energy, moved) = (0.0, 0.0);
                }
                // midpoint rule: spectrally accurate for a smooth periodic power, second order at corners
                let t = (i as f64) * step;
                drawn(*effect, start, &x, &mut dx, &path, t);
                let middle: Vec<f64> = x.iter().zip(&dx).map(|(x, d)| x + 0.5 * step * d).collect();
                let power = drawn(*effect, start, &middle, &mut dx, &path, t + 0.5 * step);
                energy += power * step;
                moved += power.abs() * step;
                for (x, d) in x.iter_mut().zip(&dx) {
                    *x += step * d;
                }
            }
            assert!(moved > 0.0, "{} {start:?} {level:?}: the path does not touch it", h.id);
            assert!(energy >= -1e-5 * moved, "{} {start:?} {level:?}: gives {energy} of {moved}", h.id);
            if stores_only {
                assert!(energy.abs() < 1e-5 * moved, "{} {start:?} {level:?}: keeps {energy} of {moved}", h.id);
            } else {
                assert!(energy > 1e-3 * moved, "{} {start:?} {level:?}: keeps {energy} of {moved}", h.id);
            }
        }
    }
}

#[test]
fn cross_leakage_keeps_the_oil_and_stops_where_chambers_are_shut_off() {
    let leak = find("cross_leakage").unwrap();
    for pressure in [[1.2, 5.0], [5.0, 1.2], [3.0, 3.0]] {
        let mut h = HydraulicPort::at(1.0, pressure);
        leak.act_value(&[0.5, 0.02], &[], &mut [], &mut Port::Hydraulic(&mut h));
        assert_eq!(h.flow_ml_s[0] + h.flow_ml_s[1], 0.0);
        assert!(h.flow_ml_s[0] * (pressure[1] - pressure[0]) >= 0.0, "oil goes to the lower pressure");
        let mut h = HydraulicPort { shut_off: true, ..HydraulicPort::at(1.0, pressure) };
        leak.act_value(&[0.5, 0.02], &[], &mut [], &mut Port::Hydraulic(&mut h));
        assert_eq!(h.flow_ml_s, [0.0; 2]);
    }
}

#[test]
fn wall_creep_returns_all_its_oil() {
    let creep = find("wall_creep").unwrap();
    let (k, step) = ([1.5, 0.4], 1e-3);
    let mut x = [k[0] * 1.0; 2];
    let mut taken = [0.0; 2];
    let mut most: f64 = 0.0;
    for i in 0..20_000 {
        let raised = if i < 1500 { 3.0 } else { 0.0 };
        let mut h = HydraulicPort::at(1.0, [2.0 + raised, 2.0]);
        let mut dx = [0.0; 2];
        creep.act_value(&k, &x, &mut dx, &mut Port::Hydraulic(&mut h));
        for c in 0..2 {
            taken[c] -= h.flow_ml_s[c] * step;
            x[c] += dx[c] * step;
        }
        most = most.max(taken[0]);
    }
    assert!((most / (k[0] * 3.0 * (1.0 - (-1.5f64 / 0.4).exp())) - 1.0).abs() < 0.01, "took {most} ml");
    assert!(taken[0].abs() < 1e-9 && taken[1] == 0.0, "{taken:?}");
}

#[test]
fn air_that_dissolves_all_closes_the_oil_of_a_cycle() {
    // all of it is in solution from 2 bar on
    let air = find("trapped_air").and_then(|e| e.refined()).expect("it has a general form").effect;
    const STEPS: u32 = 20_000;
    let k = [0.5, 0.5, 1.0, 2.0];
    let step = std::f64::consts::TAU / f64::from(STEPS);
    let (mut x, mut oil_ml, mut most_ml) = ([0.0; 2], [0.0f64; 2], [0.0f64; 2]);
    // until it swings in: some time constants; then the oil of one cycle
    for i in 0..6 * STEPS {
        if i == 5 * STEPS {
            (oil_ml, most_ml) = ([0.0; 2], [0.0; 2]);
        }
        let at = |t: f64| ([3.0 - 2.0 * t.cos(), 1.5 - 0.5 * t.cos()], [2.0 * t.sin(), 0.5 * t.sin()]);
        let act = |x: &[f64; 2], t: f64| {
            let (pressure_bar, rate_bar_s) = at(t);
            let (mut h, mut dx) = (HydraulicPort::at(t, pressure_bar), [0.0; 2]);
            air.act_value(&k, x, &mut dx, &mut Port::Hydraulic(&mut h));
            (dx, [0, 1].map(|c| h.capacity_ml_bar[c] * rate_bar_s[c] - h.flow_ml_s[c]))
        };
        let t = f64::from(i) * step;
        let (dx, _) = act(&x, t);
        let (dx, into) = act(&[0, 1].map(|c| x[c] + 0.5 * step * dx[c]), t + 0.5 * step);
        for c in 0..2 {
            x[c] += step * dx[c];
            assert!((0.0..=k[c]).contains(&x[c]), "{x:?} ml of {} are in solution", k[c]);
            oil_ml[c] += step * into[c];
            most_ml[c] = most_ml[c].max(oil_ml[c].abs());
        }
    }
    for c in 0..2 {
        assert!(most_ml[c] > 0.05 && oil_ml[c].abs() < 1e-3 * most_ml[c], "{oil_ml:?} of {most_ml:?} ml");
    }
}

#[test]
fn a_stop_with_a_loss_keeps_a_part_of_every_push_and_never_pulls() {
    let stop = find("end_stop").and_then(|e| e.refined()).expect("it has a general form").effect;
    // pushed 0.05 rad beyond contact and back, half a sine long
    let kept = |c: f64, seconds: f64, side: f64| {
        let (n, contact) = (20_000, 30f64.to_radians());
        let step = seconds / f64::from(n);
        let (mut work, mut pushed) = (0.0, 0.0);
        for i in 0..n {
            let turn = std::f64::consts::PI / seconds;
            let phase = turn * (f64::from(i) + 0.5) * step;
            let (angle, w) = (contact + 0.05 * phase.sin(), 0.05 * turn * phase.cos());
            let mut m = MechanicalPort::at(1.0, side * angle, side * w);
            stop.act_value(&[40.0, 40.0, 30.0, 1.5, 0.0, c, 0.01], &[], &mut [], &mut Port::Mechanical(&mut m));
            let against = -side * m.torque_nm;
            assert!(against >= 0.0, "it pulls");
            work += against * w * step;
            pushed += (against * w).max(0.0) * step;
        }
        work / pushed
    };
    for side in [1.0, -1.0] {
        assert!(kept(0.0, 0.2, side).abs() < 1e-6, "without a loss all comes back");
        assert!(kept(0.5, 0.2, side) > 0.2);
        assert!(kept(0.5, 0.1, side) > kept(0.5, 0.2, side), "a faster push loses more");
    }
}
