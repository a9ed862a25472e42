//! Frames that the system dropped because a socket's receive buffer was full.

use std::io;
use std::mem::size_of_val;
use std::os::fd::{AsFd, AsRawFd};

/// `SK_MEMINFO_VARS` and the place of `SK_MEMINFO_DROPS` (linux/sock_diag.h).
const VARIABLES: usize = 9;
const DROPS: usize = 8;

/// How many the kernel dropped so far; it wraps. It is asked now and then: with each frame (`SO_RXQ_OVFL`) it would cost more and say no more.
///
/// # Errors
/// The kernel is older than 4.12, or this is no socket.
pub(super) fn dropped(socket: impl AsFd) -> io::Result<u32> {
    let mut variables = [0u32; VARIABLES];
    let mut length = size_of_val(&variables) as libc::socklen_t;
    // SAFETY: the descriptor is borrowed for the call; `length` says how many bytes there are at `variables`.
    let refused = unsafe {
        libc::getsockopt(
            socket.as_fd().as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_MEMINFO,
            variables.as_mut_ptr().cast(),
            &raw mut length,
        )
    };
    if refused == 0 { Ok(variables[DROPS]) } else { Err(io::Error::last_os_error()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::UdpSocket;

    #[test]
    fn what_a_full_buffer_drops_is_counted() {
        let receiver = UdpSocket::bind("127.0.0.1:0").expect("loopback");
        let sender = UdpSocket::bind("127.0.0.1:0").expect("loopback");
        receiver.set_nonblocking(true).expect("a socket");
        assert_eq!(dropped(&receiver).ok(), Some(0));
        let to = receiver.local_addr().expect("it is bound");
        let sent: u32 = 20_000;
        for _ in 0..sent {
            sender.send_to(&[0; 16], to).expect("loopback takes all");
        }
        let mut received = 0;
        while receiver.recv(&mut [0; 16]).is_ok() {
            received += 1;
        }
        let lost = dropped(&receiver).expect("as before");
        assert!(lost > 0 && received + lost == sent, "{received} received, {lost} lost of {sent}");
    }
}
