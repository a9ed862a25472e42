//! One slice after the other, in a thread that is prepared as the loop's is; what the system grants holds for all of them.

use crate::failure::{Failure, Kind};
use crate::latency::bare;
use crate::latency::real_loop::{RealLoop, STAGES, Taken};
use crate::latency::slices::{DISTURBED_FROM, Kind as SliceKind, Plan, SUBSCRIBERS};
use crate::latency::statistics::{Distribution, Figures, Pool};
use crate::latency::subscriber::{Disturbance, Heard, Subscribers};
use crate::progress::Progress;
use rt_core::system::{self, Grant, Outcome, Report, Request};
use rt_core::{Pace, Publication};
use serde::Serialize;
use std::sync::mpsc::{self, Receiver};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// The publication thread's priority lies below the loop's by this much.
const PUBLICATION_BELOW: u8 = 10;
/// Longest wait for the publication to send what is left after a slice.
const PATIENCE: Duration = Duration::from_secs(10);

/// What is to be measured.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The slices.
    pub plan: Plan,
    /// What is asked of the system.
    pub request: Request,
}

/// All slices of the loop with one number of subscribers.
#[derive(Clone, Debug, Default)]
pub struct Group {
    /// Lateness of the loop's wake-ups.
    pub lateness: Pool,
    /// Lateness of the bare loop in the slices that follow.
    pub bare: Pool,
    /// From the loop's wake-up until a subscriber has the sample; subscribers that were left in peace, all together.
    pub to_subscriber: Pool,
    /// The same from the scheduled time.
    pub scheduled_to_subscriber: Pool,
    /// Samples that these subscribers received.
    pub received: u64,
    /// Samples that were published for them.
    pub expected: u64,
}

/// One slice in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct Slice {
    /// `loop`, `bare` or `cyclictest`.
    pub kind: &'static str,
    /// Subscribers, where it is the loop's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subscribers: Option<usize>,
    /// Wake-ups.
    pub ticks: u64,
    /// Their lateness, us.
    #[serde(flatten)]
    pub lateness_us: Figures,
    /// Wake-ups that came later than 2 ms.
    pub over_2ms: u64,
}

/// What was measured.
#[derive(Clone, Debug)]
pub struct Measured {
    /// As it was planned.
    pub plan: Plan,
    /// Each slice, in order.
    pub slices: Vec<Slice>,
    /// The loop's slices by number of subscribers, as [`SUBSCRIBERS`].
    pub groups: [Group; SUBSCRIBERS.len()],
    /// The bare loop.
    pub bare: Pool,
    /// cyclictest; empty where it was not asked for.
    pub cyclictest: Pool,
    /// Duration of the loop's ticks.
    pub tick: Pool,
    /// Duration of each stage, as [`STAGES`].
    pub stages: [Pool; STAGES.len()],
    /// Duration of the hand-over.
    pub publish: Pool,
    /// Ticks that the loop passed over.
    pub skipped: u64,
    /// Samples that the publication did not take.
    pub not_taken: u64,
    /// What was asked of the system for the whole process, and what became of it.
    pub process: Report,
    /// The same for the loop's thread.
    pub thread: Report,
}

impl Measured {
    /// The loop's lateness, whatever the number of subscribers.
    pub fn lateness(&self) -> Pool {
        let mut all = Pool::default();
        self.groups.iter().for_each(|group| all.add_pool(&group.lateness));
        all
    }
}

/// Measures; takes as long as the plan says and some tenths of a second for each slice.
///
/// # Errors
/// No shared memory or no subscriber process (4), a trip (5), cyclictest is missing (2).
pub fn measure(settings: &Settings, progress: &Progress) -> Result<Measured, Failure> {
    let Settings { plan, request } = settings;
    // The latency request is held by the guard: for all kinds of slices alike.
    let (_held, process) = system::prepare_process(request);
    let mut measured = Measured {
        plan: plan.clone(),
        slices: Vec::with_capacity(plan.slices.len()),
        groups: Default::default(),
        bare: Pool::default(),
        cyclictest: Pool::default(),
        tick: Pool::default(),
        stages: Default::default(),
        publish: Pool::default(),
        skipped: 0,
        not_taken: 0,
        process,
        thread: Report::default(),
    };
    let step = progress.step("latency", plan.slices.len() as u64);
    for (number, kind) in plan.slices.iter().enumerate() {
        match *kind {
            SliceKind::Loop { subscribers } => measured.loop_slice(number as u32, subscribers, request)?,
            SliceKind::Bare => measured.bare_slice(number, request)?,
            SliceKind::Cyclictest => measured.cyclictest_slice(request)?,
        }
        step.at(number as u64 + 1);
    }
    step.finish();
    Ok(measured)
}

