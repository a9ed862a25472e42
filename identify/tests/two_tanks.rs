//! A plant that the project does not know, written as a user would write it (docs/PLANTS.md): two closed tanks in series. The engine
//! finds the leak that its equations lack.
#![allow(clippy::unwrap_used, reason = "a test")]

use std::fmt::Write;
use std::path::Path;

use identify::diagnose::Verdict;
use identify::equations::{Between, Equations, Instant};
use identify::plant::{BaseParameter, PlantHeader, Quantity};
use identify::plants::analysis::analyse;
use identify::plants::{DataError, Section, Source, Table, TablePlant};
use identify::prepare::Stretch;
use model::effects::{Balance, CrossLeakage, ExternalLeakage};
use model::port::{AMBIENT_BAR, HydraulicPort, PortKind};
use model::scalar::Scalar;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use recordings::Role;

/// Two tanks with a gas cushion each: a pump fills the first, an orifice leads to the second, another one out of it.
struct TwoTanks;

static TWO_TANKS: TwoTanks = TwoTanks;

static HEADER: PlantHeader = PlantHeader {
    id: "two_tanks",
    summary: "two closed tanks in series",
    equation: "C1 p1' = q - a1 sqrt(p1 - p2), C2 p2' = a1 sqrt(p1 - p2) - a2 sqrt(p2 - p_amb)",
    states: &[Quantity { name: "p1", unit: "bar" }, Quantity { name: "p2", unit: "bar" }],
    inputs: &[Quantity { name: "q", unit: "ml/s" }],
    channels: &[Quantity { name: "p1", unit: "bar" }, Quantity { name: "p2", unit: "bar" }],
    parameters: &[
        BaseParameter { name: "C1", unit: "ml/bar", lower: 1e-3, upper: 1e6, start: 50.0 },
        BaseParameter { name: "C2", unit: "ml/bar", lower: 1e-3, upper: 1e6, start: 50.0 },
        BaseParameter { name: "a1", unit: "ml/(s sqrt(bar))", lower: 1e-3, upper: 1e6, start: 7.0 },
        BaseParameter { name: "a2", unit: "ml/(s sqrt(bar))", lower: 1e-3, upper: 1e6, start: 7.0 },
    ],
    balances: &[(Balance::Flow, "flow")],
    ports: &[PortKind::Hydraulic],
    library: &[&ExternalLeakage, &CrossLeakage],
};

/// Flow of an orifice, laminar below some mbar, so that it has a slope at 0.
fn orifice<S: Scalar>(a: S, dp: S) -> S {
    a * dp / (dp * dp + 1e-6).sqrt().sqrt()
}

impl Equations for TwoTanks {
    fn header(&self) -> &'static PlantHeader {
        &HEADER
    }
    fn cluster_s(&self) -> f64 {
        20.0
    }
    fn step_s(&self) -> f64 {
        0.5
    }
    fn between(&self) -> Between {
        Between::Held
    }
    fn derivative<S: Scalar>(&self, at: &Instant<S>, dx: &mut [S]) {
        let [p1, p2] = [at.x[0], at.x[1]];
        let (between, out) = (orifice(at.k[2], p1 - p2), orifice(at.k[3], p2 - AMBIENT_BAR));
        let mut port = HydraulicPort {
            flow_ml_s: [S::constant(at.u[0]) - between, between - out],
            capacity_ml_bar: [at.k[0], at.k[1]],
            ..HydraulicPort::at(at.time_s, [p1, p2])
        };
        at.hydraulic(dx, &mut port);
        for i in 0..2 {
            dx[i] = port.flow_ml_s[i] / port.capacity_ml_bar[i];
        }
    }
    fn outputs<S: Scalar>(&self, at: &Instant<S>, _dx: &mut [S], y: &mut [S]) {
        y.copy_from_slice(&at.x[..2]);
    }
}

