//! The plants of the list: derivatives, simulated data with planted effects, and the measured benchmarks where they are at hand.
#![allow(clippy::unwrap_used, reason = "a test")]

use std::fmt::Write;
use std::path::Path;

use identify::diagnose::{Declared, Verdict, diagnose_declared};
use identify::layout::Layout;
use identify::plant::Plant;
use identify::plants::analysis::{PlantAnalysis, analyse, fit_declared, problem_from};
use identify::plants::{EMPS, PLANTS, SILVERBOX, Source, Table, TablePlant};
use identify::prepare::Stretch;
use model::effects::{CoulombFriction, CubicStiffness, ForceOffset, QuadraticDrag};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[test]
fn headers_of_the_list_are_complete() {
    let mut ids: Vec<&str> = PLANTS.iter().map(|p| p.header().id).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), PLANTS.len());
    for plant in PLANTS {
        let h = plant.header();
        assert!(h.summary.len() > 8 && h.equation.len() > 4, "{}", h.id);
        assert!(!h.channels.is_empty() && !h.parameters.is_empty() && !h.library.is_empty(), "{}", h.id);
        for p in h.parameters {
            assert!(p.lower <= p.start && p.start <= p.upper && !p.unit.is_empty(), "{} {}", h.id, p.name);
        }
        for e in h.library {
            let e = e.header();
            assert!(e.ports.iter().all(|p| h.ports.contains(p)), "{}: {} needs a port that it lacks", h.id, e.id);
            assert!(h.balances.iter().any(|(b, _)| *b == e.balance), "{}: {} disturbs no balance of it", h.id, e.id);
        }
    }
}

/// 2000 rows of an oscillator like the silverbox, driven by some sines: semi-implicit Euler with tiny steps, an independent peer.
fn oscillator(first: usize, cubic: f64, offset: f64) -> Stretch {
    let (m, d, k) = (5.4e-6, 2.3e-4, 1.0);
    let drive = |t: f64| (0..12).map(|j| 0.008 * (t * (60.0 + 85.0 * j as f64) + (j * j) as f64).sin()).sum::<f64>();
    let rate = 610.35;
    let (mut y, mut v) = (0.0f64, 0.0f64);
    let (mut time_s, mut u, mut shown) = (Vec::new(), Vec::new(), Vec::new());
    let mut rng = ChaCha8Rng::seed_from_u64(first as u64);
    for i in 0..first + 2000 {
        let t = i as f64 / rate;
        if i >= first {
            time_s.push(t);
            u.push(drive(t));
            shown.push(y + 1e-4 * (rng.random_range(-1.0..1.0f64) + rng.random_range(-1.0..1.0)));
        }
        let steps = 400;
        let h = 1.0 / rate / steps as f64;
        for s in 0..steps {
            let force = drive(t + s as f64 * h) + offset - d * v - k * y - cubic * y * y * y;
            v += h * force / m;
            y += h * v;
        }
    }
    let speed = (shown[1] - shown[0]) * rate;
    Stretch::of_columns(0, time_s, vec![u], vec![shown.clone()], (vec![shown[0], speed], vec![1e-2, 10.0]), 1)
}

