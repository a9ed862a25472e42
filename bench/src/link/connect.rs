//! The other end: puts what comes from the rig's machine into this machine's shared memory, under an instance's name of its own, and
//! passes this machine's commands to the rig's end.

use super::line::{Incoming, Line};
use super::message::{Asked, Said};
use super::passage::{Crossed, Passage};
use super::{State, VERSION, broken, key};
use crate::failure::{Failure, Kind};
use crate::over::{OverAtEnd, keep_open};
use recordings::carried;
use rt_core::announce::Announcer;
use rt_core::{Answer, CommandServer, LinkError, Relay, RunCommand, Sample};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel, sync_channel};
use std::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::qos::Priority;

/// Messages that may wait until this end has done what takes longer; more are dropped, and show as a gap.
const WAITING: usize = 1024;
/// Between two looks at the clock.
const LOOK: Duration = Duration::from_millis(100);
/// Without any sign of life for so long, that is said.
const QUIET: Duration = Duration::from_secs(1);
/// Without any for so long, nothing is published here any more: a recording of this machine is closed with what it has. A line that is opened anew takes
/// a second where its first packet is lost: a cut of two seconds and some losses behind it are not the end.
const GONE: Duration = Duration::from_secs(8);
/// A query for what a run is takes so long at most; its samples wait meanwhile.
const SETUP_PATIENCE: Duration = Duration::from_secs(3);
/// The answer to a command; `bench stop` waits for 3 s.
const COMMAND_PATIENCE: Duration = Duration::from_millis(2800);
/// Gaps are told no more often than this.
const TELL_EVERY: Duration = Duration::from_secs(1);

/// What this end is to do.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Address of the rig's end: [`super::endpoint`].
    pub address: String,
    /// Instance over there.
    pub remote: String,
    /// Instance here.
    pub instance: String,
}

/// Carries until `end` is set.
///
/// # Errors
/// Another service has the instance's name here; what comes is of another build (4).
pub fn connect(settings: &Settings, end: &AtomicBool, say: &(dyn Fn(&str) + Sync)) -> Result<(), Failure> {
    let link = |e: LinkError| Failure::of(Kind::Device, &e);
    // Whether the name is free shows now, and not when the rig begins.
    let relay = Relay::open(&settings.instance).map_err(link)?;
    let announcer = Announcer::start(&settings.instance).map_err(link)?;
    let (sender, incoming) = sync_channel(WAITING);
    let line = Line::open(&settings.address, &settings.remote, sender)?;
    say(&format!(
        "waiting for {} ({:?}); it is instance {:?} here",
        settings.address, settings.remote, settings.instance
    ));

    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let _over = OverAtEnd(&over);
        scope.spawn(|| pass_commands(settings, &line, &over, say));
        let (relay, now) = (Some(relay), Instant::now());
        let mut arrival = Arrival {
            settings,
            line: &line,
            say,
            relay,
            announcer,
            passage: Passage::default(),
            run: None,
            heard: None,
            quiet: false,
            lost: 0,
            told: now,
        };
        arrival.follow(&incoming, end)
    })?;
    line.close()
}

/// What arrives, and what became of it.
struct Arrival<'a> {
    settings: &'a Settings,
    line: &'a Line<'a>,
    say: &'a (dyn Fn(&str) + Sync),
    /// `None`: nothing comes, and nobody publishes here.
    relay: Option<Relay>,
    announcer: Announcer,
    passage: Passage,
    /// The number of the newest run that was published here.
    run: Option<u32>,
    /// When the last sign of life came.
    heard: Option<Instant>,
    quiet: bool,
    /// Samples in gaps that were not told yet.
    lost: u64,
    told: Instant,
}