impl TablePlant for TwoTanks {
    fn resolution(&self) -> f64 {
        0.002
    }
    fn sections(&self, table: &Table, source: Source) -> Result<Vec<Section>, DataError> {
        let column = |name| table.column(name).map(<[f64]>::to_vec);
        let (time_s, q, p1, p2) = (column("t_s")?, column("q_ml_s")?, column("p1_bar")?, column("p2_bar")?);
        table.at_least(100, "a minute at 2 Hz, with some seconds of rest at its start")?;
        // the first 10 s are steady: their mean is the initial state
        let mean = |p: &[f64]| p[..20].iter().sum::<f64>() / 20.0;
        let initial = vec![mean(&p1), mean(&p2)];
        let (role, name) = match source {
            Source::Data => (Role::Identify, "training"),
            Source::Validation => (Role::Validate, "test"),
        };
        let spread = vec![if role == Role::Identify { 0.01 } else { 0.0 }; 2];
        let stretch = Stretch::of_columns(0, time_s, vec![q], vec![p1, p2], (initial, spread), 1);
        Ok(vec![Section { name, role, stretches: vec![stretch] }])
    }
}

const NOISE_BAR: f64 = 0.004;

/// A recording of tanks of which the first leaks `leak` (ml/s per bar), by an integration of its own.
fn recording(seed: u64, leak: f64) -> Table {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, NOISE_BAR).unwrap();
    let (c1, c2, a1, a2) = (40.0, 60.0, 8.0, 6.0);
    let flow_at = |t: f64| if t < 12.0 { 8.0 } else { 9.0 + 5.0 * ((t / 25.0).floor() * (1.7 + seed as f64)).sin() };
    let rates = |p: [f64; 2], q: f64| {
        let (between, out) = (a1 * (p[0] - p[1]).max(0.0).sqrt(), a2 * (p[1] - 1.0).max(0.0).sqrt());
        [(q - between - leak * (p[0] - 1.0)) / c1, (between - out) / c2]
    };
    let mut p = [3.5, 2.7];
    for _ in 0..200_000 {
        let d = rates(p, 8.0);
        p = [p[0] + 0.01 * d[0], p[1] + 0.01 * d[1]];
    }
    let mut text = String::from("t_s,q_ml_s,p1_bar,p2_bar\n");
    for i in 0..1200 {
        let t = f64::from(i) * 0.5;
        let shown = p.map(|v| v + noise.sample(&mut rng));
        writeln!(text, "{t},{},{},{}", flow_at(t), shown[0], shown[1]).unwrap();
        for _ in 0..500 {
            let d = rates(p, flow_at(t));
            p = [p[0] + 1e-3 * d[0], p[1] + 1e-3 * d[1]];
        }
    }
    Table::parse(Path::new("tanks.csv"), &text).unwrap()
}

#[test]
fn the_leak_of_a_tank_is_found_without_touching_the_engine() {
    let result = analyse(&TWO_TANKS, &recording(1, 0.08), Some(&recording(2, 0.08)), &|_| {}).unwrap();
    assert_eq!(result.diagnosis.verdict, Verdict::Attributed);
    let effect = &result.findings.effects[0];
    assert_eq!((effect.id, effect.balance, result.findings.effects.len()), ("external_leakage", "flow", 1));
    let (name, k1) = &effect.parameters.0[0];
    assert_eq!(*name, "k1");
    assert!((k1.value - 0.08).abs() < 4.0 * k1.std && k1.std < 0.02, "{} +- {}", k1.value, k1.std);
    for s in &result.scored {
        let (before, after) = (s.before.unwrap().rmse, s.after.unwrap().rmse);
        assert!(
            before > 1.2 * NOISE_BAR && after < 1.1 * NOISE_BAR,
            "{}: {before} before, {after} after",
            s.channel.name
        );
    }
}

#[test]
fn tight_tanks_are_left_alone() {
    let result = analyse(&TWO_TANKS, &recording(1, 0.0), Some(&recording(2, 0.0)), &|_| {}).unwrap();
    assert_eq!(result.diagnosis.verdict, Verdict::None);
    assert!(result.findings.effects.is_empty());
}
