//! The plant between two SYNCs, in virtual time.

use super::rig::{FREE, MS, in_process, plant, preparation};
use drivers::EmulatedRig;
use drivers::nodes::exchange::{Answer, Counter, News, Sync};
use drivers::nodes::plant::Plant;
use drivers::wired::Preparation;
use proptest::prelude::*;
use rt_core::{Command, Device, Fixture, Input, Measurement, Tick};

const MODULUS: u64 = 1 << 16;

pub fn sync(counter: u64, running: bool, preparation: Preparation) -> Sync {
    counted(counter, MODULUS, running, preparation)
}

fn counted(counter: u64, modulus: u64, running: bool, preparation: Preparation) -> Sync {
    Sync { counter: Some(Counter { value: counter % modulus, modulus }), running, preparation }
}

/// A bench: its clock, and what it says.
pub struct Bench {
    pub plant: Plant,
    pub now_ns: u64,
    pub preparation: Preparation,
    /// Of its counter.
    modulus: u64,
}

impl Bench {
    /// One that has said nothing yet.
    fn silent(preparation: Preparation, modulus: u64) -> Bench {
        Bench { plant: plant(), now_ns: 1_000_000_007, preparation, modulus }
    }

    /// One whose rig is prepared.
    pub fn prepared(preparation: Preparation) -> Bench {
        Bench::prepared_counting(preparation, MODULUS)
    }

    fn prepared_counting(preparation: Preparation, modulus: u64) -> Bench {
        let mut bench = Bench::silent(preparation, modulus);
        for counter in 0..5 {
            bench.stand(modulus / 2 + counter);
            bench.now_ns += MS;
        }
        bench
    }

    pub fn stand(&mut self, counter: u64) -> Answer {
        let sync = counted(counter, self.modulus, false, self.preparation);
        self.plant.sync(&sync, self.now_ns, self.now_ns)
    }

    pub fn run(&mut self, counter: u64, command: Command) -> Answer {
        let said = Preparation { start: command, ..self.preparation };
        let sync = counted(counter, self.modulus, true, said);
        self.plant.sync(&sync, self.now_ns, self.now_ns)
    }

    /// A tick: SYNC, the command of the amplifier so long after it, the rest of the millisecond.
    pub fn tick(&mut self, counter: u64, command: Command, after_ns: u64) -> Answer {
        let answer = self.run(counter, command);
        self.plant.amplifier(command.voltage_v, self.now_ns + after_ns);
        self.now_ns += MS;
        answer
    }

    pub fn news(&mut self) -> Vec<News> {
        self.plant.news().collect()
    }
}

/// Bit for bit, NaN too.
pub fn same(a: &Measurement, b: &Measurement) -> bool {
    let bits = |m: &Measurement| Input::ALL.map(|input| m.value(input).to_bits());
    bits(a) == bits(b) && a.faulty == b.faulty
}

/// What the loop reads in process at these ticks with these commands.
pub fn read(rig: &mut EmulatedRig, commands: &[(u64, Command)]) -> Vec<Measurement> {
    let one = |&(tick, command): &(u64, Command)| {
        let measured = rig.read(Tick::at(tick)).unwrap();
        rig.write(Tick::at(tick), &command).unwrap();
        measured
    };
    commands.iter().map(one).collect()
}

