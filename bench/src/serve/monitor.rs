//! The sample thread: follows whatever runs on the instance, as a subscriber that nobody waits for and nobody wakes.

use super::board::{Board, OwnRun};
use super::buckets::{Bucket, Decimator};
use super::described::Described;
use super::event_log::Severity;
use super::lateness::Lateness;
use super::state::Held;
use super::stream::Begin;
use super::view;
use rt_core::announce::Announcements;
use rt_core::presence::is_published;
use rt_core::system::time::monotonic_ns;
use rt_core::{Delivery, LinkError, PERIOD_NS, Sample, SampleSubscriber};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Between two looks after samples; two of them make a frame.
const LOOK: Duration = Duration::from_millis(20);
/// A run that has been silent for so long may be gone.
const SILENCE: Duration = Duration::from_secs(1);
/// How long a run's announcement is waited for.
const ANNOUNCED_WITHIN: Duration = Duration::from_secs(3);
/// Between two attempts to listen, where the transport failed.
const AGAIN: Duration = Duration::from_secs(1);

/// Follows `instance` until `over`. `trip_seen` hears of each run that trips, once.
pub fn follow(instance: &str, board: &Board, over: &AtomicBool, mut trip_seen: impl FnMut(Held)) {
    let mut trouble = None;
    while !over.load(Ordering::Relaxed) {
        let outcome = Ears::open(instance).and_then(|mut ears| {
            trouble = None;
            listen(&mut ears, board, over, &mut trip_seen)
        });
        if let Err(error) = outcome {
            // Said once, however often it fails.
            let text = format!("samples can't be followed: {error}");
            if trouble.as_ref() != Some(&text) {
                board.note(Severity::Error, "monitor", &text, None);
                trouble = Some(text);
            }
            board.samples_beat.beat();
            thread::sleep(AGAIN);
        }
    }
}

/// The thread's ports.
struct Ears {
    instance: String,
    samples: SampleSubscriber,
    announcements: Announcements,
}

impl Ears {
    fn open(instance: &str) -> Result<Ears, LinkError> {
        let samples = SampleSubscriber::open(instance, Delivery::Polled)?;
        let announcements = Announcements::open(instance)?;
        Ok(Ears { instance: instance.to_owned(), samples, announcements })
    }
}

fn listen(ears: &mut Ears, board: &Board, over: &AtomicBool, trip_seen: &mut dyn FnMut(Held)) -> Result<(), LinkError> {
    let mut heard = Vec::with_capacity(rt_core::subscribe::DRAIN_MAX);
    let mut followed: Option<Followed> = None;
    let mut first = true;
    let mut passes = 0_u64;
    while !over.load(Ordering::Relaxed) {
        board.samples_beat.beat();
        ears.announcements.hear()?;
        // Before the samples: where it is none, everything that a run of the queue published is among them.
        let own = board.own();
        heard.clear();
        while ears.samples.drain(&mut heard)? > 0 {}
        // Certificates are the loggers' business; here they would only pile up.
        while ears.samples.take_certificate().is_some() {}
        for sample in &heard {
            if own.as_ref().is_some_and(|own| own.number == sample.run) {
                follow_own(&mut followed, own.as_ref(), board);
            }
            if !followed.as_ref().is_some_and(|run| run.continues_with(sample)) {
                end(&mut followed, board);
                followed = Some(Followed::foreign(board, sample, first));
            }
            first = false;
            if let Some(run) = &mut followed {
                run.take(sample, board, trip_seen);
            }
        }
        follow_own(&mut followed, own.as_ref(), board);
        if let Some(run) = &mut followed {
            run.describe(&mut ears.announcements, board)?;
            run.judge_silence(&ears.instance, board)?;
            if passes.is_multiple_of(2) || run.ended {
                run.show(board);
            }
        }
        let busy = followed.as_ref().is_some_and(|run| !run.ended);
        let waits = busy && followed.as_ref().is_some_and(|run| run.newest.is_none_or(|newest| newest.waiting()));
        board.busy.store(busy, Ordering::Relaxed);
        board.waits.store(waits, Ordering::Relaxed);
        passes += 1;
        thread::sleep(LOOK);
    }
    Ok(())
}

