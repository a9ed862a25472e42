//! The emulated rig against physics: what is measured must balance, stand still, and repeat.

use drivers::EmulatedRig;
use drivers::emulated::{EmulatedError, Noise, Settings};
use model::Parameters;
use model::effects::{EffectSet, find};
use model::rec::{STATES, capacity, displacement, state};
use rt_core::{Command, Device, DeviceError, Fixture, Measurement, Tick};

type EffectList<'a> = &'a [(&'a str, &'a [f64])];
type Channel = fn(&Measurement) -> f64;

fn effects(list: EffectList) -> EffectSet<f64> {
    EffectSet::new(STATES, list.iter().map(|(id, k)| (find(id).expect("in the library"), k.to_vec())))
}

fn perfect() -> Settings {
    Settings { noise: Noise::NONE, release_spread: 0.0, ..Settings::default() }
}

fn rig(settings: Settings) -> EmulatedRig {
    EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings).expect("a rig")
}

/// Runs `ticks` ticks from tick `from` on; `command` gives each tick's command.
fn run(
    rig: &mut EmulatedRig,
    from: u64,
    ticks: u64,
    mut command: impl FnMut(u64) -> Command,
) -> Result<Vec<Measurement>, DeviceError> {
    (from..from + ticks)
        .map(|k| {
            let measured = rig.read(Tick::at(k))?;
            rig.write(Tick::at(k), &command(k - from))?;
            Ok(measured)
        })
        .collect()
}

const FREE: Command =
    Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };
const SHUT: Command = Command { brake_open: false, ..FREE };

