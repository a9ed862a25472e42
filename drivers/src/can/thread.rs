//! The thread that owns a bus.

use super::orders::{Orders, Set};
use super::poll::polled;
use super::port::{End, Heard, Port, Wanted, is_full};
use super::report::{EVERY, Reporter};
use super::state::Shared;
use super::{CanError, Condition, ErrorFrame, FrameId, Interface, TimedFrame};
use crate::exchange::{Giver, Taker};
use crate::journal::{Journal, Severity};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::Ordering::{Acquire, Relaxed};
use std::sync::mpsc::SyncSender;
use std::time::Duration;
use tokio::io::unix::AsyncFd;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval_at, timeout};

/// Between two attempts to open a bus again that was lost.
const AGAIN: Duration = Duration::from_millis(200);
/// The last set of commands may wait so long for room.
const LAST_SET: Duration = Duration::from_millis(100);

/// What the thread is given.
pub(super) struct Worker {
    pub(super) interface: Interface,
    pub(super) wanted: Vec<FrameId>,
    pub(super) sets: Taker<Set>,
    pub(super) heard: Giver<TimedFrame>,
    pub(super) orders: Arc<Orders>,
    pub(super) wake: Arc<OwnedFd>,
}

impl Worker {
    /// Until the link is dropped; `opened` is told how the first opening went.
    pub(super) fn work(self, journal: Journal, opened: SyncSender<Result<(), CanError>>) {
        // However it ends: there is no bus then.
        let orders = self.orders.clone();
        let _down = OnDrop(move || {
            orders.shared.set_condition(Condition::Down);
        });
        let interface = self.interface.clone();
        let system = |what| move |source| CanError::System { interface, what, source };
        let runtime = match tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build() {
            Ok(runtime) => runtime,
            Err(source) => {
                // Who opened it waits for this word, and hears of nothing else.
                let _ = opened.send(Err(system("tokio's runtime")(source)));
                return;
            }
        };
        runtime.block_on(async {
            let wake = polled(self.wake.clone());
            let first = wake.map_err(system("epoll")).and_then(|wake| Ok((wake, self.open()?)));
            let (wake, port) = match first {
                Ok(first) => first,
                Err(error) => {
                    let _ = opened.send(Err(error));
                    return;
                }
            };
            let report = Reporter::new(journal, self.interface.clone());
            let mut bus = Bus { worker: self, report, wake, pending: None, late: None };
            bus.begin(&port);
            let _ = opened.send(Ok(()));
            bus.keep_up(port).await;
        });
    }

    fn open(&self) -> Result<Port, CanError> {
        Port::open(&self.interface, Wanted::Only(&self.wanted), End::Connects)
    }
}

/// The bus and what is under way on it.
struct Bus {
    worker: Worker,
    report: Reporter,
    wake: AsyncFd<Arc<OwnedFd>>,
    pending: Option<Pending>,
    /// A set that was not the newest any more when it was taken, and waits for that one.
    late: Option<Set>,
}

/// A set that has not gone out yet.
struct Pending {
    set: Set,
    sent: usize,
    /// Why it has not: there was no room.
    full: Option<io::Error>,
}

enum Ended {
    Stopped,
    Lost(io::Error),
}

impl Bus {
    /// Serves the bus, and opens it again whenever it is lost, until the link is dropped.
    async fn keep_up(&mut self, mut port: Port) {
        loop {
            let lost = match self.serve(&port).await {
                Ended::Stopped => break,
                Ended::Lost(error) => error,
            };
            drop(port);
            self.give_up_pending();
            self.set_condition(Condition::Down, format_args!("{lost}; tried again every {} ms", AGAIN.as_millis()));
            port = match self.open_again().await {
                Some(port) => port,
                None => break,
            };
            self.begin(&port);
            if self.condition() == Condition::Active {
                self.report.changed(Condition::Active, format_args!("there again"));
            }
        }
        self.report.sum_up();
    }

    /// The condition in which a port is found that was just opened.
    fn begin(&mut self, port: &Port) {
        self.shared().set_condition(Condition::Active);
        let Some(controller) = port.controller() else { return };
        if let Some(counters) = controller.error_counters {
            self.shared().set_counters(counters);
        }
        if controller.condition != Condition::Active {
            self.set_condition(controller.condition, format_args!("found so when it was opened"));
        }
        if controller.restart_ms == 0 && controller.condition != Condition::BusOff {
            let what =
                format_args!("restart-ms is 0: after a bus-off it stays off until `ip link set ... type can restart`");
            self.report.remark(Severity::Info, what);
        }
    }