impl Measured {
    fn loop_slice(&mut self, run: u32, count: usize, request: &Request) -> Result<(), Failure> {
        let link = |e| Failure::of(Kind::Device, &e);
        // One of its own: what a killed subscriber left is of no concern to the next slice.
        let instance = format!("latency-{}-{run}", std::process::id());
        let mut slice = RealLoop::new(run, self.plan.ticks)?;
        let below = Request { priority: request.priority.saturating_sub(PUBLICATION_BELOW).max(1), ..request.clone() };
        let mut publication = Publication::start_prepared(&instance, Pace::RealTime, move || {
            // The loop's own thread asks the same and tells what is refused.
            let _ = system::prepare_thread(&below);
        })
        .map_err(link)?;
        let mut subscribers = Subscribers::start(&instance, count)?;

        let thread = Prepared::start(request, move || {
            let outcome = slice.drive(&mut publication);
            (slice, publication, outcome)
        })?;
        self.hear_grants(&thread);
        let third = Duration::from_secs_f64(self.plan.slice_s() / 3.0);
        if count >= DISTURBED_FROM {
            for (index, disturbance) in [Disturbance::Stall, Disturbance::Kill].into_iter().enumerate() {
                thread::sleep(third);
                subscribers.disturb(index, disturbance);
            }
        }
        let (slice, publication, outcome) = thread.wait()?;
        publication.settle(PATIENCE).map_err(link)?;
        publication.stop().map_err(link)?;
        let taken = slice.taken(outcome)?;
        let heard = subscribers.heard()?;
        self.add_loop(count, &taken, &heard);
        Ok(())
    }

    fn bare_slice(&mut self, number: usize, request: &Request) -> Result<(), Failure> {
        let ticks = self.plan.ticks;
        // Written once, so that no page is missing when the loop comes to it.
        let mut lateness_ns = vec![u64::MAX; usize::try_from(ticks).unwrap_or(usize::MAX)];
        lateness_ns.clear();
        let thread = Prepared::start(request, move || {
            bare::wait_only(ticks, &mut lateness_ns);
            lateness_ns
        })?;
        self.hear_grants(&thread);
        let mut lateness = Distribution::default();
        thread.wait()?.into_iter().for_each(|ns| lateness.record_ns(ns));
        self.bare.add(&lateness);
        if let Some(SliceKind::Loop { subscribers }) = number.checked_sub(1).map(|before| self.plan.slices[before]) {
            self.group(subscribers).bare.add(&lateness);
        }
        self.slices.push(Slice::of("bare", None, &lateness));
        Ok(())
    }

    fn cyclictest_slice(&mut self, request: &Request) -> Result<(), Failure> {
        let lateness = bare::cyclictest(self.plan.ticks, priority(&self.thread, request), request.cpus.as_deref());
        let lateness = lateness.map_err(|e| Failure::of(Kind::Input, &e))?;
        self.cyclictest.add(&lateness);
        self.slices.push(Slice::of("cyclictest", None, &lateness));
        Ok(())
    }

    fn add_loop(&mut self, subscribers: usize, taken: &Taken, heard: &[Heard]) {
        self.slices.push(Slice::of("loop", Some(subscribers), &taken.lateness));
        self.tick.add(&taken.tick);
        self.publish.add(&taken.publish);
        for (pool, stage) in self.stages.iter_mut().zip(&taken.stages) {
            pool.add(stage);
        }
        self.skipped += taken.report.statistics.skipped;
        self.not_taken += taken.report.statistics.not_taken;
        let group = self.group(subscribers);
        group.lateness.add(&taken.lateness);
        let (mut woken, mut scheduled) = (Distribution::default(), Distribution::default());
        for heard in heard {
            woken.add(&heard.from_woken());
            scheduled.add(&heard.from_scheduled());
            group.received += heard.received;
            group.expected += heard.expected;
        }
        group.to_subscriber.add(&woken);
        group.scheduled_to_subscriber.add(&scheduled);
    }

    fn group(&mut self, subscribers: usize) -> &mut Group {
        let index = SUBSCRIBERS.iter().position(|&n| n == subscribers);
        &mut self.groups[index.expect("the plan takes its numbers from this list")]
    }

    /// All threads ask the same; the first one's answer is kept.
    fn hear_grants<T>(&mut self, thread: &Prepared<T>) {
        if self.slices.is_empty() {
            self.thread = thread.report.clone();
        }
    }
}

impl Slice {
    fn of(kind: &'static str, subscribers: Option<usize>, lateness: &Distribution) -> Slice {
        Slice { kind, subscribers, ticks: lateness.count(), lateness_us: lateness.figures(), over_2ms: lateness.late() }
    }
}

/// Work in a thread that was prepared for it.
struct Prepared<T> {
    report: Report,
    done: Receiver<T>,
    handle: JoinHandle<()>,
}

impl<T: Send + 'static> Prepared<T> {
    fn start(request: &Request, work: impl FnOnce() -> T + Send + 'static) -> Result<Self, Failure> {
        let (prepared, from_thread) = mpsc::channel();
        let (finished, done) = mpsc::channel();
        let request = request.clone();
        let body = move || {
            // The other end waits for both, unless it has failed.
            let _ = prepared.send(system::prepare_thread(&request));
            let _ = finished.send(work());
        };
        let handle = thread::Builder::new().name("loop".to_owned()).spawn(body);
        let handle = handle.map_err(|e| {
            Failure::new(
                Kind::Internal,
                format!("expected a thread for the loop, got \"{e}\"; free memory or threads (`ulimit -a`)"),
            )
        })?;
        let report = Report::new(from_thread.recv().map_err(|_| defect())?);
        Ok(Prepared { report, done, handle })
    }

    fn wait(self) -> Result<T, Failure> {
        let result = self.done.recv();
        self.handle.join().map_err(|_| defect())?;
        result.map_err(|_| defect())
    }
}

fn defect() -> Failure {
    Failure::new(Kind::Internal, "the loop's thread ended by a defect; see above")
}

/// The priority that was asked for, where it holds.
fn priority(report: &Report, request: &Request) -> Option<u8> {
    let granted = |grant: &Grant| grant.what == "sched" && matches!(grant.outcome, Outcome::Granted(_));
    report.grants().iter().any(granted).then_some(request.priority)
}
