//! What the service's threads know of each other. Every lock is held for a moment only, and never two of them.

use super::buckets::Bucket;
use super::described::Described;
use super::event_log::{EventLog, Severity};
use super::lateness::Timing;
use super::state::{Queued, RunNumbers};
use super::stream::{Begin, Cursor, Parcel, Stream};
use super::view;
use rt_core::system::time::monotonic_ns;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// A thread that has not told for so long that it works does not.
const ALIVE_WITHIN_NS: u64 = 3_000_000_000;

/// Says that a thread works.
#[derive(Debug, Default)]
pub struct Beat(AtomicU64);

impl Beat {
    /// It works now.
    pub fn beat(&self) {
        self.0.store(monotonic_ns(), Ordering::Relaxed);
    }

    /// It did a moment ago.
    pub fn is_alive(&self) -> bool {
        monotonic_ns().saturating_sub(self.0.load(Ordering::Relaxed)) < ALIVE_WITHIN_NS
    }
}

/// What the supervisor of the runs says.
#[derive(Debug)]
pub struct Desk {
    /// The service.
    pub service: view::Service,
    /// What waits for its turn.
    pub queue: Vec<Queued>,
    /// The last run of the queue that ended.
    pub last: Option<view::Last>,
}

/// What the sample thread says.
#[derive(Debug, Default)]
pub struct Watched {
    /// The run under way, or the last one.
    pub run: Option<view::Run>,
    /// At its newest sample.
    pub link: Option<view::Link>,
    /// Of its wake-ups.
    pub timing: Option<Timing>,
}

/// A run of the queue, as the supervisor tells the sample thread.
pub struct OwnRun {
    /// Its number, which its samples carry.
    pub number: u32,
    /// What it is.
    pub described: Arc<Described>,
}

/// See the module.
pub struct Board {
    desk: Mutex<Desk>,
    watched: Mutex<Watched>,
    stream: Mutex<Stream>,
    events: Mutex<EventLog>,
    own: Mutex<Option<Arc<OwnRun>>>,
    waiting: Mutex<Option<view::Waiting>>,
    changed: watch::Sender<u64>,
    frames: watch::Sender<u64>,
    /// Of all runs that the service sees.
    pub numbers: Arc<RunNumbers>,
    /// Somebody's run is under way on this instance.
    pub busy: AtomicBool,
    /// That run waits for people.
    pub waits: AtomicBool,
    /// The sample thread.
    pub samples_beat: Beat,
    /// The HTTP side.
    pub web_beat: Beat,
}

/// What was written before a panic is still sound: every value is replaced as a whole.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Board {
    /// Of a service that begins so.
    pub fn new(service: view::Service, numbers: Arc<RunNumbers>) -> Self {
        Board {
            desk: Mutex::new(Desk { service, queue: Vec::new(), last: None }),
            watched: Mutex::default(),
            stream: Mutex::default(),
            events: Mutex::default(),
            own: Mutex::default(),
            waiting: Mutex::default(),
            changed: watch::Sender::new(0),
            frames: watch::Sender::new(0),
            numbers,
            busy: AtomicBool::new(false),
            waits: AtomicBool::new(false),
            samples_beat: Beat::default(),
            web_beat: Beat::default(),
        }
    }

    /// Notes an event, `run`: the run that it belongs to, and when in it, s.
    pub fn note(&self, severity: Severity, source: &'static str, text: &str, run: Option<(u32, Option<f64>)>) {
        match severity {
            Severity::Info => tracing::info!(source, "{text}"),
            Severity::Warning => tracing::warn!(source, "{text}"),
            Severity::Error => tracing::error!(source, "{text}"),
        }
        locked(&self.events).note(severity, source, text, run);
        self.change();
    }

    /// Events with a number above `after`.
    pub fn events_since(&self, after: u64) -> Vec<Arc<super::event_log::Event>> {
        locked(&self.events).since(after)
    }

    /// Changes what the supervisor says.
    pub fn desk<T>(&self, change: impl FnOnce(&mut Desk) -> T) -> T {
        change(&mut locked(&self.desk))
    }

    /// Changes what the sample thread says.
    pub fn watched<T>(&self, change: impl FnOnce(&mut Watched) -> T) -> T {
        change(&mut locked(&self.watched))
    }

    /// Clients are to be told the state at once.
    pub fn change(&self) {
        self.changed.send_modify(|count| *count += 1);
    }

    /// Wakes where something changed.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Wakes where there are new buckets.
    pub fn frames(&self) -> watch::Receiver<u64> {
        self.frames.subscribe()
    }

    /// A new run begins: plots start afresh.
    pub fn begin(&self, begin: Begin) {
        locked(&self.stream).begin(begin);
    }

    /// New buckets, and what is known of their run by now.
    pub fn append(&self, buckets: &[Bucket], name: &str, origin_utc_ms: Option<f64>) {
        let published = {
            let mut stream = locked(&self.stream);
            stream.describe(name, origin_utc_ms);
            buckets.iter().for_each(|bucket| stream.push(*bucket));
            stream.publish()
        };
        if published {
            self.frames.send_modify(|count| *count += 1);
        }
    }

    /// What a client has not had.
    pub fn next(&self, cursor: &mut Cursor) -> Parcel {
        locked(&self.stream).next(cursor)
    }

    /// The run of the queue that is under way.
    pub fn own(&self) -> Option<Arc<OwnRun>> {
        locked(&self.own).clone()
    }

    /// Another one is, or none.
    pub fn set_own(&self, own: Option<OwnRun>) {
        *locked(&self.own) = own.map(Arc::new);
    }

    /// What people are asked for.
    pub fn set_waiting(&self, waiting: Option<view::Waiting>) {
        let changed = {
            let mut place = locked(&self.waiting);
            let changed = *place != waiting;
            *place = waiting;
            changed
        };
        if changed {
            self.change();
        }
    }

    /// What people are asked for.
    pub fn waiting(&self) -> Option<view::Waiting> {
        locked(&self.waiting).clone()
    }

    /// The state as JSON, with a `type` in front where clients of the live connection get it.
    pub fn state_json(&self, kind: Option<&str>) -> String {
        #[derive(serde::Serialize)]
        struct Typed<'a> {
            #[serde(rename = "type", skip_serializing_if = "Option::is_none")]
            kind: Option<&'a str>,
            #[serde(flatten)]
            state: view::State<'a>,
        }
        let waiting = self.waiting();
        let (run, link) = {
            let watched = locked(&self.watched);
            (watched.run.clone(), watched.link.clone())
        };
        let run = run.map(|run| view::Run { waiting: waiting.filter(|_| !run.ended), ..run });
        let desk = locked(&self.desk);
        let Desk { service, queue, last } = &*desk;
        let state = view::State { service, run: run.as_ref(), link, queue, last: last.as_ref() };
        serde_json::to_string(&Typed { kind, state }).expect("names and numbers always have a JSON form")
    }
}
