//! A model that carries `[[effect]]`: the loops work with it, and better than without it.

#[path = "controllers/rig.rs"]
#[allow(dead_code, reason = "shared with controllers.rs")]
mod rig;

use bench::controller::{KnownEffects, PumpController, Settings};
use bench::setup::Knowledge;
use model::effects::{EffectSet, LIBRARY, find};
use model::parameters::AddedEffect;
use model::rec::STATES;
use model::{ModelFile, Parameters};
use profiles::Plane;
use rig::{Bench, play};
use rt_core::{ControlledPressure, Ended, Fixture, Lockstep, Sample, Target};

fn carrying(id: &str, values: &[f64]) -> ModelFile {
    let names = find(id).expect("in the library").header().parameters.iter().map(|p| p.name.to_owned());
    let mut model = ModelFile::plain(Parameters::example());
    model.effect.push(AddedEffect { id: id.to_owned(), parameters: names.zip(values.iter().copied()).collect() });
    model
}

/// The same task on a rig with the effect, by a controller that knows it and by one that does not.
fn both(
    id: &'static str,
    values: &[f64],
    fixture: Fixture,
    seconds: f64,
    target: impl Fn(f64) -> Target,
) -> [Vec<Sample>; 2] {
    let bench = Bench { effect: Some((id, values.to_vec())), fixture, ..Bench::new() };
    let known = carrying(id, values);
    [known, ModelFile::plain(Parameters::example())].map(|model| {
        let mut controller = PumpController::with_effects(&model, Settings::default()).expect("a sound model");
        let (samples, ended) =
            play(&mut bench.rig(), &mut controller, &mut Lockstep::default(), fixture, seconds, &target);
        assert_eq!(ended, Ended::Completed);
        samples
    })
}

fn rms(samples: &[Sample], error: impl Fn(&Sample) -> f64) -> f64 {
    let late = &samples[samples.len() / 4..];
    (late.iter().map(|s| error(s).powi(2)).sum::<f64>() / late.len() as f64).sqrt()
}

#[test]
fn a_known_zero_of_the_encoder_is_taken_out_of_the_target() {
    let target = |_: f64| Target::AngleDeg { angle_deg: 8.0, velocity_deg_s: 0.0 };
    let [with, without] = both("angle_offset", &[2.0], Fixture::Free, 8.0, target);
    let shown = |s: &[Sample]| s[s.len() - 1].angle_deg;
    assert!((shown(&with) - 10.0).abs() < 0.2, "the true angle is 8 degrees, shown {}", shown(&with));
    assert!((shown(&without) - 8.0).abs() < 0.2, "the shown angle is 8 degrees, shown {}", shown(&without));
}

#[test]
fn a_general_form_is_known_as_such_and_one_with_a_memory_is_not_used() {
    let ids = |id: &str, names: &[(&str, f64)]| {
        let mut model = ModelFile::plain(Parameters::example());
        let parameters = names.iter().map(|(name, value)| (name.to_string(), *value)).collect();
        model.effect.push(AddedEffect { id: id.to_owned(), parameters });
        let known = KnownEffects::of(&model);
        (known.ids().to_vec(), format!("{known:?}"))
    };
    let contact = [("k1", 10.0), ("k2", 10.0), ("phi_c", 30.0), ("n", 2.0), ("e", 0.0), ("c", 0.0), ("b", 0.02)];
    assert_eq!(ids("end_stop", &contact).0, ["end_stop"]);
    let creep = [("C_c", 0.3), ("tau", 1.0), ("share", 0.5), ("ratio", 5.0)];
    assert!(ids("wall_creep", &creep).0.is_empty());
}

#[test]
fn a_flow_comes_out_of_an_uneven_pump_as_it_was_asked_for() {
    let values = [0.3, 0.0, 0.0];
    let [with, without] =
        both("pump_asymmetry", &values, Fixture::Clamped { angle_deg: 0.0 }, 0.5, |_| Target::FlowMlS(4.0));
    // eq. (10) at the voltage that was given, and what the effect adds to its drive for u > 0
    let p = Parameters::example().pump;
    let off = |s: &Sample| {
        let dp = s.pressure1_bar - s.pressure2_bar;
        let drive = (p.f1 * s.voltage_v + p.f4 + p.f2 * s.voltage_v * dp).max(0.0);
        p.f3 * dp + drive * (1.0 + 0.5 * values[0]) - 4.0
    };
    let free = |s: &&Sample| s.voltage_v.abs() < p.u_max;
    let worst = |all: &[Sample]| all[100..].iter().filter(free).map(|s| off(s).abs()).fold(0.0, f64::max);
    assert!(worst(&with) < 0.05, "{}", worst(&with));
    assert!(worst(&without) > 0.5, "{}", worst(&without));
}

#[test]
fn a_leak_is_made_up_for_by_the_feed_forward() {
    let target =
        |t: f64| Target::PressureBar { of: ControlledPressure::Difference, bar: if t < 0.5 { 0.0 } else { 1.5 } };
    let held = Fixture::Clamped { angle_deg: 0.0 };
    let [with, without] = both("external_leakage", &[0.5, 0.0], held, 3.0, target);
    let error = |s: &Sample| s.pressure1_bar - s.pressure2_bar - 1.5;
    let (with, without) = (rms(&with, error), rms(&without, error));
    assert!(with < without, "{with} with, {without} without");
}

#[test]
fn a_reference_is_followed_more_closely_where_the_chambers_are_known_to_differ() {
    let (size, rate) = (6.0_f64, std::f64::consts::TAU * 0.15);
    let target = move |t: f64| Target::AngleDeg {
        angle_deg: size * (rate * t).sin(),
        velocity_deg_s: size * rate * (rate * t).cos(),
    };
    let [with, without] = both("chamber_asymmetry", &[0.8, 0.3], Fixture::Free, 16.0, target);
    let error = move |s: &Sample| s.angle_deg - size * (rate * s.time_s()).sin();
    let (with, without) = (rms(&with, error), rms(&without, error));
    assert!(with < 0.95 * without, "{with} deg with, {without} without");
}

#[test]
fn every_effect_of_the_library_leaves_a_loop_that_works() {
    for effect in LIBRARY {
        let header = effect.header();
        let model = carrying(header.id, header.starts[0]);
        let knows = KnownEffects::of(&model).ids() == [header.id];
        assert_eq!(knows, header.states == 0, "{}: effects without memory are used", header.id);
        for plane in [Plane::Horizontal, Plane::Vertical] {
            Knowledge::Model(model.clone(), Settings::default())
                .controller(plane)
                .unwrap_or_else(|e| panic!("{}: {e}", header.id));
        }
        let mut controller = PumpController::with_effects(&model, Settings::default()).expect("a sound model");
        let bench = Bench { effect: Some((header.id, header.starts[0].to_vec())), ..Bench::new() };
        let target = |_: f64| Target::AngleDeg { angle_deg: 6.0, velocity_deg_s: 0.0 };
        let (samples, ended) =
            play(&mut bench.rig(), &mut controller, &mut Lockstep::default(), Fixture::Free, 8.0, target);
        assert_eq!(ended, Ended::Completed, "{}", header.id);
        let offset = if header.id == "angle_offset" { header.starts[0][0] } else { 0.0 };
        let last = samples[samples.len() - 1].angle_deg - offset;
        assert!((last - 6.0).abs() < 0.3, "{}: {last} deg", header.id);
    }
    assert!(!EffectSet::<f64>::new(STATES, []).touches(model::port::PortKind::Sensor));
}