    async fn serve(&mut self, port: &Port) -> Ended {
        let (mut every, mut dropped) = (summaries(), 0);
        loop {
            // In the order of their weight: a node that babbles must keep no command back.
            let done = tokio::select! {
                biased;
                () = woken(&self.wake) => {
                    let stop = self.obey();
                    if stop {
                        self.count_dropped(port, &mut dropped);
                        self.finish(port).await;
                        return Ended::Stopped;
                    }
                    self.push(port)
                }
                _ = every.tick() => {
                    self.count_dropped(port, &mut dropped);
                    self.report.sum_up();
                    self.ask_controller(port);
                    Ok(())
                }
                room = room(port, &self.pending) => room.and_then(|()| self.push(port)),
                heard = port.receive() => heard.map(|heard| self.take(heard)),
            };
            if let Err(error) = done {
                return Ended::Lost(error);
            }
        }
    }

    /// `None` where the link was dropped meanwhile.
    async fn open_again(&mut self) -> Option<Port> {
        let mut said = String::new();
        let mut again = interval_at(Instant::now() + AGAIN, AGAIN);
        let mut every = summaries();
        loop {
            tokio::select! {
                biased;
                () = woken(&self.wake) => {
                    let stop = self.obey();
                    self.give_up_pending();
                    if stop {
                        return None;
                    }
                    continue;
                }
                _ = every.tick() => {
                    self.report.sum_up();
                    continue;
                }
                _ = again.tick() => {}
            }
            match self.worker.open() {
                Ok(port) => return Some(port),
                Err(error) => {
                    let error = error.to_string();
                    if error != said {
                        self.report.remark(Severity::Error, format_args!("not there: {error}"));
                        said = error;
                    }
                }
            }
        }
    }

    /// Takes what the loop has given; whether the link was dropped. That is asked before: who sees that it was finds the last set, which was
    /// given before it. Asked afterwards, a set that is given in between would never go out.
    fn obey(&mut self) -> bool {
        let stop = self.worker.orders.stop.load(Acquire);
        self.take_newest();
        stop
    }

    /// The newest set becomes the one that is under way. Of older ones only what it does not say anew is still sent, before it: a change of what is not
    /// said every tick would wait for its next turn otherwise.
    fn take_newest(&mut self) {
        let newest = self.worker.orders.newest.load(Acquire);
        let (mut taken, mut passed_over) = (None, 0);
        self.worker.sets.each(|mut set: Set| {
            let older: Option<Set> = taken.take();
            passed_over += older.map_or(0, |older| set.take_over(older.frames()));
            taken = Some(set);
        });
        let Some(mut set) = taken else { return };
        let under_way = self.pending.take().map(|old| (old.set, old.sent));
        for (older, sent) in under_way.into_iter().chain(self.late.take().map(|late| (late, 0))) {
            passed_over += set.take_over(&older.frames()[sent..]);
        }
        // There was no room for the newest: this one is as old as the queue is long, and the next is soon here.
        if set.number < newest {
            self.late = Some(set);
        } else {
            self.pending = Some(Pending { set, sent: 0, full: None });
        }
        self.count_unsent(passed_over as u64);
    }

    fn give_up_pending(&mut self) {
        let under_way = self.pending.take().map_or(0, |left| left.set.length - left.sent);
        let late = self.late.take().map_or(0, |late| late.length);
        // Of a bus that is known to be off or down nobody needs to be told that nothing is sent.
        self.worker.orders.unsent((under_way + late) as u64);
    }

    fn count_unsent(&mut self, frames: u64) {
        if frames > 0 {
            self.worker.orders.unsent(frames);
            self.report.unsent(frames);
        }
    }

    /// What the system dropped is lost like what the loop does not take. `before`: as it was the last time.
    fn count_dropped(&mut self, port: &Port, before: &mut u32) {
        let now = port.dropped();
        let frames = u64::from(now.wrapping_sub(std::mem::replace(before, now)));
        if frames > 0 {
            self.shared().lost.fetch_add(frames, Relaxed);
            self.report.dropped(frames);
        }
    }