fn any_command() -> impl Strategy<Value = Command> {
    let fixture = prop_oneof![
        4 => Just(Fixture::Free),
        1 => (-30.0..30.0).prop_map(|angle_deg| Fixture::Clamped { angle_deg }),
        1 => (-30.0..30.0).prop_map(|angle_deg| Fixture::Driven { angle_deg }),
        1 => (-30.0..30.0, 1.5..3.5, 1.5..3.5)
            .prop_map(|(angle_deg, pressure1_bar, pressure2_bar)| Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar }),
        1 => (1.5..3.5, 1.5..3.5).prop_map(|(pressure1_bar, pressure2_bar)| Fixture::PumpBench { pressure1_bar, pressure2_bar }),
    ];
    (-12.0..12.0, any::<bool>(), any::<bool>(), fixture, 0u32..3).prop_map(
        |(voltage_v, brake_open, bypass_open, fixture, segment)| Command {
            voltage_v,
            brake_open,
            bypass_open,
            fixture,
            segment,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    /// Whatever is commanded for how long, whichever ticks are passed over, and whenever within its half tick the amplifier hears.
    #[test]
    fn syncs_give_what_the_rig_gives_in_process(
        commands in prop::collection::vec((any_command(), 1u64..40, 0i64..=1), 1..12),
        jumps in prop::collection::vec(1u64..4, 12),
        offsets_us in prop::collection::vec(-499i64..=500, 12),
        run in any::<u8>(),
    ) {
        let preparation = preparation(run, FREE);
        let mut bench = Bench::prepared(preparation);
        let mut rig = in_process(&preparation);
        let (mut tick, mut next) = (0, 0);
        let mut told = vec![];
        for (command, times, _) in &commands {
            for _ in 0..*times {
                told.push((tick, *command));
                tick += jumps[next % jumps.len()];
                next += 1;
            }
        }
        let expected = read(&mut rig, &told);
        let begun_ns = bench.now_ns;
        for (n, ((tick, command), expected)) in told.iter().zip(&expected).enumerate() {
            bench.now_ns = begun_ns + tick * MS;
            // An amplifier that is faster than the bus hears before the SYNC.
            let offset_ns = offsets_us[n % offsets_us.len()] * 1000;
            let at_ns = bench.now_ns.saturating_add_signed(offset_ns);
            if offset_ns < 0 {
                bench.plant.amplifier(command.voltage_v, at_ns);
            }
            let answer = bench.run(*tick, *command);
            prop_assert!(same(&answer.measurement, expected), "tick {tick}: {answer:?}, in process {expected:?}");
            prop_assert_eq!(answer.counter, tick % MODULUS);
            prop_assert!(!answer.timed_out);
            if offset_ns >= 0 {
                bench.plant.amplifier(command.voltage_v, at_ns);
            }
        }
        prop_assert_eq!(bench.plant.tick(), told[told.len() - 1].0);
        let counted = bench.plant.counted();
        prop_assert_eq!((counted.timeouts, counted.repeated, counted.preparations), (0, 0, 1));
        // Every gap of a tick is one that was passed over.
        let passed_over: u64 = told.windows(2).map(|pair| pair[1].0 - pair[0].0 - 1).sum();
        prop_assert_eq!(counted.passed_over, passed_over);
        prop_assert_eq!(counted.late, 0);
    }

    /// Whatever comes in whatever order, the plant never goes back, and every answer says what was asked.
    #[test]
    fn nothing_that_comes_stops_it(
        events in prop::collection::vec((0u8..4, any::<u64>(), any_command(), any::<bool>(), 0u64..80_000), 1..200),
    ) {
        let mut bench = Bench::prepared(preparation(1, FREE));
        let mut preparations = bench.plant.counted().preparations;
        let mut tick = bench.plant.tick();
        for (kind, counter, command, running, step_us) in events {
            bench.now_ns += step_us * 1000;
            match kind {
                0 => {
                    let counter = counter % 400;
                    let answer = if running { bench.run(counter, command) } else { bench.stand(counter) };
                    prop_assert_eq!(answer.counter, counter);
                }
                1 => bench.plant.amplifier(command.voltage_v * 10.0, bench.now_ns),
                2 => bench.plant.amplifier(f64::NAN, bench.now_ns),
                _ => bench.plant.poll(bench.now_ns),
            }
            let counted = bench.plant.counted();
            prop_assert!(counted.preparations > preparations || bench.plant.tick() >= tick);
            (preparations, tick) = (counted.preparations, bench.plant.tick());
            prop_assert!(bench.plant.answer().measurement.pressure1_bar.is_finite());
        }
    }
}

pub fn at(voltage_v: f64) -> Command {
    Command { voltage_v, ..FREE }
}

#[test]
fn a_command_that_comes_too_late_acts_a_tick_later() {
    let voltages = [0.0, 8.0, -3.0, 5.0, 5.0, -11.0, 0.0, 2.0];
    let preparation = preparation(7, FREE);
    let mut bench = Bench::prepared(preparation);
    let begun_ns = bench.now_ns;
    let mut answers = vec![];
    for tick in 0..200u64 {
        bench.now_ns = begun_ns + tick * MS;
        let command = at(voltages[tick as usize / 5 % voltages.len()]);
        answers.push(bench.run(tick, command));
        bench.plant.amplifier(command.voltage_v, bench.now_ns + 500_001);
    }
    // The same a tick later, and 0 V before.
    let shifted = |tick: u64| at(if tick == 0 { 0.0 } else { voltages[(tick - 1) as usize / 5 % voltages.len()] });
    let told: Vec<(u64, Command)> = (0..200).map(|tick| (tick, shifted(tick))).collect();
    let expected = read(&mut in_process(&preparation), &told);
    for (tick, (answer, expected)) in answers.iter().zip(&expected).enumerate() {
        assert!(same(&answer.measurement, expected), "tick {tick}");
    }
    // Those in time would have given something else.
    let in_time: Vec<(u64, Command)> =
        (0..200).map(|tick| (tick, at(voltages[tick as usize / 5 % voltages.len()]))).collect();
    let other = read(&mut in_process(&preparation), &in_time);
    assert!(answers.iter().zip(&other).any(|(answer, other)| !same(&answer.measurement, other)));
}

#[test]
fn a_tick_without_a_command_of_the_amplifier_is_counted_and_the_voltage_stays() {
    let mut bench = Bench::prepared(preparation(1, FREE));
    for tick in 0..10 {
        bench.tick(tick, at(6.0), 100_000);
    }
    for tick in 10..13 {
        bench.run(tick, at(1.0));
        bench.now_ns += MS;
    }
    bench.tick(13, at(6.0), 100_000);
    bench.tick(14, at(6.0), 100_000);
    assert_eq!(bench.plant.counted().late, 3);
    assert_eq!(bench.plant.pump().voltage_v, 6.0);
}

/// Lost frames at a run's beginning, the counter's end, and a frame that comes twice or after the next one.
#[test]
fn counters_begin_late_wrap_stand_and_go_back() {
    let start = Command { brake_open: false, bypass_open: false, ..FREE };
    let preparation = preparation(3, start);
    // One that ends soon: no frame of it may be far ahead of the time that passed.
    let modulus = 100;
    let mut bench = Bench::prepared_counting(preparation, modulus);
    let mut rig = in_process(&preparation);
    rig.read(Tick::at(0)).unwrap();
    // The first two are lost: until then the start is in force.
    let answer = bench.tick(2, at(9.0), 0);
    assert!(same(&answer.measurement, &rig.read(Tick::at(2)).unwrap()));
    rig.write(Tick::at(2), &at(9.0)).unwrap();

    let far = modulus / 2 - 10;
    let answer = bench.tick(far, at(9.0), 0);
    assert!(same(&answer.measurement, &rig.read(Tick::at(far)).unwrap()));
    rig.write(Tick::at(far), &at(9.0)).unwrap();
    let again = bench.run(far, at(-9.0));
    assert!(same(&again.measurement, &answer.measurement) && again.counter == far);
    // Swapped: the later one first.
    let answer = bench.tick(far + 2, at(9.0), 0);
    assert!(same(&answer.measurement, &rig.read(Tick::at(far + 2)).unwrap()));
    rig.write(Tick::at(far + 2), &at(9.0)).unwrap();
    let behind = bench.run(far + 1, at(-9.0));
    assert!(same(&behind.measurement, &answer.measurement) && behind.counter == far + 1);

    bench.tick(80, at(9.0), 0);
    rig.read(Tick::at(80)).unwrap();
    rig.write(Tick::at(80), &at(9.0)).unwrap();
    let wrapped = modulus + 5;
    let answer = bench.tick(wrapped, at(9.0), 0);
    assert_eq!((answer.counter, bench.plant.tick()), (5, wrapped));
    assert!(same(&answer.measurement, &rig.read(Tick::at(wrapped)).unwrap()));
    assert_eq!(bench.plant.counted().repeated, 2);
}

/// Where the rig file maps no `running` every frame is one of a run: also those that prepare the next, whose counter begins elsewhere.
#[test]
fn a_counter_that_begins_anew_moves_the_plant_by_the_time_that_passed() {
    let mut bench = Bench::silent(preparation(1, FREE), MODULUS);
    let mut tick = 0;
    for begins in [MODULUS / 2, 0, MODULUS / 2, 0] {
        for counter in begins..begins + 9 {
            bench.tick(counter, at(6.0), 0);
            assert_eq!(bench.plant.tick(), tick, "counter {counter}");
            tick += 1;
        }
    }
    let counted = bench.plant.counted();
    assert_eq!((counted.passed_over, counted.repeated, counted.timeouts), (0, 0, 0));
}

#[test]
fn every_preparation_is_a_new_rig_at_tick_0() {
    let clamped = Command { fixture: Fixture::Clamped { angle_deg: 12.0 }, brake_open: false, ..FREE };
    let first = preparation(1, FREE);
    let mut bench = Bench::prepared(first);
    let expected = in_process(&first).read(Tick::at(0)).unwrap();
    // Asked again and again, the state is measured once.
    for counter in 100..110 {
        assert!(same(&bench.stand(counter).measurement, &expected));
    }
    // The operator changes his mind before the run.
    bench.preparation.start = clamped;
    bench.preparation.fill_bar = 3.1;
    bench.preparation.vertical = true;
    let asked = bench.preparation;
    assert!(same(&bench.stand(110).measurement, &in_process(&asked).read(Tick::at(0)).unwrap()));
    let answer = bench.tick(0, Command { voltage_v: 3.0, ..clamped }, 0);
    assert!(same(&answer.measurement, &in_process(&asked).read(Tick::at(0)).unwrap()));
    for tick in 1..50 {
        bench.tick(tick, FREE, 0);
    }
    assert_eq!(bench.plant.tick(), 49);
    // A single frame without `running` is a fault of the wire, three are the end of the run.
    assert_eq!((bench.stand(50).counter, bench.plant.tick()), (50, 49));
    bench.tick(51, FREE, 0);
    assert_eq!(bench.plant.tick(), 51);
    bench.preparation.start = FREE;
    for counter in [1, 2] {
        bench.stand(MODULUS / 2 + counter);
        assert_eq!(bench.plant.tick(), 51);
    }
    bench.stand(MODULUS / 2 + 3);
    assert_eq!(bench.plant.tick(), 0);
    bench.tick(0, FREE, 0);
    bench.tick(1, FREE, 0);
    // Another run is prepared at once, and its noise is its own.
    bench.preparation.run = 2;
    let answer = bench.stand(MODULUS / 2);
    assert!(same(&answer.measurement, &in_process(&bench.preparation).read(Tick::at(0)).unwrap()));
    assert!(!same(&answer.measurement, &expected));
    assert_eq!(bench.plant.counted().preparations, 4);
}

#[test]
fn what_no_rig_could_be_told_is_refused_and_the_rest_is_obeyed() {
    let mut bench = Bench::prepared(preparation(1, FREE));
    bench.tick(0, at(2.0), 0);
    bench.news();
    // Oil can't be released through open valves, and no lever is held at 300 degrees.
    for (tick, fixture) in [
        (10, Fixture::Released { angle_deg: 0.0, flow_ml_s: 1.0 }),
        (20, Fixture::Clamped { angle_deg: 300.0 }),
        (30, Fixture::Clamped { angle_deg: f64::NAN }),
    ] {
        bench.tick(tick, Command { fixture, ..at(-4.0) }, 0);
        bench.tick(tick + 1, at(-4.0), 0);
        let news = bench.news();
        assert!(matches!(&news[..], [News::Refused(what)] if what.contains("expected")), "{news:?}");
        assert_eq!(bench.plant.pump().voltage_v, -4.0);
    }
    assert_eq!(bench.plant.counted().refused, 3);
    // A rig that can't be made: the one before stays, and is told of.
    bench.preparation = Preparation { fill_bar: 100.0, run: 2, ..bench.preparation };
    bench.stand(MODULUS / 2);
    assert!(matches!(&bench.news()[..], [News::Refused(what)] if what.contains("fill_bar")));
    assert_eq!(bench.plant.counted().preparations, 1);
}

#[test]
fn stuck_valves_stay_as_they_are() {
    let mut bench = Bench::prepared(preparation(1, FREE));
    bench.tick(0, FREE, 0);
    bench.plant.stick_valves(true);
    let answer = bench.tick(1, Command { brake_open: false, bypass_open: true, ..FREE }, 0);
    assert_eq!((answer.brake_is_open, answer.bypass_is_open), (true, false));
    bench.now_ns += 60 * MS;
    bench.plant.poll(bench.now_ns);
    assert!(bench.plant.answer().timed_out && bench.plant.answer().brake_is_open);
    bench.plant.stick_valves(false);
    let answer = bench.tick(70, Command { brake_open: false, bypass_open: true, ..FREE }, 0);
    assert_eq!((answer.brake_is_open, answer.bypass_is_open), (false, true));
}

#[test]
fn without_a_counter_every_frame_is_the_time_that_passed() {
    let mut bench = Bench::prepared(preparation(1, FREE));
    let said = |running| Sync { counter: None, running, preparation: preparation(1, FREE) };
    for (after_ms, tick) in [(1, 0), (1, 1), (1, 2), (4, 6), (0, 7)] {
        bench.now_ns += after_ms * MS;
        bench.plant.sync(&said(true), bench.now_ns, bench.now_ns);
        assert_eq!(bench.plant.tick(), tick);
    }
}
