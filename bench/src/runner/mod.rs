//! Runs one script after the other on a rig: the loop in real time or in lockstep, its samples over shared memory, the logger's
//! recordings, the flight recorder's incidents. A campaign and a single run are the same to it.

mod full;
mod judged;

pub use judged::{Finished, judge};

use crate::events::{aftermath, events_of, timeouts_of};
use crate::failure::{Failure, Kind};
use crate::incident::Incidents;
use crate::logger::{self, Logger};
use crate::machine;
use crate::operator::{self, Crier, People};
use crate::progress::Progress;
use crate::recorder::OnFull;
use crate::rig_file::RigRecord;
use crate::setup::{Knowledge, Setup};
use drivers::journal::{Journal, JournalReader, Occurrence, Severity};
use full::StoppedFor;
use judged::{failure_of, not_begun, of_link, rig_first, say_refusals};
use profiles::{Hands, Script};
use recordings::RunMetadata;
use rt_core::announce::Announcer;
use rt_core::system::{self, ProcessGuard, Report, Request};
use rt_core::{
    Clock, Device, FlightLog, FlightRecorder, Limits, Lockstep, Operator, Pace, Publication, RealTime, Run, Stages,
    Supervisor, Switches,
};
use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

/// Longest wait for the logger to appear, and for the samples of a run to reach it after its end.
const PATIENCE: Duration = Duration::from_secs(30);
/// Between two looks after the loop's thread, for incidents to be written while the run goes on.
const LOOK: Duration = Duration::from_millis(20);
/// The publication thread's priority lies below the loop's by this much.
const PUBLICATION_BELOW: u8 = 10;

/// Where ticks come from.
#[derive(Clone, Debug)]
pub enum Mode {
    /// Virtual time, as fast as it goes; the loop waits for the logger.
    Lockstep,
    /// The wall's time, in a thread of its own.
    RealTime {
        /// What is asked of the system.
        request: Request,
        /// What it refuses ends the command.
        required: bool,
    },
}

/// One run.
pub struct Plan<'a> {
    /// What is wanted.
    pub script: &'a Script,
    /// Seed of its random steps.
    pub seed: u64,
    /// Largest voltage of the rig, V.
    pub u_max_v: f64,
    /// For targets other than voltages.
    pub knowledge: &'a Knowledge,
    /// The file to write, `.mcap`.
    pub path: &'a Path,
    /// Noted in the recording.
    pub notes: &'a BTreeMap<String, String>,
}

/// Publication, logger, supervisor and flight recorder of an instance.
pub struct Runner {
    mode: Mode,
    supervisor: Supervisor,
    /// The rig's own; a script may narrow them for its run.
    limits: Limits,
    instance: String,
    hands: Hands,
    /// Where people's part is noted.
    people: Journal,
    // Before the publication: a logger that leaves first is not waited for.
    logger: Logger,
    stopped_for: StoppedFor,
    publication: Publication,
    flight: FlightRecorder,
    flown: FlightLog,
    system: Option<(ProcessGuard, Report)>,
    announcer: Announcer,
    journals: JournalReader,
    rig: RigRecord,
    next_run: u32,
    /// What the system refuses the loop's thread was said.
    refusals_said: bool,
}

impl Runner {
    /// Begins to publish on `instance` and starts the logger; in real time the process is prepared first, and what the system
    /// refuses is said.
    ///
    /// # Errors
    /// Limits that can't be enforced, real time that is required and refused (2), an instance in use, no shared memory (4).
    pub fn open(
        instance: &str,
        limits: Limits,
        mode: Mode,
        on_full: OnFull,
        progress: &Progress,
    ) -> Result<Self, Failure> {
        let supervisor = Supervisor::new(limits).map_err(|e| Failure::of(Kind::Input, &e))?;
        let system = match &mode {
            Mode::Lockstep => None,
            Mode::RealTime { request, .. } => Some(system::prepare_process(request)),
        };
        let link = |e| of_link(&e);
        let publication = match &mode {
            Mode::Lockstep => Publication::start(instance, Pace::LOCKSTEP),
            Mode::RealTime { request, .. } => {
                let below =
                    Request { priority: request.priority.saturating_sub(PUBLICATION_BELOW).max(1), ..request.clone() };
                Publication::start_prepared(instance, Pace::RealTime, move || {
                    // The loop's own thread asks the same and says what is refused.
                    let _ = system::prepare_thread(&below);
                })
            }
        };
        let publication = publication.map_err(link)?;
        let stopped_for = StoppedFor::default();
        let logger = Logger::start_with(instance, stopped_for.on_cut(on_full, instance, progress));
        let logger = logger.map_err(|e| failure_of(&e))?;
        publication.wait_for_loggers(1, PATIENCE).map_err(link)?;
        let announcer = Announcer::start(instance).map_err(link)?;
        let (flight, flown) = rt_core::flight::recorder();
        let mut journals = JournalReader::default();
        let runner = Runner {
            mode,
            supervisor,
            limits,
            instance: instance.to_owned(),
            hands: Hands::Rig,
            people: journals.journal(operator::SOURCE),
            logger,
            stopped_for,
            publication,
            flight,
            flown,
            system,
            announcer,
            journals,
            rig: RigRecord::default(),
            next_run: 0,
            refusals_said: false,
        };
        if let Some((_, report)) = &runner.system {
            runner.judge_system(report, progress)?;
        }
        Ok(runner)
    }