fn clamped(angle_deg: f64) -> Fixture {
    Fixture::Clamped { angle_deg }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_only_other_noise() {
    let play = |seed| {
        let mut rig = rig(Settings { seed, ..Settings::default() });
        let rows = run(&mut rig, 0, 3000, |k| Command { voltage_v: if k < 1500 { 15.0 } else { -15.0 }, ..FREE });
        let bits: Vec<u64> = rows
            .expect("runs")
            .iter()
            .flat_map(|m| [m.angle_deg, m.pressure1_bar, m.pressure2_bar, m.torque_nm, m.volume_ml].map(f64::to_bits))
            .collect();
        (bits, rig.state().iter().map(|x| x.to_bits()).collect::<Vec<_>>())
    };
    assert_eq!(play(1), play(1));
    let (one, two) = (play(1), play(2));
    assert_ne!(one.0, two.0, "the noise does not depend on the seed");
    assert_eq!(one.1, two.1, "noise reached the plant");
}

#[test]
fn a_free_lever_starts_in_its_equilibrium() {
    let cases: [(bool, EffectList); 4] = [
        (false, &[]),
        (true, &[]),
        (false, &[("tilt", &[0.3, 0.4])]),
        (false, &[("wall_creep", &[0.4, 1.5]), ("pressure_lag", &[])]),
    ];
    for (vertical, list) in cases {
        let list: Vec<(&str, &[f64])> = list
            .iter()
            .map(|&(id, k)| if k.is_empty() { (id, find(id).expect("known").header().starts[0]) } else { (id, k) })
            .collect();
        let settings = Settings { vertical, ..perfect() };
        let mut rig = EmulatedRig::new(&Parameters::example(), effects(&list), settings).expect("a rig");
        let rows = run(&mut rig, 0, 3000, |_| FREE).expect("rests");
        let (first, last) = (rows[0], rows[2999]);
        assert!((first.angle_deg - last.angle_deg).abs() < 1e-6, "{list:?}: {} deg", last.angle_deg - first.angle_deg);
        assert!((first.pressure1_bar - last.pressure1_bar).abs() < 1e-6, "{list:?}");
        assert!(rig.state()[state::VELOCITY].abs() < 1e-8, "{list:?}");
        assert_eq!(list.iter().any(|e| e.0 == "tilt"), first.angle_deg.abs() > 1.0, "a tilted lever hangs aside");
    }
}

#[test]
fn flows_into_the_chambers_balance_whatever_the_valves_do() {
    let k = Parameters::example().to_vector();
    let mut rig = rig(perfect());
    let rows = run(&mut rig, 0, 6000, |t| Command {
        voltage_v: if (t / 900) % 2 == 0 { 18.0 } else { -12.0 },
        brake_open: (t / 700) % 3 != 2,
        bypass_open: (t / 500) % 4 == 3,
        ..FREE
    })
    .expect("runs");
    let mut moved_ml: f64 = 0.0;
    for pair in rows.windows(2) {
        let [a, b] = pair else { unreachable!("windows of two") };
        let (from, to) = (a.angle_deg.to_radians(), b.angle_deg.to_radians());
        let middle = 0.5 * (from + to);
        let pressure = [0.5 * (a.pressure1_bar + b.pressure1_bar), 0.5 * (a.pressure2_bar + b.pressure2_bar)];
        let (c, d) = (capacity(&k, middle, pressure), displacement(&k, middle));
        let into1 = c[0] * (b.pressure1_bar - a.pressure1_bar) + d[0] * (to - from);
        let into2 = c[1] * (b.pressure2_bar - a.pressure2_bar) + d[1] * (to - from);
        assert!((into1 + into2).abs() < 2e-6, "{into1} ml into chamber 1, {into2} ml into chamber 2 in one tick");
        moved_ml += into1.abs();
    }
    assert!(moved_ml > 20.0, "nothing flowed: {moved_ml} ml");
}

#[test]
fn a_clamp_holds_the_lever_and_reads_its_torque() {
    let p = Parameters::example();
    for angle_deg in [-40.0, 0.0, 25.0] {
        let start = Command { fixture: clamped(angle_deg), ..FREE };
        let mut rig = rig(Settings { start, ..perfect() });
        let rows = run(&mut rig, 0, 4000, |_| Command { voltage_v: 2.0, ..start }).expect("runs");
        for m in &rows {
            assert_eq!(m.angle_deg, rows[0].angle_deg);
            let dp = m.pressure1_bar - m.pressure2_bar;
            let torque = (p.torque.m1 * dp.abs() + p.torque.m2) * angle_deg.to_radians() + p.torque.m3 * dp;
            assert!((m.torque_nm - torque).abs() < 1e-9);
        }
        let end = rows[3999];
        assert!(end.pressure1_bar - end.pressure2_bar > 1.0, "the pump built up no pressure");
    }
}

#[test]
fn a_moved_lever_shows_no_torque_until_it_stands() {
    let mut rig = rig(perfect());
    let fixture = clamped(10.0);
    let rows = run(&mut rig, 0, 1500, |_| Command { bypass_open: true, fixture, ..FREE }).expect("runs");
    let arrived = rows.iter().position(|m| m.torque_nm.is_finite()).expect("it arrives");
    assert!((300..900).contains(&arrived), "10 degrees at 30 degrees a second: {arrived} ticks");
    assert!(rows[..arrived].windows(2).all(|w| w[1].angle_deg >= w[0].angle_deg));
    assert!(rows[arrived..].iter().all(|m| m.torque_nm.is_finite() && (m.angle_deg - 10.0).abs() < 1e-9));
}

#[test]
fn a_sweep_with_shut_chambers_returns_to_its_pressures() {
    let fixture = Fixture::Filled { angle_deg: 12.0, pressure1_bar: 2.75, pressure2_bar: 2.75 };
    let start = Command { fixture, ..SHUT };
    let mut rig = rig(Settings { start, ..perfect() });
    let rows = run(&mut rig, 0, 9000, |k| {
        let swing = (std::f64::consts::TAU * k.min(8000) as f64 / 8000.0).sin();
        Command { fixture: Fixture::Driven { angle_deg: 12.0 + 3.0 * swing }, segment: 1, ..SHUT }
    })
    .expect("runs");
    let (first, last) = (rows[1], rows[8999]);
    let range = rows.iter().fold((9.0_f64, 0.0_f64), |r, m| (r.0.min(m.pressure1_bar), r.1.max(m.pressure1_bar)));
    assert!(range.1 - range.0 > 1.5, "no pressure swing: {range:?}");
    assert!((first.pressure1_bar - last.pressure1_bar).abs() < 1e-6);
    assert!((first.pressure2_bar - last.pressure2_bar).abs() < 1e-6);
    assert!(rows.iter().all(|m| m.torque_nm.is_nan()));
    assert!(rows[0].volume_ml.is_nan(), "no reading while filling");
    assert!(rows[1..].iter().all(|m| m.volume_ml == rows[1].volume_ml));
}

#[test]
fn the_oil_of_a_filling_follows_displacement_and_capacity() {
    let p = Parameters::example();
    let oil = |angle_deg: f64, pressure1_bar: f64| {
        let start = Command { fixture: Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar: 2.75 }, ..SHUT };
        let mut rig = rig(Settings { start, ..perfect() });
        run(&mut rig, 0, 3, |_| Command { fixture: Fixture::Driven { angle_deg }, ..SHUT }).expect("runs")[2].volume_ml
    };
    for angle_deg in [-35.0_f64, -12.0, 0.0, 24.0, 40.0] {
        let phi = angle_deg.to_radians();
        let expected = 100.0 + p.displacement.v2 * phi + 0.5 * p.displacement.v1 * phi * phi;
        assert!((oil(angle_deg, 2.75) - expected).abs() < 1e-9, "{angle_deg}: {} ml", oil(angle_deg, 2.75));
    }
    // 1 bar more at 20 degrees: the integral of eq. (13) in closed form.
    let c = p.capacity;
    let stored = |bar: f64| c.h1 * bar.powf(c.h2 + 1.0) / (c.h2 + 1.0) + c.h3 * bar;
    let expected = (-c.a1 * 20.0_f64).exp() * (stored(3.75) - stored(2.75));
    assert!((oil(20.0, 3.75) - oil(20.0, 2.75) - expected).abs() < 1e-6);
}