/// A run of the queue is followed from its start on, before its first sample; it ends with its process at the latest.
fn follow_own(followed: &mut Option<Followed>, own: Option<&Arc<OwnRun>>, board: &Board) {
    let followed_own = followed.as_ref().filter(|run| run.view.own).map(|run| run.view.number);
    match own {
        Some(own) if followed_own != Some(own.number) => {
            end(followed, board);
            *followed = Some(Followed::own(board, own));
        }
        None if followed_own.is_some() => end(followed, board),
        Some(_) | None => {}
    }
}

fn end(followed: &mut Option<Followed>, board: &Board) {
    if let Some(run) = followed {
        run.end(board, None);
    }
}

/// A run that is followed.
struct Followed {
    view: view::Run,
    described: Option<Arc<Described>>,
    /// What the run itself announced is known, or no longer waited for.
    announced: bool,
    begun: Instant,
    /// Number that its samples carry.
    source: u32,
    decimator: Decimator,
    buckets: Vec<Bucket>,
    lateness: Lateness,
    newest: Option<Sample>,
    /// When its newest sample came.
    heard: Instant,
    told_missed: u64,
    timed: Instant,
    ended: bool,
}

impl Followed {
    fn new(board: &Board, number: u32, own: bool, source: u32, decimator: Decimator) -> Followed {
        let now = Instant::now();
        board.begin(Begin { run: number, ..Begin::default() });
        Followed {
            view: view::Run { number, own, supervisor: "ok", ..view::Run::default() },
            described: None,
            announced: false,
            begun: now,
            source,
            decimator,
            buckets: Vec::new(),
            lateness: Lateness::default(),
            newest: None,
            heard: now,
            told_missed: 0,
            timed: now,
            ended: false,
        }
    }

    fn own(board: &Board, own: &OwnRun) -> Followed {
        let mut run = Followed::new(board, own.number, true, own.number, Decimator::from_start());
        run.described = Some(Arc::clone(&own.described));
        own.described.fill(&mut run.view);
        run.show(board);
        run
    }

    /// A run of another process. `joined`: it may have begun before anybody listened.
    fn foreign(board: &Board, sample: &Sample, joined: bool) -> Followed {
        let decimator = if joined { Decimator::default() } else { Decimator::from_start() };
        Followed::new(board, board.numbers.next(), false, sample.run, decimator)
    }

    /// Whether this sample belongs to it.
    fn continues_with(&self, sample: &Sample) -> bool {
        let later = self.newest.is_none_or(|newest| sample.tick > newest.tick);
        sample.run == self.source && later && !self.ended
    }

    fn take(&mut self, sample: &Sample, board: &Board, trip_seen: &mut dyn FnMut(Held)) {
        let before = self.newest.replace(*sample);
        self.heard = Instant::now();
        let buckets = &mut self.buckets;
        self.decimator.push(sample, &mut |bucket| buckets.push(bucket));
        self.lateness.record_ns(sample.lateness_ns);
        self.view.samples += 1;
        if self.view.origin_utc_ms.is_none() && sample.woken_ns > 0 {
            self.view.origin_utc_ms = Some(origin_utc_ms(sample));
        }
        let place = Some((self.view.number, Some(sample.time_s())));
        if before.is_none() {
            let text = if self.view.own { "the run begins" } else { "a run of another process is followed" };
            board.note(Severity::Info, "monitor", text, place);
        }
        if sample.tripped() && !before.is_some_and(|before| before.tripped()) {
            let reason = trip_reason(sample);
            board.note(Severity::Error, "supervisor", &format!("tripped: {reason}"), place);
            self.view.trip = Some(reason.clone());
            trip_seen(Held { run: Some(self.view.number), reason });
        }
        if sample.fault() && !before.is_some_and(|before| before.fault()) {
            board.note(Severity::Error, "device", "the device failed; the safe state was ordered", place);
        }
        if sample.last() {
            self.end(board, Some(sample.time_s()));
        }
    }