/// A carriage like the EMPS under its controller, by small Euler steps: a training or a test file. The amplifier's voltage, which is
/// recorded, follows the controller within a sample.
fn carriage(seed: u64, coulomb_n: f64, offset_n: f64) -> Table {
    let (mass, viscous, gain) = (95.0, 200.0, 35.15065188);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut q, mut v, mut last_q) = (0.0f64, 0.0f64, 0.0f64);
    let mut text = String::from("t_s,q_m,vir_V\n");
    let (mut target, mut reference, mut applied_v) = (0.2, 0.0, 0.0);
    for i in 0..16_000 {
        let t = f64::from(i) * 1e-3;
        if i % 1300 == 0 {
            target = if target > 0.1 { rng.random_range(0.0..0.08) } else { rng.random_range(0.15..0.24) };
        }
        let step: f64 = target - reference;
        reference += step.clamp(-1.2e-4, 1.2e-4);
        let shown = ((q + 2e-7 * rng.random_range(-1.0..1.0)) / 1e-7).round() * 1e-7;
        let speed = (shown - last_q) / 1e-3;
        last_q = shown;
        let output_v = (243.45 * (160.18 * (reference - shown) - speed) / 60.0).clamp(-10.0, 10.0);
        writeln!(text, "{t},{shown},{applied_v}").unwrap();
        let slope_v = (output_v - applied_v) / 20.0;
        for _ in 0..20 {
            applied_v += slope_v;
            let force = gain * applied_v - viscous * v - coulomb_n * (v / 1e-3).tanh() - offset_n;
            v += 5e-5 * force / mass;
            q += 5e-5 * v;
        }
    }
    Table::parse(Path::new("carriage.csv"), &text).unwrap()
}

/// Slopes of `linearise` against central differences of `predict`, also along the initial values.
fn check_slopes(plant: &'static dyn Plant, stretch: &Stretch, layout: &Layout, theta: &[f64], scale: &[f64]) {
    let initial = vec![0.0; stretch.initial.len()];
    let linear = plant.linearise(stretch, layout, theta, &initial).unwrap();
    let columns = theta.len() + initial.len();
    assert_eq!(linear.predicted, plant.predict(stretch, layout, theta, &initial).unwrap());
    for c in 0..columns {
        let h = 1e-5 * scale[c];
        let moved = |by: f64| {
            let (mut theta, mut initial) = (theta.to_vec(), initial.clone());
            if c < theta.len() {
                theta[c] += by
            } else {
                initial[c - theta.len()] += by
            }
            plant.predict(stretch, layout, &theta, &initial).unwrap()
        };
        let (up, down) = (moved(h), moved(-h));
        let central: Vec<f64> = up.iter().zip(&down).map(|(a, b)| (a - b) / (2.0 * h)).collect();
        let most = central.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        assert!(most > 0.0, "column {c} does nothing");
        for (t, v) in central.iter().enumerate() {
            let slope = linear.slope[t * columns + c];
            assert!((slope - v).abs() < 1e-4 * most, "column {c}, target {t}: {slope} but differences say {v}");
        }
    }
}

#[test]
fn slopes_are_those_of_differences() {
    let mut layout = Layout::of_plant(&SILVERBOX);
    layout.effects = vec![&CubicStiffness, &ForceOffset, &QuadraticDrag];
    let theta = [5.4e-6, 2.3e-4, 1.0, 3.9, -0.005, 1e-7];
    let stretch = oscillator(300, 3.9, -0.005).shortened(0.5);
    check_slopes(&SILVERBOX, &stretch, &layout, &theta, &[5e-6, 2e-4, 1.0, 4.0, 0.01, 1e-6, 0.01, 1.0]);

    let mut layout = Layout::of_plant(&EMPS);
    layout.effects = vec![&CoulombFriction, &ForceOffset];
    let sections = EMPS.sections(&carriage(1, 20.0, 3.0), Source::Data).unwrap();
    let stretch = sections[0].stretches[0].shortened(3.0);
    check_slopes(&EMPS, &stretch, &layout, &[95.0, 200.0, 20.0, 0.005, 3.0], &[95.0, 200.0, 20.0, 0.005, 3.0]);
}