#[test]
fn released_oil_is_what_left_the_chamber() {
    let p = Parameters::example();
    let fill = Fixture::Filled { angle_deg: -20.0, pressure1_bar: 5.4, pressure2_bar: 2.75 };
    let released = |seed: u64, spread: f64| {
        let start = Command { fixture: fill, ..SHUT };
        let mut rig = rig(Settings { start, seed, release_spread: spread, ..perfect() });
        let rows = run(&mut rig, 0, 8000, |k| {
            let flow_ml_s = if k >= 1000 && (k - 1000) % 1000 < 300 { 3.3 } else { 0.0 };
            Command { fixture: Fixture::Released { angle_deg: -20.0, flow_ml_s }, ..SHUT }
        })
        .expect("runs");
        (1..8).map(|n| rows[n * 1000 + 900]).collect::<Vec<_>>()
    };
    let c = p.capacity;
    let stored = |bar: f64| (c.a1 * 20.0).exp() * (c.h1 * bar.powf(c.h2 + 1.0) / (c.h2 + 1.0) + c.h3 * bar);
    let mut amounts = Vec::new();
    for m in released(4, 0.1) {
        let left_ml = stored(5.4) - stored(m.pressure1_bar);
        assert!((m.volume_ml - left_ml).abs() < 1e-6, "read {} ml, {left_ml} ml left the chamber", m.volume_ml);
        assert!((m.pressure2_bar - 2.75).abs() < 1e-12, "chamber 2 is shut off");
        assert!(m.torque_nm.is_finite());
        amounts.push(m.volume_ml);
    }
    let steps: Vec<f64> = std::iter::once(amounts[0]).chain(amounts.windows(2).map(|w| w[1] - w[0])).collect();
    assert!(steps.iter().all(|s| (0.65..1.35).contains(s)), "{steps:?}");
    assert!(steps.iter().any(|s| (s - steps[0]).abs() > 0.01), "an operator's hand is no machine: {steps:?}");
    assert_ne!(steps[0], released(5, 0.1)[0].volume_ml, "the hand does not depend on the seed");
    assert!((released(4, 0.0)[0].volume_ml - 0.99).abs() < 1e-9);
}

