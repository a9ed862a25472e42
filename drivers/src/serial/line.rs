//! The port and the bytes that wait for room in it: written as one piece or thrown away, and opened again when it is gone.
//!
//! Invariant: nothing is put in while older bytes still wait, so that what is written next is the newest command and never a queue of
//! old ones.

use super::talk::MS;
use super::{LinkError, port};
use crate::amplifier::{AmplifierSettings, Outbox, Traffic};
use std::io;
use std::path::PathBuf;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, sleep};
use tokio_serial::{ClearBuffer, SerialPort, SerialStream};

/// Bytes that find no room for so long are thrown away.
const BLOCKED_NS: u64 = 20 * MS;
/// A port that is gone is opened again so often.
const REOPEN_NS: u64 = 200 * MS;
/// Longest that the last 0 V may take.
pub(super) const LAST_WORDS: Duration = Duration::from_millis(120);
/// Between two looks whether they have left.
const POLL: Duration = Duration::from_millis(2);

/// The line to the amplifier.
pub(super) struct Line {
    port: PathBuf,
    baud: u32,
    /// `None` while it is gone.
    stream: Option<SerialStream>,
    /// Bytes that wait for room.
    out: Outbox,
    /// Since when they wait, `CLOCK_MONOTONIC`, ns; `None` = none do.
    blocked_ns: Option<u64>,
    /// When it was opened or lost, or opening it was tried, last.
    opened_ns: u64,
    /// Bytes that may wait in the driver's queue before another command is written.
    longest_queue: u32,
    /// That the port is there and can't be opened was told.
    told_refusal: bool,
}

/// What the line did; several at once.
#[derive(Default)]
pub(super) struct Passed {
    /// Bytes that came.
    pub(super) heard: usize,
    /// Bytes that left.
    pub(super) wrote: usize,
    pub(super) broken: Option<io::Error>,
}

impl Passed {
    pub(super) fn is_nothing(&self) -> bool {
        self.heard == 0 && self.wrote == 0 && self.broken.is_none()
    }
}

impl Line {
    pub(super) fn new(settings: &AmplifierSettings, traffic: &Traffic, stream: SerialStream, now: u64) -> Line {
        let one = (traffic.command.out + traffic.request.out) as u32;
        Line {
            port: settings.port.clone(),
            baud: settings.baud,
            stream: Some(stream),
            out: Outbox::new(),
            blocked_ns: None,
            opened_ns: now,
            // What the port sends in 2 ms at 10 bits a byte, and at least two commands.
            longest_queue: (settings.baud / 5000).max(2 * one),
            told_refusal: false,
        }
    }

    pub(super) fn is_open(&self) -> bool {
        self.stream.is_some()
    }

    /// Reads into `bytes`, and writes what waits.
    pub(super) fn poll(&mut self, cx: &mut Context<'_>, bytes: &mut [u8]) -> Passed {
        let mut passed = Passed::default();
        let Some(stream) = &mut self.stream else { return passed };
        let mut buffer = ReadBuf::new(bytes);
        match Pin::new(&mut *stream).poll_read(cx, &mut buffer) {
            Poll::Ready(Ok(())) if buffer.filled().is_empty() => {
                passed.broken = Some(io::Error::new(io::ErrorKind::UnexpectedEof, "hung up"));
            }
            Poll::Ready(Ok(())) => passed.heard = buffer.filled().len(),
            Poll::Ready(Err(e)) => passed.broken = Some(e),
            Poll::Pending => {}
        }
        if !self.out.is_empty() && passed.broken.is_none() {
            match Pin::new(stream).poll_write(cx, self.out.bytes()) {
                Poll::Ready(Ok(wrote)) => passed.wrote = wrote,
                Poll::Ready(Err(e)) => passed.broken = Some(e),
                Poll::Pending => {}
            }
        }
        passed
    }