    fn end(&mut self, board: &Board, time_s: Option<f64>) {
        if self.ended {
            return;
        }
        self.ended = true;
        let buckets = &mut self.buckets;
        self.decimator.close(&mut |bucket| buckets.push(bucket));
        self.show(board);
        if self.newest.is_some() {
            let text = match time_s {
                Some(time_s) => format!("the run ends after {time_s:.3} s"),
                None => "the run ended without a last sample".to_owned(),
            };
            let severity = if time_s.is_some() { Severity::Info } else { Severity::Warning };
            board.note(severity, "monitor", &text, Some((self.view.number, time_s)));
        }
        board.change();
    }

    /// What the run itself announced is better than what was queued.
    fn describe(&mut self, announcements: &mut Announcements, board: &Board) -> Result<(), LinkError> {
        if self.announced || self.newest.is_none() {
            return Ok(());
        }
        let described = announcements.of_run(self.source, Duration::ZERO)?.map(Described::announced);
        if let Some(described) = described {
            self.announced = true;
            if let Some(described) = described {
                described.fill(&mut self.view);
                self.described = Some(Arc::new(described));
                self.show(board);
            }
        } else if self.begun.elapsed() > ANNOUNCED_WITHIN {
            self.announced = true;
        }
        Ok(())
    }

    /// A process that was killed ends its run without a last sample. Of the service's own, its supervisor knows.
    fn judge_silence(&mut self, instance: &str, board: &Board) -> Result<(), LinkError> {
        if self.ended || self.view.own || self.heard.elapsed() < SILENCE {
            return Ok(());
        }
        self.heard = Instant::now();
        if !is_published(instance)? {
            self.end(board, None);
        }
        Ok(())
    }

    /// Puts everything on the board.
    fn show(&mut self, board: &Board) {
        let missed = self.decimator.missed();
        if missed > self.told_missed {
            let text =
                format!("{} samples did not reach the service; the recording has its own", missed - self.told_missed);
            self.told_missed = missed;
            board.note(Severity::Warning, "monitor", &text, Some((self.view.number, Some(self.view.time_s))));
        }
        self.view.missed = missed;
        self.view.ended = self.ended;
        if let Some(sample) = &self.newest {
            let view = &mut self.view;
            view.tick = sample.tick;
            view.time_s = sample.time_s();
            view.skipped = sample.skipped;
            view.segment = sample.segment;
            view.supervisor = view::supervisor(sample);
            view.remaining_s = view.duration_s.map(|duration_s| (duration_s - view.time_s).max(0.0));
            if view.step.as_ref().is_none_or(|step| step.index != sample.step) {
                view.step = self.described.as_ref().and_then(|described| described.step(sample.step));
            }
        }
        let due = self.timed.elapsed() >= Duration::from_secs(1) || self.ended;
        let timing = (due && self.newest.is_some()).then(|| {
            self.timed = Instant::now();
            self.lateness.timing(self.view.number, self.view.skipped)
        });
        board.watched(|watched| {
            watched.run = Some(self.view.clone());
            watched.link = self.newest.as_ref().map(view::Link::from);
            watched.timing = timing.or(watched.timing.take());
        });
        board.append(&self.buckets, &self.view.name, self.view.origin_utc_ms);
        self.buckets.clear();
    }
}

fn trip_reason(sample: &Sample) -> String {
    view::trip_reason(sample).unwrap_or_else(|| "the supervisor tripped".to_owned())
}

/// When the run's tick 0 was due, by the clock of the wall, ms since 1970.
fn origin_utc_ms(sample: &Sample) -> f64 {
    let due_ns = sample.woken_ns.saturating_sub(sample.lateness_ns);
    let ago_ns = monotonic_ns().saturating_sub(due_ns) + sample.tick * PERIOD_NS;
    jiff::Timestamp::now().as_microsecond() as f64 * 1e-3 - ago_ns as f64 * 1e-6
}