#[test]
fn the_cylinder_is_read_while_nothing_flows_and_once_a_rest() {
    let start =
        Command { fixture: Fixture::Filled { angle_deg: 0.0, pressure1_bar: 5.0, pressure2_bar: 2.75 }, ..SHUT };
    let mut rig = rig(Settings { start, ..Settings::default() });
    let released = |flow_ml_s| Command { fixture: Fixture::Released { angle_deg: 0.0, flow_ml_s }, ..SHUT };
    let rows = run(&mut rig, 0, 900, |k| released(if (300..600).contains(&k) { 3.3 } else { 0.0 })).expect("runs");
    assert!(rows[0].volume_ml.is_nan(), "filling");
    assert!(rows[1..=300].iter().all(|m| m.volume_ml == 0.0), "nothing was released");
    assert!(rows[301..=600].iter().all(|m| m.volume_ml.is_nan()), "oil flows");
    assert!(rows[601..].iter().all(|m| m.volume_ml == rows[601].volume_ml && m.volume_ml > 0.5));
    // Through an open valve the amount is lost.
    let driven = Command { fixture: Fixture::Driven { angle_deg: 0.0 }, ..FREE };
    assert!(run(&mut rig, 900, 5, |_| driven).expect("runs")[1..].iter().all(|m| m.volume_ml.is_nan()));
}

#[test]
fn the_pump_bench_delivers_eq_10_and_reads_every_fifth_of_a_second() {
    let f = Parameters::example().pump;
    let bench = |sign: f64, load_bar: f64| {
        let (p1, p2) = if sign > 0.0 { (load_bar, 1.5) } else { (1.5, load_bar) };
        Fixture::PumpBench { pressure1_bar: p1, pressure2_bar: p2 }
    };
    let mut rig = rig(perfect());
    let mut from = 0;
    for (segment, (volts, load_bar)) in (1..).zip([(12.0, 1.5), (12.0, 4.0), (-12.0, 4.0), (24.0, 5.0), (-1.0, 4.0)]) {
        let fixture = bench(volts, load_bar);
        let rows = run(&mut rig, from, 1000, |_| Command { voltage_v: volts, fixture, segment, ..FREE }).expect("runs");
        from += 1000;
        let dp = (load_bar - 1.5) * volts.signum();
        let drive = (f.f1 * volts.abs() + f.f4 + f.f2 * volts * dp).max(0.0);
        let flow = volts.signum() * f.f3 * dp + drive;
        for (k, m) in rows.iter().enumerate().skip(1) {
            assert_eq!(m.volume_ml.is_finite(), k % 200 == 100, "tick {k} of segment {segment}");
            if k % 200 == 100 {
                assert!((m.volume_ml - flow * k as f64 * 1e-3).abs() < 1e-9, "segment {segment}: {}", m.volume_ml);
            }
            assert!(m.angle_deg.is_nan() && m.torque_nm.is_nan());
            assert!((m.pressure1_bar - m.pressure2_bar - dp).abs() < 1e-12);
        }
    }
    let idle = Command { fixture: bench(1.0, 3.0), segment: 9, ..FREE };
    assert!(run(&mut rig, from, 500, |_| idle).expect("runs")[1..].iter().all(|m| m.volume_ml.is_nan()));
    // Back in the rig, the chambers are as they were.
    let back = run(&mut rig, from + 500, 2, |_| SHUT).expect("runs")[1];
    assert!((back.pressure1_bar - 2.8).abs() < 1e-6 && back.angle_deg.abs() < 1e-6);
}

