//! What a dry run predicts is what the run does, but for the noise; what it says of limits is what the supervisor does.

use bench::dry_run::{Prediction, predict};
use bench::emulation::{draw, rig_for};
use bench::rig_file::{DeviceSpec, EMULATED, Rig, WIRED};
use bench::simulation::added_effects;
use drivers::EmulatedRig;
use drivers::emulated::{Noise, Settings};
use model::ModelFile;
use model::effects::LIBRARY;
use profiles::{BUILTIN, Context, EXAMPLES, Hands, Plane, Script};
use rt_core::{
    Breach, Channel, Device, Ended, Handover, Limits, Lockstep, Publish, Run, RunReport, Sample, Stages, Supervisor,
};
use std::path::Path;

const SEED: u64 = 7;

fn emulated() -> Rig {
    Rig::parse(EMULATED, "emulated.toml", Path::new("")).expect("the built-in rig file")
}

fn plant(rig: &Rig) -> &ModelFile {
    match &rig.device {
        DeviceSpec::Emulated(plant) => plant,
        DeviceSpec::Wired(_) => panic!("the built-in rig is emulated"),
    }
}

fn builtin(name: &str) -> Script {
    let file = format!("{name}.toml");
    let (file, text) = BUILTIN.iter().chain(EXAMPLES).find(|(known, _)| *known == file).expect("built in");
    Script::parse(text, file).expect("parses")
}

#[derive(Default)]
struct Kept(Vec<Sample>);

impl Publish for Kept {
    fn publish(&mut self, sample: &Sample) -> Handover {
        self.0.push(*sample);
        Handover::Taken
    }
}

/// The run itself: under the script's own limits, with the supervisor that trips.
fn run(script: &Script, rig: &Rig, device: &mut dyn Device, limits: Limits) -> (RunReport, Vec<Sample>) {
    let context = Context { u_max_v: rig.facts.u_max_v, seed: SEED, hands: Hands::Rig };
    let limits = script.envelope.narrow(&limits).expect("narrower");
    let (mut flight, _log) = rt_core::flight::recorder();
    let mut kept = Kept::default();
    let stages = Stages {
        clock: &mut Lockstep::default(),
        device,
        operator: &mut (),
        supervisor: &mut Supervisor::new(limits).expect("sound"),
        reference: &mut script.compile(&context).expect("compiles"),
        controller: &mut *rig.knowledge.controller(script.plane).expect("known"),
        publish: &mut kept,
        flight: &mut flight,
    };
    let report = rt_core::run(stages, Run { number: 0, overrun: script.overrun }).expect("the device does not fail");
    (report, kept.0)
}

/// The rig of the dry run: what it shows is what is there.
fn without_noise(script: &Script, model: &ModelFile) -> EmulatedRig {
    let settings = Settings {
        start: script.start(),
        fill_bar: script.fill_bar.unwrap_or(Settings::default().fill_bar),
        vertical: script.plane == Plane::Vertical,
        noise: Noise::NONE,
        release_spread: 0.0,
        ..Settings::default()
    };
    EmulatedRig::new(&model.parameters, added_effects(model).expect("known"), settings).expect("a rig")
}

