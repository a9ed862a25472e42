//! Descriptors that tokio waits for.

use std::io;
use std::os::fd::{AsFd, AsRawFd};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// A descriptor that is waited for by the runtime in which this is called. `T` owns it: socket, eventfd, or a share of one.
pub(super) fn polled<T: AsFd + AsRawFd + 'static>(descriptor: T, interest: Interest) -> io::Result<AsyncFd<T>> {
    // SAFETY: what is given in this crate (CanSocket, OwnedFd, Arc<OwnedFd>) owns its descriptor: it says the same one as long as it
    // lives, and that one stays open.
    unsafe { AsyncFd::register_with_interest(descriptor, interest) }.map_err(Into::into)
}