#[test]
fn sensors_have_the_noise_that_was_set() {
    let noise = Noise { angle_deg: 0.05, ..Noise::default() };
    let start = Command { fixture: clamped(7.0), ..SHUT };
    let mut rig = rig(Settings { start, noise, seed: 11, ..Settings::default() });
    let rows = run(&mut rig, 0, 40_000, |_| start).expect("runs");
    let statistics = |values: Vec<f64>| {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let lag1: f64 = values.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt(), lag1 / variance)
    };
    let step = noise.encoder_step_deg;
    let angle_std = (noise.angle_deg.powi(2) + step * step / 12.0).sqrt();
    let torque = (-4.0 * 7.0_f64.to_radians(), noise.torque_nm);
    let cases: [(&str, Channel, (f64, f64)); 4] = [
        ("angle", |m| m.angle_deg, (7.0, angle_std)),
        ("pressure 1", |m| m.pressure1_bar, (2.8, noise.pressure_bar)),
        ("pressure 2", |m| m.pressure2_bar, (2.8, noise.pressure_bar)),
        ("torque", |m| m.torque_nm, torque),
    ];
    for (channel, value, (mean, std)) in cases {
        let got = statistics(rows.iter().map(value).collect());
        assert!((got.0 - mean).abs() < 5.0 * std / 200.0, "{channel}: mean {}, expected {mean}", got.0);
        assert!((got.1 / std - 1.0).abs() < 0.03, "{channel}: deviation {}, expected {std}", got.1);
        assert!(got.2.abs() < 0.025, "{channel}: coloured, {}", got.2);
    }
    let steps = rows.iter().map(|m| m.angle_deg / step);
    assert!(steps.into_iter().all(|s| (s - s.round()).abs() < 1e-6), "the encoder shows fractions of its step");
    let both: f64 = rows.iter().map(|m| (m.pressure1_bar - 2.8) * (m.pressure2_bar - 2.8)).sum::<f64>() / 40_000.0;
    assert!((both / noise.pressure_bar.powi(2)).abs() < 0.025, "the sensors share their noise");
}

#[test]
fn sensor_effects_show_and_leave_the_plant_alone() {
    let header = find("angle_offset").expect("in the library").header();
    let k: Vec<f64> = header.parameters.iter().map(|p| p.typical).collect();
    let play = |set: EffectSet<f64>| {
        let mut rig = EmulatedRig::new(&Parameters::example(), set, perfect()).expect("a rig");
        let rows = run(&mut rig, 0, 1000, |_| Command { voltage_v: 10.0, ..FREE }).expect("runs");
        (rows[999], rig.state()[state::ANGLE])
    };
    let (plain, with) = (play(EffectSet::none()), play(effects(&[("angle_offset", &k)])));
    assert_eq!(plain.1, with.1);
    assert!((plain.0.angle_deg - with.0.angle_deg).abs() > 1e-3);
}

#[test]
fn exhausted_pressure_is_an_error_that_stays() {
    let start = Command { fixture: Fixture::Filled { angle_deg: 0.0, pressure1_bar: 2.0, pressure2_bar: 2.0 }, ..SHUT };
    let mut rig = rig(Settings { start, ..perfect() });
    let drained = Command { fixture: Fixture::Released { angle_deg: 0.0, flow_ml_s: 50.0 }, ..SHUT };
    let error = run(&mut rig, 0, 20_000, |_| drained).expect_err("the chamber runs dry");
    assert_eq!(error.device, "emulated rig");
    assert!(error.what.contains("pressure 1") && error.what.contains("bar absolute"), "{error}");
    assert_eq!(rig.read(Tick::at(error.tick + 1)), Err(error.clone()));
    assert_eq!(rig.write(Tick::at(error.tick + 1), &SHUT), Err(error));
}

