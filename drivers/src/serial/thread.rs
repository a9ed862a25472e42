//! The thread that owns the port. It sleeps in one place and is woken by the loop's commands, by bytes, by room for bytes and by its
//! deadlines; what is to be said and done then, [`Talk`] and [`Line`] know.

use super::hello;
use super::line::{Line, Passed};
use super::shared::{Order, Shared};
use super::talk::{MS, Talk};
use super::{AmplifierReport, LinkError};
use crate::amplifier::{AmplifierSettings, Firmware, Protocol};
use crate::exchange::{Giver, Taker};
use crate::journal::{Journal, Severity};
use crate::telemetry::TelemetryLog;
use rt_core::system::time::monotonic_ns;
use std::future::{Future, poll_fn};
use std::io;
use std::os::fd::OwnedFd;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::SyncSender;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::unix::AsyncFd;
use tokio::time::{Instant, Sleep, sleep};

/// The thread's ends of what it shares with the loop.
pub(super) struct Ends {
    pub(super) orders: Taker<Order>,
    pub(super) reports: Giver<AmplifierReport>,
    pub(super) log: TelemetryLog,
    pub(super) shared: Arc<Shared>,
}

/// Opens the port, says how that went, and serves it until it is told to stop.
pub(super) fn run(
    settings: AmplifierSettings,
    mut protocol: Box<dyn Protocol>,
    ends: Ends,
    journal: Journal,
    opened: &SyncSender<Result<(Firmware, AmplifierReport), LinkError>>,
) {
    let system = |doing| move |source| LinkError::System { doing, source };
    let served = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build();
    let served = served.map_err(system("the serial thread's runtime")).and_then(|runtime| {
        runtime.block_on(async {
            let shared = ends.shared.clone();
            let watched = system("watching the serial thread's eventfd");
            let wake = shared.wake.try_clone().map_err(&watched)?;
            // SAFETY: an OwnedFd stays open, and its number the same, for as long as it is owned.
            let wake = unsafe { AsyncFd::register(wake) }.map_err(|e| watched(e.into()))?;
            let (stream, firmware) = hello::connect(&settings, &mut *protocol).await?;
            let now = monotonic_ns();
            let line = Line::new(&settings, &protocol.traffic(), stream, now);
            let mut server = Server { line, talk: Talk::new(settings, protocol, journal, now), ends };
            // Nobody waits for it any more only if the opener's thread has ended: then `stop` comes, too.
            server.tell();
            let _ = opened.send(Ok((firmware, server.talk.report)));
            server.serve(&wake).await;
            let Server { line, mut talk, .. } = server;
            line.finish(|out| talk.last_words(out)).await;
            Ok(())
        })
    });
    if let Err(e) = served {
        let _ = opened.send(Err(e));
    }
}

/// Line and talk, and what the loop is told.
struct Server {
    line: Line,
    talk: Talk,
    ends: Ends,
}

/// What a sleep ended with; several at once.
#[derive(Default)]
struct Round {
    line: Passed,
    woken: bool,
    time: bool,
}

impl Server {
    async fn serve(&mut self, wake: &AsyncFd<OwnedFd>) {
        let mut bytes = [0; 1024];
        let mut alarm = std::pin::pin!(sleep(Duration::ZERO));
        let mut alarm_ns = 0;
        while !self.ends.shared.stop.load(Ordering::Acquire) {
            let round = poll_fn(|cx| self.poll(cx, wake, &mut bytes, alarm.as_mut())).await;
            let now = monotonic_ns();
            if let Some(e) = round.line.broken {
                self.port_gone(&e, now);
            } else {
                self.talk.hear(&bytes[..round.line.heard], now, &mut self.ends.log);
                self.line.wrote(round.line.wrote, now);
            }
            if round.woken
                && let Some(order) = self.ends.orders.newest()
            {
                self.talk.obey(order, now);
            }
            self.look(now);
            self.write(now);
            self.tell();
            // A timer that is too early is cheaper than one that is set anew with each command.
            let deadline_ns = self.deadline_ns(now);
            if round.time || deadline_ns < alarm_ns {
                alarm_ns = deadline_ns;
                alarm.as_mut().reset(Instant::now() + Duration::from_nanos(deadline_ns.saturating_sub(now)));
            }
        }
    }

    /// Everything that may have happened is looked at in each round, so that no flood of one keeps another waiting.
    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        wake: &AsyncFd<OwnedFd>,
        bytes: &mut [u8],
        alarm: Pin<&mut Sleep>,
    ) -> Poll<Round> {
        let mut round = Round { time: alarm.poll(cx).is_ready(), ..Round::default() };
        while let Poll::Ready(Ok(mut ready)) = wake.poll_read_ready(cx) {
            // Read or not, it is 0 now: the next write makes it ready anew.
            let mut count = [0; 8];
            round.woken |= rustix::io::read(wake.get_ref(), &mut count[..]).is_ok();
            ready.clear_ready();
        }
        round.line = self.line.poll(cx, bytes);
        let nothing = !round.time && !round.woken && round.line.is_nothing();
        if nothing { Poll::Pending } else { Poll::Ready(round) }
    }

    fn port_gone(&mut self, e: &io::Error, now: u64) {
        self.talk.port_gone(e, now);
        self.line.lose(now);
    }

    /// What the time asks for.
    fn look(&mut self, now: u64) {
        if self.talk.look(now, self.line.is_open()) {
            self.line.forget_output();
        }
        if self.line.is_open() {
            return self.line.forget_blocked(now);
        }
        match self.line.reopen(now) {
            Some(Ok(())) => self.talk.port_opened(),
            Some(Err(e)) => self.talk.note(now, Severity::Warning, format_args!("{e}")),
            None => {}
        }
    }

    /// Writes what is due.
    fn write(&mut self, now: u64) {
        if !self.talk.is_due() {
            return;
        }
        let Some(out) = self.line.room() else { return };
        self.talk.say(now, out);
        if let Err(e) = self.line.write(now) {
            self.port_gone(&e, now);
        }
    }

    /// When there is something to do at the latest.
    fn deadline_ns(&self, now: u64) -> u64 {
        let deadline_ns = self.line.deadline_ns().unwrap_or_else(|| self.talk.deadline_ns(now));
        // Whatever the sums say, this thread does not spin.
        deadline_ns.min(self.talk.look_again_ns(now)).max(now + MS)
    }

    /// Hands the report over; where the loop does not take it, later.
    fn tell(&mut self) {
        if self.talk.untold {
            self.ends.shared.tell(&self.talk.report);
            self.talk.untold = !self.ends.reports.give(self.talk.report);
        }
    }
}
