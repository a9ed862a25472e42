//! Two effects at once, beside a third one that does a little of both: it is named first, and leaves its place once one of the two is there.
#![allow(clippy::unwrap_used, reason = "a test")]

use identify::diagnose::{Declared, Diagnosis, Verdict, diagnose_declared};
use identify::equations::{Between, Equations, Instant};
use identify::layout::Layout;
use identify::plant::{BaseParameter, PlantHeader, Quantity};
use identify::plants::analysis::{fit_declared, problem_from};
use identify::plants::{DataError, Section, Source, Table, TablePlant};
use identify::prepare::Stretch;
use model::effects::{Balance, CubicStiffness, Header, Law, Parameter, QuadraticDrag};
use model::port::{Port, PortKind};
use model::scalar::Scalar;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Mass 1 kg on a spring, near 1 Hz.
struct Oscillator;

static HEADER: PlantHeader = PlantHeader {
    id: "oscillator",
    summary: "a mass on a spring with a damper, driven by a force",
    equation: "m y'' + d y' + k y = u",
    states: &[Quantity { name: "y", unit: "m" }, Quantity { name: "speed", unit: "m/s" }],
    inputs: &[Quantity { name: "u", unit: "N" }],
    channels: &[Quantity { name: "y", unit: "m" }],
    parameters: &[
        BaseParameter { name: "m", unit: "kg", lower: 0.1, upper: 10.0, start: 1.0 },
        BaseParameter { name: "d", unit: "Ns/m", lower: 0.0, upper: 100.0, start: 1.0 },
        BaseParameter { name: "k", unit: "N/m", lower: 1.0, upper: 1000.0, start: 40.0 },
    ],
    balances: &[(Balance::Torque, "force")],
    ports: &[PortKind::Mechanical],
    library: &[&CubicStiffness, &QuadraticDrag, &LittleOfBoth],
};

impl Equations for Oscillator {
    fn header(&self) -> &'static PlantHeader {
        &HEADER
    }
    fn cluster_s(&self) -> f64 {
        5.0
    }
    fn step_s(&self) -> f64 {
        0.02
    }
    fn between(&self) -> Between {
        Between::Held
    }
    fn derivative<S: Scalar>(&self, at: &Instant<S>, dx: &mut [S]) {
        let (y, speed) = (at.x[0], at.x[1]);
        let force = at.mechanical(dx, y, speed) + at.u[0] - at.k[1] * speed - at.k[2] * y;
        dx[0] = speed;
        dx[1] = force / at.k[0];
    }
    fn outputs<S: Scalar>(&self, at: &Instant<S>, _dx: &mut [S], y: &mut [S]) {
        y[0] = at.x[0];
    }
}

impl TablePlant for Oscillator {
    fn resolution(&self) -> f64 {
        0.05
    }
    fn sections(&self, table: &Table, _source: Source) -> Result<Vec<Section>, DataError> {
        Err(table.refuse("this plant has no files".into()))
    }
}

/// Of the true stiffness and the true drag nearly what they do together, and something else.
struct LittleOfBoth;

impl Law for LittleOfBoth {
    const HEADER: Header = Header {
        id: "little_of_both",
        balance: Balance::Torque,
        ports: &[PortKind::Mechanical],
        summary: "a test's",
        equation: "M -= c*(y^3 + 0.015*abs(w)*w + y*abs(y))",
        validity: "a test",
        measure: "none",
        literature: "none",
        parameters: &[Parameter { name: "c", unit: "N/m3", lower: -1e3, upper: 1e3, typical: 5.0, size: true }],
        states: 0,
        starts: &[&[1.0], &[10.0]],
        passive: false,
    };
    fn act<S: Scalar>(&self, k: &[S], _x: &[S], _dx: &mut [S], port: &mut Port<'_, S>) {
        if let Port::Mechanical(m) = port {
            let (y, w) = (m.angle_rad, m.velocity_rad_s);
            m.torque_nm -= k[0] * (y * y * y + w.abs() * w * 0.015 + y.abs() * y);
        }
    }
}

const NOISE_M: f64 = 0.005;

/// 100 s at 50 Hz of an oscillator with this cubic stiffness and quadratic drag, by an integration of its own.
fn stretch(seed: u64, cubic: f64, drag: f64) -> Stretch {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, NOISE_M).unwrap();
    let force = Normal::new(0.0, 25.0).unwrap();
    let (mut y, mut w) = (0.0f64, 0.0f64);
    let (mut time_s, mut u, mut shown) = (Vec::new(), Vec::new(), Vec::new());
    let mut now = 0.0;
    for i in 0..5000u32 {
        if i >= 50 && i % 20 == 0 {
            now = force.sample(&mut rng);
        }
        time_s.push(f64::from(i) * 0.02);
        u.push(now);
        shown.push(y + noise.sample(&mut rng));
        for _ in 0..40 {
            let a = now - w - 40.0 * y - cubic * y.powi(3) - drag * w.abs() * w;
            w += 0.0005 * a;
            y += 0.0005 * w;
        }
    }
    Stretch::of_columns(0, time_s, vec![u], vec![shown], (vec![0.0, 0.0], vec![0.0, 0.0]), 1)
}

fn told(cubic: f64, drag: f64) -> Diagnosis {
    let stretches = (0..3).map(|seed| stretch(seed, cubic, drag)).collect();
    let problem = problem_from(&Oscillator, stretches);
    let declared = fit_declared(&Oscillator, &problem).unwrap();
    let start = Layout::of_plant(&Oscillator).fixed;
    let base = Declared { problem: &problem, fit: &declared, component: &start };
    diagnose_declared(HEADER.library, &base, &|text| println!("{text}")).unwrap()
}

#[test]
fn the_one_that_does_a_little_of_both_leaves_its_place() {
    let found = told(20.0, 0.4);
    let mut ids: Vec<&str> = found.effects.iter().map(|a| a.effect.header().id).collect();
    ids.sort_unstable();
    assert_eq!((found.verdict, &ids[..]), (Verdict::Attributed, &["cubic_stiffness", "quadratic_drag"][..]));
}