#[test]
fn commands_that_no_rig_can_follow_are_refused() {
    let held = |fixture| Command { fixture, ..SHUT };
    let cases = [
        (Command { voltage_v: f64::NAN, ..FREE }, "voltage"),
        (Command { voltage_v: 24.1, ..FREE }, "+-24 V, got 24.1"),
        (held(clamped(80.0)), "got 80"),
        (held(clamped(f64::NAN)), "got NaN"),
        (held(Fixture::Filled { angle_deg: 0.0, pressure1_bar: 0.0, pressure2_bar: 2.0 }), "pressure 1"),
        (held(Fixture::Released { angle_deg: 0.0, flow_ml_s: -1.0 }), "got -1"),
        (Command { brake_open: true, ..held(Fixture::Released { angle_deg: 0.0, flow_ml_s: 1.0 }) }, "open valve"),
        (held(Fixture::PumpBench { pressure1_bar: 2.0, pressure2_bar: 99.0 }), "port 2"),
    ];
    for (command, reason) in cases {
        let mut rig = rig(perfect());
        rig.read(Tick::at(0)).expect("reads");
        let error = rig.write(Tick::at(0), &command).expect_err(reason);
        assert!(error.what.contains("expected") && error.what.contains(reason), "{error}");
        rig.write(Tick::at(0), &FREE).expect("a refused command leaves the rig usable");
        rig.read(Tick::at(1)).expect("reads on");
    }
    let mut rig = rig(perfect());
    rig.read(Tick::at(5)).expect("reads");
    rig.write(Tick::at(6), &FREE).expect("the loop's last word comes without a read before it");
    assert!(rig.write(Tick::at(5), &FREE).is_err(), "a write into the past");
    assert!(rig.read(Tick::at(4)).is_err(), "time went backwards");
}

#[test]
fn rigs_that_cannot_be_are_refused() {
    let new = |settings| EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings).map(|_| ());
    let error = new(Settings { fill_bar: 0.0, ..perfect() }).expect_err("no pressure");
    assert!(error.to_string().contains("`fill_bar`") && error.to_string().contains("got 0"), "{error}");
    assert!(new(Settings { step_s: f64::NAN, ..perfect() }).is_err());
    let start = Command { fixture: clamped(90.0), ..FREE };
    assert!(matches!(new(Settings { start, ..perfect() }), Err(EmulatedError::Start { .. })));
    let mut runaway = Parameters::example();
    runaway.torque.m2 = 4.0;
    let error = EmulatedRig::new(&runaway, EffectSet::none(), perfect()).map(|_| ()).expect_err("no spring");
    assert!(matches!(error, EmulatedError::NoEquilibrium { .. }), "{error}");
}

#[test]
fn skipped_ticks_hold_the_command() {
    let command = Command { voltage_v: 14.0, ..FREE };
    let (mut every, mut some) = (rig(perfect()), rig(perfect()));
    run(&mut every, 0, 200, |_| command).expect("runs");
    for k in (0..200).step_by(7) {
        some.read(Tick::at(k)).expect("reads");
        some.write(Tick::at(k), &command).expect("writes");
    }
    every.read(Tick::at(199)).expect("reads");
    some.read(Tick::at(199)).expect("reads");
    assert_eq!(every.state(), some.state());
}

#[test]
fn a_finer_integration_changes_a_minute_of_square_wave_by_less_than_a_millionth() {
    let play = |step_s| {
        let mut rig = rig(Settings { step_s, ..perfect() });
        run(&mut rig, 0, 60_000, |k| Command { voltage_v: if (k / 2500) % 2 == 0 { 20.0 } else { -20.0 }, ..FREE })
            .expect("runs")
    };
    let step_s = Settings::default().step_s;
    let (coarse, fine) = (play(step_s), play(step_s / 2.0));
    let largest = |value: Channel| {
        let (low, high) = fine.iter().map(value).fold((f64::MAX, f64::MIN), |r, v| (r.0.min(v), r.1.max(v)));
        let error = coarse.iter().zip(&fine).map(|(a, b)| (value(a) - value(b)).abs()).fold(0.0, f64::max);
        error / (high - low)
    };
    let channels: [Channel; 3] = [|m| m.angle_deg, |m| m.pressure1_bar, |m| m.pressure2_bar];
    for value in channels {
        assert!(largest(value) < 1e-6, "{}", largest(value));
    }
}
