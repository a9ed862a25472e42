//! Recordings made by the model itself, with noise: what a perfect rig would leave.

#![allow(dead_code, reason = "no test uses all of it")]
#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

use std::path::Path;

use identify::analysis::Analysis;
use identify::diagnose::{Diagnosis, Verdict};
use identify::fit::Fit;
use identify::identification::Loaded;
use identify::layout::Layout;
use identify::prepare::{Channel, stretches};
use identify::problem::{Point, Problem};
use model::Parameters;
use model::effects::{Balance, Effect, EffectSet, find};
use model::integrate::Integrator;
use model::rec::{self, Circuit, Input, Lever, STATES, state};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, StandardNormal};
use recordings::{Campaign, Plane, Protocol, Recording, RigFacts, Role, RunEntry};

pub const ANGLE_NOISE_DEG: f64 = 0.01;
pub const PRESSURE_NOISE_BAR: f64 = 0.006;

/// A run with a free lever at 500 Hz: 1 s of rest, then voltages of `dwell_s` each, every fifth with the bypass open, every
/// seventh with the brake closed.
pub fn dynamic(
    truth: &Parameters,
    effect: Option<(&'static dyn Effect, Vec<f64>)>,
    seconds: f64,
    seed: u64,
) -> Recording {
    run(truth, effect.into_iter().collect(), seconds, seed)
}

/// [`dynamic`] with any number of effects.
pub fn run(truth: &Parameters, effects: Vec<(&'static dyn Effect, Vec<f64>)>, seconds: f64, seed: u64) -> Recording {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, 1.0).unwrap();
    let effects = EffectSet::new(STATES, effects);
    let k = truth.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    x[state::PRESSURE1] = 2.8;
    x[state::PRESSURE2] = 2.8;
    let mut r = Recording::default();
    let integrator = Integrator::new(0.5e-3);
    let mut scratch = x.clone();
    let levels = [9.0, -14.0, 20.0, -21.0, 4.0, -8.0, 16.0, -18.0, 12.0, -3.0, 21.0, -12.0];
    let dwell_s = 0.9;
    let rows = (seconds * 500.0) as usize;
    for i in 0..rows {
        let t = i as f64 * 2e-3;
        let n = if t < 1.0 { 0 } else { 1 + ((t - 1.0) / dwell_s) as usize };
        let input = Input {
            voltage_v: if n == 0 { 0.0 } else { levels[(n * 5 + n / 12) % levels.len()] },
            brake_open: n == 0 || n % 7 != 0,
            bypass_open: n > 0 && n % 5 == 0,
            vertical: false,
            lever: Lever::Free,
            circuit: Circuit::Pump,
        };
        if i == 0 {
            rec::rest_states(&input, &k, &effects, &mut x);
        }
        let shown = rec::shown(&effects, t, &x, &mut scratch);
        r.time_s.push(t);
        r.voltage_v.push(input.voltage_v);
        r.angle_deg.push(shown[0] + ANGLE_NOISE_DEG * normal.sample(&mut rng));
        r.pressure1_bar.push(shown[1] + PRESSURE_NOISE_BAR * normal.sample(&mut rng));
        r.pressure2_bar.push(shown[2] + PRESSURE_NOISE_BAR * normal.sample(&mut rng));
        r.torque_nm.push(f64::NAN);
        r.volume_ml.push(f64::NAN);
        r.brake_open.push(input.brake_open);
        r.bypass_open.push(input.bypass_open);
        r.segment.push(n as i64);
        integrator.advance(&input, &k, &effects, t, 2e-3, &mut x).unwrap();
    }
    r
}

/// A problem out of such runs.
pub fn problem(runs: &[Recording]) -> Problem {
    let mut problem = Problem::default();
    for (n, r) in runs.iter().enumerate() {
        for s in stretches(n, "run.csv", Protocol::RandomSteps, Plane::Horizontal, r).unwrap() {
            problem.std.push(
                Channel::ALL
                    .map(|c| match c {
                        Channel::Angle => ANGLE_NOISE_DEG,
                        Channel::Pressure1 | Channel::Pressure2 => PRESSURE_NOISE_BAR,
                        _ => 0.05,
                    })
                    .to_vec(),
            );
            problem.steps.push(vec![0.0; 5]);
            problem.stretches.push(s);
        }
    }
    problem
}

/// What free motion alone determines well: torque stiffness and force, displacement, pump, losses; the rest is given.
pub fn layout(truth: &Parameters) -> Layout {
    use model::parameters::index::*;
    let mut layout = Layout::base(truth);
    layout.base = vec![M2, M3, V2, F1, F3, F4, L2, L3, A, K_B];
    layout
}

/// A campaign folder of dynamic runs, read back.
pub fn campaign(dir: &Path, runs: &[(&str, Role, Recording)]) -> Loaded {
    let example = Parameters::example();
    let entry = |(file, role, recording): &(&str, Role, Recording)| {
        recording.write_csv(&dir.join(file)).unwrap();
        let (file, role) = (file.to_string(), *role);
        RunEntry { file, protocol: Protocol::RandomSteps, role, plane: Plane::Horizontal }
    };
    let rig = RigFacts { inertia_kg_m2: example.load.J, gravity_nm: example.load.G, u_max_v: example.pump.u_max };
    let campaign =
        Campaign { dir: dir.to_owned(), name: "made by the model".into(), rig, runs: runs.iter().map(entry).collect() };
    campaign.write_toml().unwrap();
    Loaded::read(dir).unwrap()
}

/// The true values as if a fit had found them, with effects.
pub fn fit_at(truth: &Parameters, effects: &[(&str, &[f64])]) -> Fit {
    let mut layout = Layout::base(truth);
    let mut theta = layout.vector_of(truth);
    for (id, values) in effects {
        layout = layout.with(find(id).unwrap());
        theta.extend_from_slice(values);
    }
    Fit { layout, point: Point { theta, initial: Vec::new() }, cost: 1.0, converged: true }
}

/// A diagnosis with this verdict that names nothing yet.
pub fn diagnosis(verdict: Verdict, after: &Fit) -> Diagnosis {
    Diagnosis {
        verdict,
        effects: Vec::new(),
        ranking: Vec::new(),
        balances: Balance::ALL.into_iter().map(|b| (b, 0.0005)).collect(),
        after: after.clone(),
        parts_before: Vec::new(),
        parts_after: Vec::new(),
        explained: 1.0,
        next_experiment: None,
        shows: Vec::new(),
        silent: false,
    }
}

/// Figures that show something under anchors of their own, tables with a cell a column.
pub fn check_report(analysis: &Analysis) {
    let mut ids: Vec<&str> = analysis.figures.iter().map(|f| f.id.as_str()).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), analysis.figures.len(), "every figure has an anchor of its own");
    for f in &analysis.figures {
        assert!(f.series.iter().all(|s| s.x.len() == s.y.len()), "{}", f.id);
        assert!(f.series.iter().any(|s| s.y.iter().any(|v| v.is_finite())), "{} shows nothing", f.id);
    }
    for t in &analysis.tables {
        assert!(t.rows.iter().all(|r| r.len() == t.columns.len()), "{}: {:?}", t.title, t.rows);
    }
}

/// Memory of the noise, s; half a second is twice what the colour of a residual is looked for over.
const MEMORY_S: f64 = 0.5;

/// Adds first-order noise, half as large again as the white one, to both pressures.
pub fn creeping(mut r: Recording, seed: u64) -> Recording {
    let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
    let kept = (-2e-3 / MEMORY_S).exp();
    let std = 1.5 * PRESSURE_NOISE_BAR;
    for pressure in [&mut r.pressure1_bar, &mut r.pressure2_bar] {
        let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
        let mut noise = std * draw();
        for p in pressure {
            *p += noise;
            noise = kept * noise + std * (1.0 - kept * kept).sqrt() * draw();
        }
    }
    r
}
