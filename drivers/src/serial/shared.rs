//! What the loop and the link's thread share.

use super::AmplifierReport;
use rustix::event::{EventfdFlags, eventfd};
use std::io;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// What the loop gives.
#[derive(Clone, Copy)]
pub(super) struct Order {
    pub(super) voltage_v: f64,
    /// `CLOCK_MONOTONIC`, ns.
    pub(super) given_ns: u64,
    /// The connection that the operator has armed; 0 = none.
    pub(super) armed_for: u32,
}

/// What both sides hold.
pub(super) struct Shared {
    /// An eventfd: orders were given, or the thread is to end.
    pub(super) wake: OwnedFd,
    pub(super) stop: AtomicBool,
    /// What of the report must not wait in a queue that nobody reads: connection * 4 + connected * 2 + armed.
    state: AtomicU64,
    heard_ns: AtomicU64,
}

impl Shared {
    pub(super) fn new() -> io::Result<Shared> {
        let wake = eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC)?;
        Ok(Shared { wake, stop: AtomicBool::new(false), state: AtomicU64::new(0), heard_ns: AtomicU64::new(0) })
    }

    /// For [`Shared::renew`].
    pub(super) fn tell(&self, report: &AmplifierReport) {
        let state = u64::from(report.connection) << 2 | u64::from(report.connected) << 1 | u64::from(report.armed);
        self.state.store(state, Ordering::Release);
        self.heard_ns.store(report.heard_ns, Ordering::Release);
    }

    /// Brings a report up to date.
    pub(super) fn renew(&self, report: &mut AmplifierReport) {
        let state = self.state.load(Ordering::Acquire);
        (report.connected, report.armed) = (state & 2 != 0, state & 1 != 0);
        report.connection = (state >> 2) as u32;
        report.heard_ns = self.heard_ns.load(Ordering::Acquire);
    }

    /// One short system call. It can't fail but where the thread has not looked for 2^64 times; then it is awake.
    pub(super) fn wake(&self) {
        let _ = rustix::io::write(&self.wake, &1u64.to_ne_bytes());
    }
}
