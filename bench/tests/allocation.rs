//! From its first tick to its last, the loop's thread neither allocates nor frees: for every profile and every effect of the
//! emulated rig, through trips, stops and missed deadlines.

use bench::controller::{PumpController, Settings};
use bench::emulation::rig_for;
use model::effects::LIBRARY;
use model::parameters::AddedEffect;
use model::{ModelFile, Parameters};
use profiles::{BUILTIN, Context, EXAMPLES, Plane, Script};
use rt_core::{
    Clock, Command, Controller, Demand, Device, DeviceError, Ended, Handover, Limits, Lockstep, Measurement, Operator,
    OverrunPolicy, PERIOD_NS, Pace, Publication, Publish, Reference, Run, RunReport, Sample, Stages, Step, Supervisor,
    Tick, Wake,
};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// What was allocated or freed in a thread while it was watched.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Found {
    count: u64,
    /// Stage and tick of the first.
    first: Option<(&'static str, u64)>,
}

thread_local! {
    static WATCHED: Cell<bool> = const { Cell::new(false) };
    static STAGE: Cell<(&'static str, u64)> = const { Cell::new(("before the run", 0)) };
    static FOUND: Cell<Found> = const { Cell::new(Found { count: 0, first: None }) };
}

struct Counting;

fn count() {
    if WATCHED.get() {
        let found = FOUND.get();
        FOUND.set(Found { count: found.count + 1, first: found.first.or(Some(STAGE.get())) });
    }
}

// SAFETY: every call is passed on to the system's allocator as it came; counting allocates nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A stage that says which it is while it works; what is between the stages is the loop's own.
struct Watched<T>(T);

fn within<T>(stage: &'static str, tick: u64, work: impl FnOnce() -> T) -> T {
    STAGE.set((stage, tick));
    let done = work();
    STAGE.set(("loop", tick));
    done
}

impl<T: Device> Device for Watched<T> {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        WATCHED.set(true);
        within("read", now.index, || self.0.read(now))
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        within("write", now.index, || self.0.write(now, command))
    }
}

impl<T: Reference> Reference for Watched<T> {
    fn step(&mut self, now: Tick, measured: &Measurement) -> Step {
        within("reference", now.index, || self.0.step(now, measured))
    }
}

impl<T: Controller> Controller for Watched<T> {
    fn begin_run(&mut self) {
        self.0.begin_run();
    }

    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64 {
        within("control", now.index, || self.0.control(now, measured, step))
    }
}

impl<T: Publish> Publish for Watched<T> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        within("publish", sample.tick, || self.0.publish(sample))
    }

    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        within("publish", sample.tick, || self.0.publish_patiently(sample))
    }
}

/// Virtual time in which every 500th tick takes 3.3 ms.
#[derive(Default)]
struct Stumbling {
    index: u64,
}

impl Clock for Stumbling {
    fn start(&mut self) {}

    fn wait(&mut self, index: u64) -> Wake {
        self.index = index;
        Wake { tick: Tick::at(index), woken_ns: 0, lateness_ns: 0, behind_ns: 0 }
    }

    fn now_ns(&mut self) -> u64 {
        let late_ns = if self.index % 500 == 499 { 3_300_000 } else { 0 };
        self.index * PERIOD_NS + late_ns
    }
}

/// Asks for this at this tick.
struct At(u64, Demand);

impl Operator for At {
    fn demand(&mut self, now: Tick) -> Demand {
        if now.index == self.0 { self.1 } else { Demand::None }
    }
}

/// A run of a profile on a rig, and what is different about it.
struct Flight<'a> {
    script: &'a Script,
    truth: ModelFile,
    clock: &'a mut dyn Clock,
    operator: &'a mut dyn Operator,
    overrun: OverrunPolicy,
    /// The controller allocates at this tick.
    careless_at: Option<u64>,
}

impl<'a> Flight<'a> {
    fn of(script: &'a Script, clock: &'a mut dyn Clock, operator: &'a mut dyn Operator) -> Self {
        let truth = ModelFile::plain(Parameters::example());
        Flight { script, truth, clock, operator, overrun: OverrunPolicy::Skip, careless_at: None }
    }

    fn run(self, number: u32, publication: &mut Publication) -> (RunReport, Found) {
        let Parameters { pump, .. } = self.truth.parameters;
        let vertical = self.script.plane == Plane::Vertical;
        let controller =
            PumpController::with_model(&self.truth.parameters, Settings { vertical, ..Settings::default() });
        let controller = Careless { inner: controller.expect("a controller"), at: self.careless_at };
        let context = Context { u_max_v: pump.u_max, seed: 1, hands: profiles::Hands::Rig };
        let rig = rig_for(&self.truth, self.script, 1, number as usize).expect("a rig");
        let limits = Limits { pressure_min_bar: 0.3, pressure_max_bar: 9.0, ..Limits::default() };
        // Its incidents are never taken: it has to do without its spares.
        let (mut flight, _log) = rt_core::flight::recorder();
        let mut supervisor = Supervisor::new(limits).expect("limits");
        let stages = Stages {
            clock: self.clock,
            device: &mut Watched(rig),
            operator: self.operator,
            supervisor: &mut supervisor,
            reference: &mut Watched(self.script.compile(&context).expect("compiles")),
            controller: &mut Watched(controller),
            publish: &mut Watched(Queue(publication)),
            flight: &mut flight,
        };
        FOUND.set(Found::default());
        let report = rt_core::run(stages, Run { number, overrun: self.overrun });
        WATCHED.set(false);
        (report.unwrap_or_else(|e| panic!("{}: {e}", self.script.name)), FOUND.get())
    }
}