impl Arrival<'_> {
    fn follow(&mut self, incoming: &Receiver<Incoming>, end: &AtomicBool) -> Result<(), Failure> {
        while !end.load(Ordering::Relaxed) {
            match incoming.recv_timeout(LOOK) {
                Ok(Incoming::Samples(bytes)) => {
                    self.alive()?;
                    let samples = carried(&bytes.to_bytes()).map_err(|e| Failure::of(Kind::Device, &e))?;
                    self.take(&samples)?;
                }
                Ok(Incoming::State(bytes)) => {
                    let first = self.heard.is_none();
                    self.alive()?;
                    self.state(&bytes.to_bytes(), first)?;
                }
                Err(RecvTimeoutError::Timeout) => self.silence()?,
                Err(RecvTimeoutError::Disconnected) => return Err(broken("receiving", &"the session has ended")),
            }
            self.tell();
        }
        self.certify();
        Ok(())
    }

    fn state(&self, text: &[u8], first: bool) -> Result<(), Failure> {
        let state: State = serde_json::from_slice(text).map_err(|error| {
            let message =
                format!("{}: expected the sign of life of `bench link serve`, got \"{error}\"", self.settings.address);
            Failure::new(Kind::Device, message)
        })?;
        if state.version != VERSION {
            let message = format!(
                "{}: expected a link of version {VERSION}, got {}; use programs of one build at both ends",
                self.settings.address, state.version
            );
            return Err(Failure::new(Kind::Device, message));
        }
        if first {
            let control = if state.control { "with commands" } else { "read-only" };
            (self.say)(&format!("{} answers, {control}", self.settings.address));
        }
        Ok(())
    }

    /// Something came.
    fn alive(&mut self) -> Result<(), Failure> {
        let silent = self.heard.replace(Instant::now()).map(|at| at.elapsed());
        if std::mem::take(&mut self.quiet) {
            let silent_s = silent.unwrap_or_default().as_secs_f64();
            (self.say)(&format!("{} answers again after {silent_s:.1} s", self.settings.address));
        }
        if self.relay.is_none() {
            self.relay = Some(self.open()?);
        }
        Ok(())
    }

    fn open(&self) -> Result<Relay, Failure> {
        Relay::open(&self.settings.instance).map_err(|e| Failure::of(Kind::Device, &e))
    }

    fn take(&mut self, samples: &[Sample]) -> Result<(), Failure> {
        let mut fresh = Vec::with_capacity(samples.len());
        for sample in samples {
            match self.passage.take(sample) {
                Crossed::Late => continue,
                Crossed::Follows(lost) => self.lost += lost,
                Crossed::Begins => {
                    self.publish(&mut fresh)?;
                    self.begin(sample)?;
                }
            }
            fresh.push(*sample);
        }
        self.publish(&mut fresh)?;
        self.certify();
        Ok(())
    }

    fn publish(&self, fresh: &mut Vec<Sample>) -> Result<(), Failure> {
        if let Some(relay) = self.relay.as_ref().filter(|_| !fresh.is_empty()) {
            relay.send(fresh).map_err(|e| Failure::of(Kind::Device, &e))?;
        }
        fresh.clear();
        Ok(())
    }

    /// A run begins here: who records it must know what it is before its first sample.
    fn begin(&mut self, first: &Sample) -> Result<(), Failure> {
        self.certify();
        if self.run.is_some_and(|newest| newest >= first.run) {
            // Numbers that go back are another service's: so is the publication then.
            self.relay = None;
            self.relay = Some(self.open()?);
        }
        self.run = Some(first.run);
        let before = if first.sequence() > 0 {
            format!(", its first {} samples did not cross", first.sequence())
        } else {
            String::new()
        };
        match self.setup(first.run)? {
            Some(setup) => {
                self.announcer.announce(first.run, setup).map_err(|e| Failure::of(Kind::Device, &e))?;
                (self.say)(&format!("run {} begins{before}", first.run));
            }
            None => (self.say)(&format!("run {} begins{before}; nobody says what it is", first.run)),
        }
        Ok(())
    }

    /// What the run is, in the rig's own words.
    fn setup(&self, run: u32) -> Result<Option<Vec<u8>>, Failure> {
        let selector = format!("{}?run={run}", key(&self.settings.remote, "setup"));
        let replies = self
            .line
            .session()
            .get(selector)
            .timeout(SETUP_PATIENCE)
            .wait()
            .map_err(|e| broken("asking for a setup", &e))?;
        while let Ok(reply) = replies.recv() {
            if let Ok(sample) = reply.result() {
                return Ok(Some(sample.payload().to_bytes().into_owned()));
            }
        }
        Ok(None)
    }

    /// Says what was lost.
    fn tell(&mut self) {
        if self.lost > 0 && self.told.elapsed() >= TELL_EVERY {
            (self.say)(&format!("{} samples did not cross; who records here sees the gap", self.lost));
            self.lost = 0;
            self.told = Instant::now();
        }
    }

    /// Nothing waits to be taken: sees whether anybody is there, and says it.
    fn silence(&mut self) -> Result<(), Failure> {
        self.line.keep(self.heard)?;
        let Some(silent) = self.heard.map(|at| at.elapsed()) else { return Ok(()) };
        if silent >= QUIET && !self.quiet {
            self.quiet = true;
            (self.say)(&format!("no sign of life from {} for {:.1} s", self.settings.address, silent.as_secs_f64()));
        }
        if silent >= GONE && self.relay.is_some() {
            self.relay = None;
            self.passage.cut();
            (self.say)(&format!(
                "{} is gone: instance {:?} ends here until it is back; what the rig does is not known",
                self.settings.address, self.settings.instance
            ));
            self.certify();
        }
        Ok(())
    }

    /// Says of each run that has ended how much of it crossed.
    fn certify(&mut self) {
        while let Some(certificate) = self.passage.certificate() {
            (self.say)(&format!("run {} has crossed: {certificate}", certificate.run));
            self.lost = 0;
        }
    }
}

/// Passes this machine's commands on until it is over.
fn pass_commands(settings: &Settings, line: &Line, over: &AtomicBool, say: &(dyn Fn(&str) + Sync)) {
    let pass = |server: &mut CommandServer| {
        server.pass_on(Duration::from_millis(50), &mut |command| ask(settings, line, command))
    };
    let trouble = |error: &LinkError| say(&format!("commands of this machine can't cross, it is tried again: {error}"));
    keep_open(over, || CommandServer::open(&settings.instance), pass, trouble);
}

/// Asks the rig's end without waiting for its answer: an emergency stop may be the next command. The sender is dropped without one where none comes.
fn ask(settings: &Settings, line: &Line, command: RunCommand) -> Receiver<Answer> {
    let (answer, answers) = channel();
    let Ok(text) = serde_json::to_vec(&Asked::from(command)) else { return answers };
    let session = line.session();
    let query = session.get(key(&settings.remote, "command")).payload(text).priority(Priority::RealTime);
    let query = query.timeout(COMMAND_PATIENCE).callback(move |reply| match reply.result() {
        // The first answer counts; who asked is gone after it.
        Ok(sample) => drop(Said::parse(&sample.payload().to_bytes()).map(|said| answer.send(said))),
        Err(error) => {
            tracing::warn!(answer = %String::from_utf8_lossy(&error.payload().to_bytes()), "command refused")
        }
    });
    if let Err(error) = query.wait() {
        tracing::warn!(%error, "a command can't be sent");
    }
    answers
}
