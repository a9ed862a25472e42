//! The people at the rig: what the run asks them for, who hears it, and what the recording keeps of it.
//!
//! A request is said on the terminal and by the command channel ([`open_request`]); a confirmation comes from the terminal
//! ([`crate::keyboard`]) or from another process (`bench confirm`). The loop takes or refuses it, see [`rt_core::confirmation`].

use crate::failure::{Failure, Kind};
use crate::keyboard;
use crate::progress::Progress;
use drivers::journal::{Journal, Severity, When};
use profiles::{Context, Hands, Request, Script};
use rt_core::system::time::monotonic_ns;
use rt_core::{Amount, Confirmation, Demand, Measurement, Operator, Switches, Tick, Waiting};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

/// Source of their events in a recording.
pub const SOURCE: &str = "operator";

/// Number of the request to prepare the rig, which comes before the run's own.
pub const PREPARATION: u32 = u32::MAX;

/// Between two looks after people who prepare a rig.
const LOOK: Duration = Duration::from_millis(20);

/// What is asked for now, in words. A process drives one rig at a time, as its switches are one set.
static OPEN: Mutex<String> = Mutex::new(String::new());

/// What the run of this process asks for now; empty where nothing is asked.
pub fn open_request() -> String {
    OPEN.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).clone()
}

fn set_open(text: &str) {
    text.clone_into(&mut OPEN.lock().unwrap_or_else(|poisoned| poisoned.into_inner()));
}

/// What the loop hears of people, with a note of each request and its confirmation for the recording.
pub struct People<'a> {
    switches: &'a Switches,
    requests: &'a [Request],
    journal: &'a mut Journal,
    /// The open request, and the tick at which it was first asked.
    open: Option<(Waiting, Tick)>,
    last: Tick,
}

impl<'a> People<'a> {
    /// Of a run with these requests.
    pub fn new(switches: &'a Switches, requests: &'a [Request], journal: &'a mut Journal) -> Self {
        People { switches, requests, journal, open: None, last: Tick::at(0) }
    }

    fn note(&mut self, tick: Tick, text: std::fmt::Arguments<'_>) {
        self.journal.note(When::Tick(tick.index), Severity::Info, text);
    }

    /// Something else is asked for than at the tick before, or nothing.
    fn turn(&mut self, waiting: Option<Waiting>) {
        // It was asked by the step of the last tick.
        let last = self.last;
        self.open = waiting.map(|waiting| (waiting, last));
        if let Some(request) = waiting.and_then(|waiting| self.requests.get(waiting.request as usize)) {
            self.note(last, format_args!("asked at line {} (step {}): {}", request.line, request.step, request.text));
        }
    }
}

impl Operator for People<'_> {
    fn demand(&mut self, now: Tick) -> Demand {
        (&mut &*self.switches).demand(now)
    }

    fn confirmation(&mut self, now: Tick, waiting: Option<Waiting>, measured: &Measurement) -> Option<Confirmation> {
        if waiting != self.open.map(|(waiting, _)| waiting) {
            if let (Some((_, since)), last) = (self.open, self.last) {
                self.note(last, format_args!("no longer asked, after {:.1} s: not confirmed", seconds(since, last)));
            }
            self.turn(waiting);
        }
        let confirmation = self.switches.confirmations.take(now, waiting, measured);
        self.last = now;
        if let (Some(confirmation), Some((waiting, since))) = (confirmation, self.open.filter(|_| waiting.is_some())) {
            self.open = None;
            let after_s = seconds(since, now);
            match (waiting.amount, confirmation.volume_ml) {
                (_, Some(volume_ml)) => {
                    self.note(now, format_args!("confirmed after {after_s:.1} s: {volume_ml} ml"));
                }
                (Some(Amount::VolumeMl), None) => {
                    let volume_ml = measured.volume_ml;
                    self.note(now, format_args!("confirmed after {after_s:.1} s: {volume_ml} ml as measured"));
                }
                (None, None) => self.note(now, format_args!("confirmed after {after_s:.1} s")),
            }
        }
        confirmation
    }
}

fn seconds(since: Tick, now: Tick) -> f64 {
    now.seconds() - since.seconds()
}

