//! `bench simulate` is the reference model and nothing else: bit for bit what the integrator gives at 0.25 ms.

#![allow(clippy::unwrap_used, reason = "a test")]

mod exchange;

use exchange::{Flaws, record, refused, text};
use model::effects::{EffectSet, find};
use model::integrate::Integrator;
use model::parameters::AddedEffect;
use model::rec::{self, Circuit, Input, Lever, STATES, state};
use model::{ModelFile, Parameters};
use recordings::{Protocol, Recording};
use std::path::Path;
use std::process::Command;

/// Four seconds at an uneven rate, with both valves switched.
fn run() -> Recording {
    let rows = 1500;
    let mut time_s = vec![0.0];
    for i in 1..rows {
        time_s.push(time_s[i - 1] + if i % 3 == 0 { 4e-3 } else { 1.5e-3 });
    }
    let phase = |i: usize| i / 250;
    Recording {
        voltage_v: (0..rows).map(|i| [0.0, 20.0, -21.6, 7.3, -0.5, 12.0][phase(i)]).collect(),
        angle_deg: (0..rows).map(|i| 3.25 + i as f64).collect(),
        pressure1_bar: vec![2.81; rows],
        pressure2_bar: vec![2.64; rows],
        torque_nm: vec![f64::NAN; rows],
        volume_ml: vec![1.0; rows],
        brake_open: (0..rows).map(|i| phase(i) != 3).collect(),
        bypass_open: (0..rows).map(|i| phase(i) == 4).collect(),
        segment: (0..rows).map(|i| phase(i) as i64).collect(),
        time_s,
    }
}

fn simulated(model: &ModelFile, plane: &str, more: &[&str]) -> Recording {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(at("model.toml"), model.to_toml()).expect("writable");
    run().write_csv(Path::new(&at("run.csv"))).expect("writable");
    let (model, run, out) = (at("model.toml"), at("run.csv"), at("out.csv"));
    let output = Command::new(env!("CARGO_BIN_EXE_bench"))
        .args(["simulate", &model, &run, "--plane", plane, "--out", &out])
        .args(more)
        .output()
        .expect("the binary was just built");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    Recording::read(Path::new(&out), Protocol::RandomSteps).expect("contract columns")
}

/// Angle (deg) and pressures (bar) at each row, by the integrator alone.
fn integrated(model: &ModelFile, effects: &EffectSet<f64>, vertical: bool) -> Vec<[f64; 3]> {
    let r = run();
    let k = model.parameters.to_vector();
    let mut x = vec![0.0; STATES + effects.states];
    x[state::ANGLE] = r.angle_deg[0].to_radians();
    x[state::PRESSURE1] = r.pressure1_bar[0];
    x[state::PRESSURE2] = r.pressure2_bar[0];
    let input = |i: usize| Input {
        voltage_v: r.voltage_v[i],
        brake_open: r.brake_open[i],
        bypass_open: r.bypass_open[i],
        vertical,
        lever: Lever::Free,
        circuit: Circuit::Pump,
    };
    rec::rest_states(&input(0), &k, effects, &mut x);
    let integrator = Integrator::new(0.25e-3);
    let mut scratch = x.clone();
    let mut out = Vec::new();
    for i in 0..r.len() {
        out.push(rec::shown(effects, r.time_s[i], &x, &mut scratch));
        if i + 1 < r.len() {
            let dt = r.time_s[i + 1] - r.time_s[i];
            integrator.advance(&input(i), &k, effects, r.time_s[i], dt, &mut x).expect("stays in range");
        }
    }
    out
}

#[track_caller]
fn same_bits(simulated: &Recording, expected: &[[f64; 3]]) {
    assert_eq!(simulated.len(), expected.len());
    for (i, e) in expected.iter().enumerate() {
        let got = [simulated.angle_deg[i], simulated.pressure1_bar[i], simulated.pressure2_bar[i]];
        assert_eq!(got.map(f64::to_bits), e.map(f64::to_bits), "row {i}: {got:?} for {e:?}");
    }
}

#[test]
fn the_simulation_is_the_integrator_s_bit_for_bit_in_both_planes() {
    let model = ModelFile::plain(Parameters::example());
    for (plane, vertical) in [("horizontal", false), ("vertical", true)] {
        let got = simulated(&model, plane, &[]);
        same_bits(&got, &integrated(&model, &EffectSet::none(), vertical));
        let r = run();
        assert_eq!((&got.time_s, &got.voltage_v, &got.segment), (&r.time_s, &r.voltage_v, &r.segment));
        assert_eq!((&got.brake_open, &got.bypass_open), (&r.brake_open, &r.bypass_open));
        assert!(got.torque_nm.iter().chain(&got.volume_ml).all(|v| v.is_nan()), "nothing that was not simulated");
    }
}

#[test]
fn the_effects_of_the_file_act_as_in_the_library() {
    let lag = find("pump_lag").expect("in the library");
    let mut model = ModelFile::plain(Parameters::example());
    model.effect.push(AddedEffect { id: "pump_lag".into(), parameters: [("tau".to_string(), 0.02)].into() });
    let effects = EffectSet::new(STATES, [(lag, vec![0.02])]);
    same_bits(&simulated(&model, "horizontal", &["--with-effects"]), &integrated(&model, &effects, false));
    same_bits(&simulated(&model, "horizontal", &[]), &integrated(&model, &EffectSet::none(), false));
}

#[test]
fn a_recording_says_itself_which_experiment_it_is_and_in_which_plane() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    std::fs::write(at("model.toml"), ModelFile::plain(Parameters::example()).to_toml()).unwrap();
    // Vertical, and no run of random steps.
    record(&at("run.mcap"), Protocol::SquareWave, 500, Flaws::default());
    exchange::done(&["export", text(&at("run.mcap")), "--out", text(&at("run.csv"))]);
    let simulate = |run: &str, out: &str, plane: &[&str]| {
        let (model, run, out) = (at("model.toml"), at(run), at(out));
        exchange::done(&[&["simulate", text(&model), text(&run), "--out", text(&out)][..], plane].concat());
        std::fs::read_to_string(&out).unwrap()
    };
    let own = simulate("run.mcap", "own.csv", &[]);
    assert_eq!(own, simulate("run.mcap", "said.csv", &["--plane", "vertical"]));
    assert_eq!(own, simulate("run.csv", "vertical.csv", &["--plane", "vertical"]));
    assert_ne!(own, simulate("run.csv", "horizontal.csv", &["--plane", "horizontal"]));

    let (model, run, out) = (at("model.toml"), at("run.mcap"), at("contradicted.csv"));
    let arguments = ["simulate", text(&model), text(&run), "--plane", "horizontal", "--out", text(&out)];
    refused(&arguments, &["run.mcap", "\"vertical\"", "got --plane horizontal", "leave --plane out"]);
    assert!(!out.exists());
}