    /// The port took bytes.
    pub(super) fn wrote(&mut self, bytes: usize, now: u64) {
        self.out.written(bytes);
        if self.out.is_empty() {
            self.blocked_ns = None;
        } else if bytes > 0 || self.blocked_ns.is_none() {
            self.blocked_ns = Some(now);
        }
    }

    /// Where the next bytes may be put: nothing waits here, and little in the driver's queue.
    pub(super) fn room(&mut self) -> Option<&mut Outbox> {
        let stream = self.stream.as_ref().filter(|_| self.out.is_empty())?;
        // A pty does not say how much waits, and always says 0.
        let long = stream.bytes_to_write().is_ok_and(|waiting| waiting > self.longest_queue);
        (!long).then_some(&mut self.out)
    }

    /// Writes what was put in.
    pub(super) fn write(&mut self, now: u64) -> io::Result<()> {
        let Some(stream) = &mut self.stream else { return Ok(()) };
        // Without asking first whether there is room: nearly always there is.
        match stream.try_write(self.out.bytes()) {
            Ok(wrote) => self.wrote(wrote, now),
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => self.wrote(0, now),
            Err(e) => return Err(e),
        }
        Ok(())
    }

    /// What has not left yet must not leave later.
    pub(super) fn forget_output(&mut self) {
        self.out.clear();
        self.blocked_ns = None;
        if let Some(stream) = &self.stream {
            // A port that refuses is about to be found broken.
            let _ = stream.clear(ClearBuffer::Output);
        }
    }

    /// Bytes that found no room for too long are thrown away.
    pub(super) fn forget_blocked(&mut self, now: u64) {
        if self.blocked_ns.is_some_and(|since| now.saturating_sub(since) > BLOCKED_NS) {
            // A command among them would be old when it leaves. The other side finds the next frame's beginning by itself.
            self.forget_output();
        }
    }

    /// The port is gone.
    pub(super) fn lose(&mut self, now: u64) {
        self.forget_output();
        (self.stream, self.told_refusal, self.opened_ns) = (None, false, now);
    }

    /// Opens the port again, if it is time. `None` = still gone, and nothing new to tell.
    pub(super) fn reopen(&mut self, now: u64) -> Option<Result<(), LinkError>> {
        if now.saturating_sub(self.opened_ns) < REOPEN_NS {
            return None;
        }
        self.opened_ns = now;
        match port::open(&self.port, self.baud) {
            Ok(stream) => {
                self.stream = Some(stream);
                Some(Ok(()))
            }
            Err(LinkError::NoSuchPort { .. }) => None,
            // udev may still be at work, so it is tried again all the same.
            Err(e) => (!std::mem::replace(&mut self.told_refusal, true)).then_some(Err(e)),
        }
    }

    /// When it is to be looked at, where that is all there is to wait for.
    pub(super) fn deadline_ns(&self) -> Option<u64> {
        match self.stream {
            None => Some(self.opened_ns + REOPEN_NS),
            Some(_) => self.blocked_ns.map(|since| since + BLOCKED_NS + 1),
        }
    }

    /// Writes the last words, waiting a little for them to leave.
    pub(super) async fn finish(mut self, say: impl FnOnce(&mut Outbox)) {
        let end = Instant::now() + LAST_WORDS;
        if self.blocked_ns.is_some() {
            self.forget_output();
        }
        say(&mut self.out);
        let Some(stream) = &mut self.stream else { return };
        while !self.out.is_empty() && Instant::now() < end {
            match stream.try_write(self.out.bytes()) {
                Ok(wrote) => self.out.written(wrote),
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => sleep(POLL).await,
                Err(_) => return,
            }
        }
        // Not tcdrain(3): it waits for ever where the port is stuck.
        while stream.bytes_to_write().is_ok_and(|waiting| waiting > 0) && Instant::now() < end {
            sleep(POLL).await;
        }
        if Instant::now() >= end {
            // Or closing it waits for what does not leave, 30 s as a rule.
            let _ = stream.clear(ClearBuffer::Output);
        }
    }
}