/// Says what is asked for when it is first asked. Belongs to a thread that may wait.
pub struct Crier<'a> {
    requests: &'a [Request],
    instance: &'a str,
    said: Option<Waiting>,
}

impl<'a> Crier<'a> {
    /// Of a run on `instance` with these requests.
    pub fn new(requests: &'a [Request], instance: &'a str) -> Self {
        Crier { requests, instance, said: None }
    }

    /// Looks what is asked for now. To be called several times a second while the run goes on.
    pub fn look(&mut self, switches: &Switches, progress: &Progress) {
        let open = switches.confirmations.waiting();
        if open == self.said {
            return;
        }
        self.said = open;
        match open.and_then(|open| Some((open, self.requests.get(open.request as usize)?))) {
            Some((open, request)) => {
                set_open(&request.text);
                progress.say(&told(&request.text, open.amount, self.instance));
            }
            None => set_open(""),
        }
    }
}

impl Drop for Crier<'_> {
    fn drop(&mut self) {
        set_open("");
    }
}

/// A request as it is said: what, and how it is confirmed.
fn told(text: &str, amount: Option<Amount>, instance: &str) -> String {
    let number = amount.map_or("", |Amount::VolumeMl| " --volume-ml X");
    let keys = match (keyboard::watched(), amount) {
        (true, None) => "press Enter when it is done, or ",
        (true, Some(Amount::VolumeMl)) => "type the amount in ml, then Enter, or ",
        (false, _) => "confirm with ",
    };
    format!("ASKED: {text} ({keys}`bench confirm --instance {instance}{number}`)")
}

/// Whether a script can be run with these hands, as far as people are concerned.
///
/// # Errors
/// People are needed, and there are none, or time is virtual (2).
pub fn require(script: &Script, context: &Context, nobody: bool, virtual_time: bool) -> Result<(), Failure> {
    if context.hands == Hands::Rig || !(nobody || virtual_time) {
        return Ok(());
    }
    let requests = script.requests(context).map_err(|e| Failure::of(Kind::Input, &e))?;
    let why = if nobody { "there is nobody (--no-operator)" } else { "time is virtual: add --realtime" };
    let first = requests
        .first()
        .map_or_else(String::new, |first| format!(", the first at line {}: {}", first.line, first.text));
    let message = format!(
        "{}: this rig has no automatic fixture, so that people have to prepare it and to do {} things{first}; but {why}",
        script.name,
        requests.len()
    );
    Err(Failure::new(Kind::Input, message))
}

/// Whether a run may still be begun. Until the loop runs nobody else looks at the switches, and a rig that is prepared is armed.
///
/// # Errors
/// An emergency stop (5) or a stop (130) was asked for.
pub fn still_wanted(script: &Script, switches: &Switches) -> Result<(), Failure> {
    if switches.emergency_stop.load(Ordering::Relaxed) {
        let message = format!("{}: emergency stop before the run; it was not begun", script.name);
        return Err(Failure::new(Kind::Safety, message));
    }
    if switches.stop.load(Ordering::Relaxed) {
        return Err(Failure::new(Kind::Interrupted, format!("{}: stopped before the run", script.name)));
    }
    Ok(())
}

/// Asks people to prepare the rig for a script, and waits until they confirm.
///
/// # Errors
/// A stop (130) or an emergency stop (5) meanwhile: the run is not begun.
pub fn ask_to_prepare(
    script: &Script,
    instance: &str,
    switches: &Switches,
    journal: &mut Journal,
    progress: &Progress,
) -> Result<(), Failure> {
    let text = script.preparation();
    let waiting = Some(Waiting { request: PREPARATION, amount: None });
    let begun = Instant::now();
    set_open(&text);
    progress.say(&told(&text, None, instance));
    let outcome = loop {
        if let Err(asked) = still_wanted(script, switches) {
            break Err(asked);
        }
        if switches.confirmations.take(Tick::at(0), waiting, &Measurement::NONE).is_some() {
            break Ok(());
        }
        thread::sleep(LOOK);
    };
    switches.confirmations.run_over();
    set_open("");
    if outcome.is_ok() {
        let after_s = begun.elapsed().as_secs_f64();
        journal.note(
            When::MonotonicNs(monotonic_ns()),
            Severity::Info,
            format_args!("confirmed after {after_s:.1} s: {text}"),
        );
    }
    outcome
}