/// The bench's controller, which one day somebody spoils.
struct Careless {
    inner: PumpController,
    at: Option<u64>,
}

impl Controller for Careless {
    fn begin_run(&mut self) {
        self.inner.begin_run();
    }

    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64 {
        if self.at == Some(now.index) {
            drop(std::hint::black_box(vec![measured.angle_deg; 3]));
        }
        self.inner.control(now, measured, step)
    }
}

struct Queue<'a>(&'a mut Publication);

impl Publish for Queue<'_> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        self.0.publish(sample)
    }

    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        self.0.publish_patiently(sample)
    }
}

fn publication(test: &str) -> Publication {
    // In real time nobody is waited for: most samples of a run in virtual time find no room, the others go through.
    Publication::start(&format!("allocation-{}-{test}", std::process::id()), Pace::RealTime).expect("shared memory")
}

fn assert_clean(found: Found, what: &str, report: &RunReport) {
    assert_eq!(found, Found::default(), "{what}: stage and tick of the first; {report}");
}

fn script(name: &str) -> Script {
    let (file, text) = BUILTIN.iter().find(|(file, _)| *file == name).expect("a built-in script");
    Script::parse(text, file).expect("parses")
}

/// Ticks that each profile runs at least; a shorter one runs again.
const TICKS: u64 = 10_000;

#[test]
fn no_tick_of_any_profile_allocates() {
    let mut publication = publication("profiles");
    let mut run = 0;
    let mut not_taken = 0;
    for (file, text) in BUILTIN.iter().chain(EXAMPLES) {
        let script = Script::parse(text, file).expect("parses");
        let mut ticks = 0;
        while ticks < TICKS {
            let (report, found) = Flight::of(&script, &mut Lockstep::default(), &mut ()).run(run, &mut publication);
            assert_clean(found, file, &report);
            assert_eq!(report.ended, Ended::Completed, "{file}: {report}");
            ticks += report.statistics.ticks;
            not_taken += report.statistics.not_taken;
            run += 1;
        }
    }
    let settled = publication.settle(std::time::Duration::from_secs(30)).expect("publishes");
    assert!(settled.published > u64::from(run) && not_taken > 0, "{settled:?}: both ways of a hand-over were gone");
}

#[test]
fn no_effect_of_the_emulated_rig_allocates() {
    let mut publication = publication("effects");
    let script = script("square_h.toml");
    for (run, effect) in LIBRARY.iter().enumerate() {
        let header = effect.header();
        let parameters = header.parameters.iter().map(|p| (p.name.to_owned(), p.typical)).collect();
        let mut ticks = 0;
        while ticks < TICKS {
            let (mut clock, mut nobody) = (Lockstep::default(), ());
            let mut flight = Flight::of(&script, &mut clock, &mut nobody);
            flight.truth.effect.push(AddedEffect { id: header.id.to_owned(), parameters: Clone::clone(&parameters) });
            let (report, found) = flight.run(run as u32, &mut publication);
            assert_clean(found, header.id, &report);
            ticks += report.statistics.ticks;
            if report.ended != Ended::Completed {
                break;
            }
        }
        assert!(ticks > 1000, "{}", header.id);
    }
}

#[test]
fn neither_trips_nor_stops_nor_missed_deadlines_allocate() {
    let mut publication = publication("exceptions");
    let script = script("square_h.toml");
    for (demand, ended) in [(Demand::EmergencyStop, Ended::Tripped), (Demand::Stop, Ended::Stopped)] {
        let (mut clock, mut people) = (Lockstep::default(), At(5_000, demand));
        let (report, found) = Flight::of(&script, &mut clock, &mut people).run(0, &mut publication);
        assert_clean(found, "demand", &report);
        assert_eq!(report.ended, ended);
    }
    for (overrun, ended) in [
        (OverrunPolicy::Skip, Ended::Completed),
        (OverrunPolicy::CatchUp, Ended::Completed),
        (OverrunPolicy::SafeState, Ended::Tripped),
        (OverrunPolicy::Abort, Ended::Aborted),
    ] {
        let (mut clock, mut nobody) = (Stumbling::default(), ());
        let flight = Flight { overrun, ..Flight::of(&script, &mut clock, &mut nobody) };
        let (report, found) = flight.run(1, &mut publication);
        assert_clean(found, overrun.as_str(), &report);
        assert_eq!(report.ended, ended, "{overrun}");
        let statistics = report.statistics;
        assert!(statistics.overruns > 0, "{overrun}");
        let many = ended == Ended::Completed;
        assert_eq!(statistics.incidents_dropped > 0, many, "{overrun}: spares of the recorder ran out as well");
    }
}

#[test]
fn one_allocation_in_one_tick_is_found_with_its_stage() {
    let script = script("square_h.toml");
    let (mut clock, mut nobody) = (Lockstep::default(), ());
    let flight = Flight { careless_at: Some(7_000), ..Flight::of(&script, &mut clock, &mut nobody) };
    let (_, found) = flight.run(0, &mut publication("careless"));
    assert_eq!(found, Found { count: 2, first: Some(("control", 7_000)) }, "allocated and freed");
}