    /// Where drivers get the journals from that the recordings take their events from.
    pub fn journals(&mut self) -> &mut JournalReader {
        &mut self.journals
    }

    /// What every recording from now on keeps of the rig.
    pub fn describe(&mut self, rig: RigRecord) {
        self.rig = rig;
    }

    /// The number of the next run, which counts up from there: a campaign that is resumed numbers its runs as if it had never been interrupted.
    /// Within the life of the runner it must not go back.
    pub fn number_from(&mut self, next_run: u32) {
        self.next_run = next_run;
    }

    /// Who does the operator's part from now on. At first the rig does.
    pub fn operated_by(&mut self, hands: Hands) {
        self.hands = hands;
    }

    /// Where people do the operator's part: asks them to prepare the rig for the script's run, and waits until they confirm. To be called before the
    /// device is prepared, which arms the amplifier.
    ///
    /// # Errors
    /// A stop (130) or an emergency stop (5) before it or meanwhile, whoever prepares the rig.
    pub fn ask_to_prepare(&mut self, script: &Script, switches: &Switches, progress: &Progress) -> Result<(), Failure> {
        match self.hands {
            Hands::Rig => operator::still_wanted(script, switches),
            Hands::People => operator::ask_to_prepare(script, &self.instance, switches, &mut self.people, progress),
        }
    }

    /// Runs a script to its end and records it, with what the drivers note meanwhile.
    ///
    /// # Errors
    /// The script does not fit the rig, or wants limits wider than the rig's, or people in virtual time (2), the device failed (4), the recording could not be written (6). A trip, a stop and
    /// losses are no error here: see [`Finished::judge`].
    pub fn run(
        &mut self,
        plan: &Plan<'_>,
        device: &mut (dyn Device + Send),
        switches: &Switches,
        progress: &Progress,
    ) -> Result<Finished, Failure> {
        let context = profiles::Context { u_max_v: plan.u_max_v, seed: plan.seed, hands: self.hands };
        let mut playback = plan.script.compile(&context).map_err(|e| Failure::of(Kind::Input, &e))?;
        operator::require(plan.script, &context, false, matches!(self.mode, Mode::Lockstep))?;
        let limits = plan
            .script
            .envelope
            .narrow(&self.limits)
            .map_err(|e| Failure::new(Kind::Input, format!("{}: {e}", plan.script.name)))?;
        self.supervisor.enforce(limits).map_err(|e| Failure::of(Kind::Input, &e))?;
        let requests = playback.requests().to_vec();
        let run = Run { number: self.next_run, overrun: plan.script.overrun };
        self.next_run += 1;
        let setup = Setup::of(plan.seed, plan.u_max_v, &limits, plan.knowledge).by(self.hands);
        let mut controller = plan.knowledge.controller(plan.script.plane)?;
        let mut metadata = metadata(plan, &setup, &self.rig)?;

        let Runner {
            mode,
            supervisor,
            logger,
            stopped_for,
            publication,
            flight,
            flown,
            system,
            announcer,
            journals,
            people,
            instance,
            refusals_said,
            ..
        } = self;
        stopped_for.forget();
        let mut crier = Crier::new(&requests, instance);
        let mut noted = said_of(journals.read(), progress);
        if let Some(reader) = journals.take_telemetry() {
            logger.record_amplifier(reader).map_err(|e| failure_of(&e))?;
        }
        let mut incidents = Incidents::beside(plan.path);
        let step = progress.step(plan.script.name.as_str(), playback.ticks_bound());
        let begin = |logger: &mut Logger, metadata: RunMetadata| {
            // Recorders of other processes know what the run is before its first sample.
            announcer.announce(run.number, metadata.to_record()).map_err(|e| Failure::of(Kind::Device, &e))?;
            logger.begin(run.number, plan.path.to_owned(), metadata, step.counter()).map_err(|e| not_begun(&e))
        };
        let mut listening = switches;
        let mut people = People::new(switches, &requests, people);
        // Where nothing is asked, nothing is noted at any tick.
        let heard: &mut (dyn Operator + Send) = if requests.is_empty() { &mut listening } else { &mut people };
        let mut drive = |clock: &mut (dyn Clock + Send), publication: &mut Publication| {
            let stages = Stages {
                clock,
                device: &mut *device,
                operator: &mut *heard,
                supervisor: &mut *supervisor,
                reference: &mut playback,
                controller: &mut *controller,
                publish: publication,
                flight: &mut *flight,
            };
            let outcome = rt_core::run(stages, run);
            (outcome, clock.origin_ns())
        };
        let (outcome, origin_ns) = match mode {
            Mode::Lockstep => {
                begin(logger, metadata)?;
                drive(&mut Lockstep::default(), publication)
            }
            Mode::RealTime { request, required } => {
                let request = request.clone();
                // The thread prepares itself before the recording begins, so that the recording can say with what success.
                let (prepared, from_loop) = mpsc::channel();
                let (go, start) = mpsc::channel::<()>();
                thread::scope(|scope| {
                    // Dropped with this closure: where it ends early the thread must not wait for a word that never comes.
                    let go = go;
                    let publication = &mut *publication;
                    let body = move || {
                        let _ = prepared.send(system::prepare_thread(&request));
                        start.recv().ok().map(|()| drive(&mut RealTime::default(), publication))
                    };
                    let handle = thread::Builder::new().name("loop".to_owned()).spawn_scoped(scope, body);
                    let handle = handle.map_err(|e| {
                        Failure::new(
                            Kind::Internal,
                            format!(
                                "expected a thread for the loop, got \"{e}\"; free memory or threads (`ulimit -a`)"
                            ),
                        )
                    })?;
                    let granted = from_loop.recv().unwrap_or_default();
                    if let Some((_, report)) = system {
                        let thread_report = Report::new(granted);
                        say_refusals(&thread_report, *required, !std::mem::replace(refusals_said, true), progress)?;
                        metadata.notes.extend(report.notes());
                        metadata.notes.extend(thread_report.notes());
                    }
                    begin(logger, metadata)?;
                    // The thread waits for this; it can only be gone by a panic, which the join tells.
                    let _ = go.send(());
                    while !handle.is_finished() {
                        crier.look(switches, progress);
                        incidents.write(flown, progress);
                        noted.extend(said_of(journals.read(), progress));
                        thread::sleep(LOOK);
                    }
                    match handle.join() {
                        Ok(Some(outcome)) => Ok(outcome),
                        _ => Err(Failure::new(Kind::Internal, "the loop's thread ended by a defect; see above")),
                    }
                })?
            }
        };
        switches.confirmations.run_over();
        let settled = publication.settle(PATIENCE);
        incidents.write(flown, progress);
        noted.extend(said_of(journals.read(), progress));
        let (ticks, mut events) = aftermath(&outcome);
        events.extend(timeouts_of(&playback));
        events.extend(incidents.events());
        events.extend(events_of(&noted, origin_ns, journals.untaken()));
        // Before the recording is closed: what is refused only then ended no run.
        let stopped_for = stopped_for.reason();
        let recorded = logger.end(run.number, ticks, events);
        step.finish();
        // First what happened to the rig, then what happened to the data: a lost recording must not hide a trip or an unsafe rig.
        let recorded = match recorded {
            Ok(recorded) => recorded,
            Err(lost) => return Err(rig_first(&plan.script.name, &outcome, failure_of(&lost))),
        };
        if recorded.lost_reports > 0 {
            progress.say(&format!("{} reports of the amplifier are missing in the recording", recorded.lost_reports));
        }
        if recorded.refused.samples > 0 {
            let logger::Refused { samples, first } = &recorded.refused;
            progress.say(&format!("{samples} samples could not be recorded and are left out, the first: {first}"));
        }
        progress.result(&format!("{}: {}", plan.script.name, recorded.certificate));
        if let Err(unsettled) = settled {
            return Err(rig_first(&plan.script.name, &outcome, Failure::of(Kind::Loss, &unsettled)));
        }
        let report = outcome.map_err(|e| Failure::of(Kind::Device, &e))?;
        Ok(Finished { report, certificate: recorded.certificate, incidents: incidents.files(), stopped_for })
    }