    /// Sends what is under way as far as there is room.
    fn push(&mut self, port: &Port) -> io::Result<()> {
        if self.condition() == Condition::BusOff {
            // Kept, it would be the first to go out after a restart, however old.
            self.give_up_pending();
            return Ok(());
        }
        let Some(pending) = &mut self.pending else { return Ok(()) };
        for frame in &pending.set.frames()[pending.sent..] {
            match port.try_send(frame) {
                Ok(()) => {
                    pending.sent += 1;
                    self.worker.orders.shared.sent.fetch_add(1, Relaxed);
                }
                Err(full) if is_full(&full) => {
                    pending.full = Some(full);
                    return Ok(());
                }
                Err(error) => return Err(error),
            }
        }
        self.pending = None;
        Ok(())
    }

    /// The last words of a link that is dropped.
    async fn finish(&mut self, port: &Port) {
        let all = async {
            self.push(port)?;
            while self.pending.is_some() {
                room(port, &self.pending).await?;
                self.push(port)?;
            }
            Ok(())
        };
        let sent: Result<io::Result<()>, _> = timeout(LAST_SET, all).await;
        match sent {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                self.report.remark(Severity::Error, format_args!("the last commands were not sent: {error}"))
            }
            Err(_) => {
                let ms = LAST_SET.as_millis();
                self.report
                    .remark(Severity::Error, format_args!("the last commands were not sent: no room within {ms} ms"));
            }
        }
        self.give_up_pending();
    }

    fn take(&mut self, heard: Heard) {
        match heard {
            Heard::Frame(frame) => {
                self.shared().received.fetch_add(1, Relaxed);
                if !self.worker.heard.give(frame) {
                    self.shared().lost.fetch_add(1, Relaxed);
                    self.report.lost();
                }
            }
            Heard::Error(error) => self.take_error(error),
        }
    }

    fn take_error(&mut self, error: ErrorFrame) {
        self.shared().errors.fetch_add(1, Relaxed);
        if let Some(counters) = error.counters() {
            self.shared().set_counters(counters);
        }
        // Counters alone don't end a bus-off: that takes a restart.
        let by_counters = || error.condition_of_counters().filter(|_| self.condition() != Condition::BusOff);
        if let Some(condition) = error.condition().or_else(by_counters) {
            self.set_condition(condition, format_args!("{error}"));
        }
        if error.is_problem() {
            self.report.problem(error);
        }
    }

    /// Not every driver tells when a controller has recovered.
    fn ask_controller(&mut self, port: &Port) {
        if self.condition() == Condition::Active {
            return;
        }
        if let Some(controller) = port.controller() {
            if let Some(counters) = controller.error_counters {
                self.shared().set_counters(counters);
            }
            self.set_condition(controller.condition, format_args!("the system says so"));
        }
    }

    fn set_condition(&mut self, condition: Condition, why: std::fmt::Arguments<'_>) {
        if self.shared().set_condition(condition) != condition {
            self.report.changed(condition, why);
        }
    }

    fn condition(&self) -> Condition {
        self.shared().condition()
    }

    fn shared(&self) -> &Shared {
        &self.worker.orders.shared
    }
}

/// When summaries are due; the first one a while from now.
fn summaries() -> Interval {
    let mut every = interval_at(Instant::now() + EVERY, EVERY);
    every.set_missed_tick_behavior(MissedTickBehavior::Skip);
    every
}

/// Waits until the loop has something for the thread.
async fn woken(wake: &AsyncFd<Arc<OwnedFd>>) {
    loop {
        let Ok(mut ready) = wake.readable().await else { return std::future::pending().await };
        // Read or not, it is 0 now: the next write makes it ready anew.
        let read = rustix::io::read(wake.get_ref(), &mut [0; 8][..]);
        ready.clear_ready();
        if read.is_ok() {
            return;
        }
    }
}

/// Waits for room for what is under way; for ever where nothing is.
async fn room(port: &Port, pending: &Option<Pending>) -> io::Result<()> {
    match pending.as_ref().and_then(|pending| pending.full.as_ref()) {
        Some(full) => port.room(full).await,
        None => std::future::pending().await,
    }
}

struct OnDrop<F: FnMut()>(F);

impl<F: FnMut()> Drop for OnDrop<F> {
    fn drop(&mut self) {
        (self.0)();
    }
}
