//! Descriptors that tokio waits for.

use std::io;
use std::os::fd::{AsFd, AsRawFd};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// A descriptor of which the runtime in which this is called waits for something to read. `T` owns it: socket, eventfd, or a share of one.
///
/// Not for room to write, too: a socket says that it has some whenever what it sent was read, or has left, and each time wakes the thread
/// for nothing.
pub(super) fn polled<T: AsFd + AsRawFd + 'static>(descriptor: T) -> io::Result<AsyncFd<T>> {
    register(descriptor, Interest::READABLE)
}

/// Waits until there is room to write. To be called where there was none: it takes two system calls more than the wait.
pub(super) async fn room(socket: impl AsFd) -> io::Result<()> {
    let share = socket.as_fd().try_clone_to_owned()?;
    register(share, Interest::WRITABLE)?.writable().await?.retain_ready();
    Ok(())
}

fn register<T: AsFd + AsRawFd + 'static>(descriptor: T, interest: Interest) -> io::Result<AsyncFd<T>> {
    // SAFETY: what is given in this crate (CanSocket, OwnedFd, Arc<OwnedFd>) owns its descriptor: it says the same one as long as it
    // lives, and that one stays open.
    unsafe { AsyncFd::register_with_interest(descriptor, interest) }.map_err(Into::into)
}