    /// Ends publication and logger.
    pub fn finish(self) -> Result<(), Failure> {
        drop(self.logger);
        self.publication.stop().map_err(|e| Failure::of(Kind::Device, &e))
    }

    fn judge_system(&self, report: &Report, progress: &Progress) -> Result<(), Failure> {
        let Mode::RealTime { required, .. } = self.mode else { return Ok(()) };
        say_refusals(report, required, true, progress)
    }
}

fn metadata(plan: &Plan<'_>, setup: &Setup, rig: &RigRecord) -> Result<RunMetadata, Failure> {
    let Script { name, protocol, role, plane, .. } = plan.script;
    let unknown = |e: recordings::UnknownWord| Failure::of(Kind::Internal, &e);
    let mut notes = plan.notes.clone();
    notes.extend(setup.notes());
    let metadata = RunMetadata::new(
        name.clone(),
        FromStr::from_str(protocol.as_str()).map_err(unknown)?,
        FromStr::from_str(role.as_str()).map_err(unknown)?,
        FromStr::from_str(plane.as_str()).map_err(unknown)?,
    );
    let (profile, calibration) = (plan.script.text.clone(), rig.calibration.clone());
    let files = rig.files.clone().into_iter().chain(setup.files()).collect();
    let (host, program) = (machine::host(), machine::program());
    Ok(RunMetadata { profile, files, calibration, host, program, notes, ..metadata })
}

/// What drivers noted, said to whoever watches the run; what is for the record alone is not.
fn said_of(noted: Vec<Occurrence>, progress: &Progress) -> Vec<Occurrence> {
    for occurrence in noted.iter().filter(|occurrence| occurrence.severity > Severity::Info) {
        progress.say(&format!("{}: {}", occurrence.source, occurrence.text));
    }
    noted
}