#[test]
fn an_oscillator_with_a_hardening_spring_and_an_offset_is_told_as_such() {
    let stretches = vec![oscillator(300, 3.9, -0.005), oscillator(4000, 3.9, -0.005), oscillator(9000, 3.9, -0.005)];
    let problem = problem_from(&SILVERBOX, stretches);
    let declared = fit_declared(&SILVERBOX, &problem).unwrap();
    let start = Layout::of_plant(&SILVERBOX).fixed;
    let base = Declared { problem: &problem, fit: &declared, component: &start };
    let found = diagnose_declared(SILVERBOX.header().library, &base, &|_| {}).unwrap();
    let value = |id: &str| {
        let a =
            found.effects.iter().find(|a| a.effect.header().id == id).unwrap_or_else(|| panic!("{id} is not found"));
        (a.values[0], a.known[0].std)
    };
    let (cubic, std) = value("cubic_stiffness");
    assert!((cubic - 3.9).abs() < 0.03 * 3.9 + 4.0 * std, "{cubic} +- {std}");
    let (offset, std) = value("force_offset");
    assert!((offset + 0.005).abs() < 2e-4 + 4.0 * std, "{offset} +- {std}");
}

#[test]
fn a_carriage_with_dry_friction_is_told_as_such_and_its_offset_is_a_class() {
    let result = analyse(&EMPS, &carriage(1, 20.0, 3.0), Some(&carriage(2, 20.0, 3.0)), &|_| {}).unwrap();
    assert_coulomb(&result);
    let c = &result.findings.effects.iter().find(|e| e.id == "coulomb_friction").unwrap().parameters.0[0].1;
    assert!((c.value - 20.0).abs() < 0.5, "{} +- {}", c.value, c.std);
}

#[test]
fn a_carriage_as_declared_is_left_alone() {
    let result = analyse(&EMPS, &carriage(3, 0.0, 0.0), Some(&carriage(4, 0.0, 0.0)), &|_| {}).unwrap();
    assert_eq!(result.diagnosis.verdict, Verdict::None, "{:?}", result.findings.effects);
}

/// Coulomb friction for itself, and offset and asymmetry as one class.
fn assert_coulomb(result: &PlantAnalysis) {
    let effects = &result.findings.effects;
    assert_eq!(result.diagnosis.verdict, Verdict::Attributed);
    let coulomb = effects.iter().find(|e| e.id == "coulomb_friction").unwrap();
    assert!(coulomb.equivalent.is_empty(), "{:?}", coulomb.equivalent);
    let class = effects.iter().any(|e| {
        let both = ["force_offset", "asymmetric_coulomb"];
        both.contains(&e.id) && e.equivalent.iter().any(|o| both.contains(&o.as_str()))
    });
    assert!(class, "{effects:?}");
}

/// The file that this variable names, or a loud word that the test has nothing to say.
fn measured(variable: &str) -> Option<Table> {
    match std::env::var_os(variable) {
        Some(file) => Some(Table::read(Path::new(&file)).unwrap()),
        None => {
            eprintln!("NOT TESTED: {variable} does not name a file of measured data (docs/PLANTS.md)");
            None
        }
    }
}

#[test]
fn the_measured_silverbox_has_a_hardening_spring() {
    let Some(data) = measured("REC_BENCH_SILVERBOX") else { return };
    let result = analyse(&SILVERBOX, &data, None, &|_| {}).unwrap();
    let effects = &result.findings.effects;
    let cubic = effects.iter().find(|e| e.id == "cubic_stiffness").unwrap();
    assert!(cubic.equivalent.is_empty());
    let class = effects.iter().any(|e| {
        let both = ["force_offset", "quadratic_stiffness"];
        both.contains(&e.id) && e.equivalent.iter().any(|o| both.contains(&o.as_str()))
    });
    assert!(class, "{effects:?}");
    let arrow = result.scored.iter().find(|s| s.section == "arrow").unwrap();
    assert!(arrow.after.unwrap().rmse < 0.40e-3, "{:?}", arrow.after);
}

#[test]
fn the_measured_carriage_has_dry_friction() {
    let (Some(train), Some(test)) = (measured("REC_BENCH_EMPS"), measured("REC_BENCH_EMPS_TEST")) else { return };
    let result = analyse(&EMPS, &train, Some(&test), &|_| {}).unwrap();
    assert_coulomb(&result);
    assert!(result.scored[0].after.unwrap().relative < 0.06, "{:?}", result.scored[0].after);
}