fn ends(samples: &[Sample], of: impl Fn(&Sample) -> f64) -> (f64, f64) {
    let values = samples.iter().map(of).filter(|value| !value.is_nan());
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

fn value_of(channel: Channel) -> fn(&Sample) -> f64 {
    match channel {
        Channel::Pressure1 => |s| s.pressure1_bar,
        Channel::Pressure2 => |s| s.pressure2_bar,
        Channel::Angle => |s| s.angle_deg,
        Channel::Torque => |s| s.torque_nm,
        Channel::Voltage => |s| s.voltage_v,
        other => panic!("{other:?} is in no sample"),
    }
}

fn predicted(script: &Script, rig: &Rig, model: &ModelFile) -> Prediction {
    predict(script, rig, model, SEED).expect("predicts")
}

/// The peaks of a recorded run lie within the sensors' noise about the predicted ones: `wide` times 6 standard deviations.
fn assert_within_noise(script: &Script, rig: &Rig, model: &ModelFile, wide: f64) {
    let prediction = predicted(script, rig, model);
    let mut device = rig_for(model, script, SEED, 0).expect("a rig");
    let (report, samples) = run(script, rig, &mut device, rig.limits);
    assert_eq!((report.ended, prediction.trip.is_none()), (Ended::Completed, true), "{}: {report}", script.name);
    let noise = Noise::default();
    for channel in [Channel::Pressure1, Channel::Pressure2, Channel::Angle, Channel::Torque, Channel::Voltage] {
        let deviation = match channel {
            Channel::Angle => noise.angle_deg + noise.encoder_step_deg,
            Channel::Torque => noise.torque_nm,
            // What a controller makes of the noise.
            Channel::Voltage => 0.05,
            _ => noise.pressure_bar,
        };
        let (low, high) = ends(&samples, value_of(channel));
        let Some(peak) = prediction.peak(channel) else {
            assert!(low > high, "{}: {channel:?} is measured and not predicted", script.name);
            continue;
        };
        let most = 6.0 * deviation * wide;
        let off = [(peak.least.value - low).abs(), (peak.most.value - high).abs()];
        assert!(
            off.into_iter().all(|off| off <= most),
            "{}: {channel:?}: predicted {:.4} .. {:.4}, recorded {low:.4} .. {high:.4}",
            script.name,
            peak.least.value,
            peak.most.value
        );
    }
}

#[test]
fn predicted_peaks_are_those_of_the_run_within_the_noise() {
    let rig = emulated();
    for (name, wide) in [
        ("square_h", 1.0),
        ("square_v", 1.0),
        ("random_a", 1.0),
        ("pump_map", 1.0),
        ("volume_map", 1.0),
        ("constant_flow", 1.0),
        // When a pressure settles within the noise decides how far it comes.
        ("torque_map", 3.0),
        ("angle_sine", 1.0),
        ("pressure_steps", 3.0),
    ] {
        assert_within_noise(&builtin(name), &rig, plant(&rig), wide);
    }
}

#[test]
fn a_drawn_rig_with_its_effect_is_predicted_by_its_own_model() {
    let rig = emulated();
    for seed in [2, 5, 11] {
        assert_within_noise(&builtin("square_h"), &rig, &draw(seed, LIBRARY), 1.0);
    }
}

/// The same script under a limit.
fn under(script: &Script, limit: &str) -> Script {
    Script::parse(&format!("{}\n[envelope]\n{limit}\n", script.text), "under.toml").expect("parses")
}

#[test]
fn a_limit_that_is_exceeded_by_little_is_found_and_one_that_is_not_is_not() {
    let rig = emulated();
    let model = plant(&rig);
    for name in ["square_h", "random_a", "torque_map"] {
        let script = builtin(name);
        let free = predicted(&script, &rig, model);
        for (channel, key) in [
            (Channel::Pressure1, "pressure_max_bar"),
            (Channel::Angle, "angle_max_deg"),
            (Channel::Velocity, "velocity_max_deg_s"),
            (Channel::Torque, "torque_max_nm"),
            (Channel::Voltage, "voltage_max_v"),
        ] {
            let Some(peak) = free.peak(channel) else { continue };
            let mut most = peak.least.value.abs().max(peak.most.value);
            if channel == Channel::Pressure1 {
                most = most.max(free.peak(Channel::Pressure2).expect("measured").most.value);
            }
            // Where the lever is held, it has no velocity.
            if most == 0.0 {
                continue;
            }
            let just = |share: f64| predicted(&under(&script, &format!("{key} = {}", most * share)), &rig, model);
            assert_eq!(just(1.0 + 1e-6).trip, None, "{name}: {key} above {most}");
            let trip = just(1.0 - 1e-6).trip.unwrap_or_else(|| panic!("{name}: {key} below {most}"));
            let limit = most * (1.0 - 1e-6);
            assert!(
                matches!(trip.trip.breach, Breach::Above(at) if at == limit)
                    || matches!(trip.trip.breach, Breach::Below(at) if at == -limit),
                "{name}: trips at its own value: {trip:?}"
            );
            assert!(trip.trip.value.abs() > limit && trip.trip.value.abs() <= most);
        }
    }
}

#[test]
fn the_predicted_trip_is_the_one_that_the_supervisor_comes_to_on_that_rig() {
    let rig = emulated();
    let model = plant(&rig);
    let mut tripped = 0;
    for (name, limits) in [
        (
            "square_h",
            ["pressure_max_bar = 2.9", "pressure_min_bar = 2.7", "angle_max_deg = 12.5", "velocity_max_deg_s = 9"],
        ),
        (
            "square_v",
            ["pressure_max_bar = 3.1", "pressure_min_bar = 2.5", "angle_max_deg = 26", "velocity_max_deg_s = 14"],
        ),
        ("random_a", ["voltage_max_v = 20", "pressure_min_bar = 2.6", "angle_max_deg = 20", "velocity_max_deg_s = 11"]),
        ("torque_map", ["voltage_max_v = 1.7", "pressure_min_bar = 1.5", "torque_max_nm = 10", "pressure_max_bar = 4"]),
        (
            "volume_map",
            ["pressure_max_bar = 4.5", "pressure_min_bar = 1.9", "angle_max_deg = 39", "angle_max_deg = 25"],
        ),
    ] {
        for limit in limits {
            let script = under(&builtin(name), limit);
            let prediction = predicted(&script, &rig, model);
            let (report, samples) = run(&script, &rig, &mut without_noise(&script, model), rig.limits);
            let trip = prediction.trip.as_ref().map(|predicted| predicted.trip);
            assert_eq!(trip, report.trip, "{name}: {limit}");
            let length = prediction.ticks;
            if let Some(predicted) = &prediction.trip {
                tripped += 1;
                let before =
                    samples.iter().rfind(|sample| sample.tick < predicted.trip.tick).map_or(0, |sample| sample.step);
                let acting = if predicted.trip.channel == Channel::Voltage { predicted.step } else { before };
                assert_eq!(predicted.step, acting, "{name}: {limit}");
                assert!(prediction.judge(&script).is_err_and(|failure| failure.exit_code() == 3));
            } else {
                assert_eq!(length, samples.len() as u64, "{name}: {limit}");
                assert!(prediction.judge(&script).is_ok());
            }
        }
    }
    assert!(tripped >= 12, "{tripped} of 20: these limits are to be narrow");
}

#[test]
fn the_recorded_run_trips_where_a_limit_lies_beyond_the_noise() {
    let rig = emulated();
    let model = plant(&rig);
    let script = builtin("square_h");
    let most = predicted(&script, &rig, model).peak(Channel::Pressure1).expect("measured").most.value;
    for (limit, trips) in [(most - 0.04, true), (most + 0.04, false)] {
        let script = under(&script, &format!("pressure_max_bar = {limit}"));
        assert_eq!(predicted(&script, &rig, model).trip.is_some(), trips);
        let (report, _) = run(&script, &rig, &mut rig_for(model, &script, SEED, 0).expect("a rig"), rig.limits);
        assert_eq!(report.ended == Ended::Tripped, trips, "{report}");
    }
}

const HEAD: &str = "name = \"t\"\nprotocol = \"square-wave\"\nrole = \"identify\"\nplane = \"horizontal\"\n[start]\n\
                    fixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n";

fn script(steps: &str) -> Script {
    Script::parse(&format!("{HEAD}{steps}"), "t.toml").expect("parses")
}

#[test]
fn a_time_out_is_reported_with_its_step_and_what_was_left() {
    let rig = emulated();
    let script = script(
        "[[step]]\nfor_s = 0.5\n[[step]]\nrepeat = 2\n[[step.step]]\nvoltage_u_max = 0.5\n\
         until = [{ channel = \"angle_deg\", above = 44.0 }]\ntimeout_s = 1.0\n",
    );
    let prediction = predicted(&script, &rig, plant(&rig));
    let (_, samples) = run(&script, &rig, &mut without_noise(&script, plant(&rig)), rig.limits);
    assert_eq!(prediction.timeouts.iter().map(|t| (t.step, t.tick)).collect::<Vec<_>>(), [(1, 1500), (2, 2500)]);
    for timeout in &prediction.timeouts {
        assert_eq!(timeout.place.line, 14);
        let at =
            samples.iter().find(|sample| sample.tick == timeout.tick.min(samples.len() as u64 - 1)).expect("there");
        assert_eq!(timeout.waited[0].left, Some(at.angle_deg), "the angle that was still too small");
    }
    assert_eq!(prediction.timeouts[1].place.with, "pass 2 of 2");
}

/// The wired rig without an automatic fixture: people confirm.
fn operated_by_people() -> Rig {
    let begin = WIRED.find("[can.fixture]").expect("it has one");
    let end = begin + WIRED[begin..].find("\n\n").expect("more follows");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("rigs");
    Rig::parse(&format!("{}{}", &WIRED[..begin], &WIRED[end..]), "people.toml", &folder).expect("fits")
}

#[test]
fn a_step_that_drives_until_people_confirm_is_predicted_for_as_long_as_it_may_last() {
    let (alone, people) = (emulated(), operated_by_people());
    let model = plant(&alone);
    let step = "[[step]]\noperator = \"Look whether it leaks\"\nvoltage_u_max = 0.2\n";
    let open = script(step);
    let angle = |prediction: &Prediction| prediction.peak(Channel::Angle).expect("measured").most.value;
    let prediction = predicted(&open, &people, model);
    assert_eq!((prediction.ticks, prediction.failed.as_deref()), (60_000, None));
    let remarks = prediction.remarks();
    assert!(remarks.len() == 1 && remarks[0].contains("UNTIL PEOPLE CONFIRM: predicted for 60.0 s"), "{remarks:?}");
    let most_deg = angle(&prediction);
    assert!(most_deg > 20.0, "{most_deg}");

    let narrow = under(&open, "angle_max_deg = 5.0");
    let trip = predicted(&narrow, &people, model).trip.expect("people may take their time");
    assert_eq!((trip.trip.channel, trip.step), (Channel::Angle, 0));
    // Nobody is asked there.
    let at_once = predicted(&narrow, &alone, model);
    assert_eq!((at_once.ticks, at_once.trip, at_once.open_ended.len()), (1, None, 0));
    let timed = predicted(&script(&format!("{step}timeout_s = 0.05\n")), &people, model);
    assert_eq!((timed.ticks, timed.trip, timed.open_ended.len()), (50, None, 0));
    // What is done at rest is done at once.
    let rests = predicted(&script("[[step]]\noperator = \"Weigh it\"\n"), &people, model);
    assert_eq!((rests.ticks, rests.remarks().len()), (1, 0));
}

#[test]
fn faults_of_the_script_are_part_of_what_is_predicted() {
    let rig = emulated();
    let steps = "[[step]]\nvoltage_u_max = 0.3\nfor_s = 1.0\n[[fault]]\nat_s = 0.4\n";
    let lost = predicted(&script(&format!("{steps}kind = \"lost\"\ninput = \"angle_deg\"\n")), &rig, plant(&rig));
    let trip = lost.trip.expect("an input that stays away trips");
    assert_eq!((trip.trip.channel, trip.place.line), (Channel::Angle, 10));
    assert_eq!(lost.ticks, 1000, "and yet the script is played to its end");
    let fault = predicted(&script(&format!("{steps}kind = \"amplifier-fault\"\ncode = 5\n")), &rig, plant(&rig));
    assert!(fault.failed.is_some_and(|what| what.contains("400")), "the tick at which the amplifier failed");
}

#[test]
fn what_the_rig_can_t_serve_is_refused_before() {
    let mut rig = emulated();
    let model = plant(&rig).clone();
    let wide = script("[[step]]\nfor_s = 1\n[envelope]\nangle_max_deg = 70\n");
    let refused = |script: &Script, rig: &Rig| predict(script, rig, &model, SEED).expect_err("refused");
    let failure = refused(&wide, &rig);
    assert_eq!(failure.exit_code(), 2);
    assert!(failure.message.contains("angle_max_deg = 70") && failure.message.contains("limit of 60"), "{failure}");
    rig.knowledge = bench::setup::Knowledge::Nothing;
    let flow = script("[[step]]\nflow_ml_s = 3\nfor_s = 1\n");
    let failure = refused(&flow, &rig);
    assert_eq!(failure.exit_code(), 2);
    assert!(failure.message.contains("[controller] model"), "{failure}");
    let volts = script("[[step]]\nvoltage_v = 30\nfor_s = 1\n");
    assert!(
        refused(&volts, &rig).message.contains("beyond the rig's largest voltage"),
        "unlike a limit, nothing can exceed it"
    );
}
