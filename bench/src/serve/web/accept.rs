//! Clients' connections: so many at a time, and none for long that says nothing or takes nothing. Everybody may connect, and an emergency
//! stop needs a connection, too.

use super::live::CLIENTS_MOST;
use axum::Router;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use rustix::net::sockopt::{set_socket_send_buffer_size, set_tcp_user_timeout};
use rustix::process::{Resource, getrlimit};
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

/// A connection says within this time what it wants, and again after each answer; otherwise it is left.
const SAYS_WITHIN: Duration = Duration::from_secs(5);
/// A client that takes nothing of what is due to it for so long is left, ms.
const TAKES_WITHIN_MS: u32 = 60_000;
/// Bytes for a client that lie in the system at most; the system takes twice this.
const SEND_BUFFER: usize = 64 * 1024;
/// Connections at a time, at most; and at least, however few files may be open.
const PLACES_MOST: usize = 256;
const PLACES_LEAST: usize = 16;
/// Until a connection is taken up again after one could not be.
const AGAIN_AFTER: Duration = Duration::from_millis(250);

/// Takes clients up and serves them, for good.
pub async fn clients(listener: TcpListener, router: Router) {
    let places = Arc::new(Semaphore::new(places(getrlimit(Resource::Nofile).current)));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(SAYS_WITHIN);
    loop {
        let (client, address) = match listener.accept().await {
            Ok(taken_up) => taken_up,
            Err(error) => {
                refused(&error).await;
                continue;
            }
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            // Dropped, it is closed.
            tracing::debug!(%address, "too many connections: closed");
            continue;
        };
        if let Err(error) = prepare(&client) {
            tracing::debug!(%error, "options of a client's socket");
        }
        let service = TowerToHyperService::new(router.clone());
        let serving = http.serve_connection(TokioIo::new(client), service).with_upgrades();
        tokio::spawn(async move {
            if let Err(error) = serving.await {
                tracing::debug!(%error, %address, "a client's connection");
            }
            // A live connection goes on elsewhere by now, and has a place of another kind.
            drop(place);
        });
    }
}

/// How many connections at a time, where so many files may be open (`None`: any number). Half of them are for clients: live ones take one
/// each, the others two, the connection and the recording that goes over it. The rest is for the runs and their channels.
fn places(files: Option<u64>) -> usize {
    let files = files.and_then(|files| usize::try_from(files).ok()).unwrap_or(usize::MAX);
    ((files / 2).saturating_sub(CLIENTS_MOST) / 2).clamp(PLACES_LEAST, PLACES_MOST)
}

/// Small frames go out at once, and few of them lie in the system for a client that takes none: what it gets then is not old.
fn prepare(client: &TcpStream) -> io::Result<()> {
    client.set_nodelay(true)?;
    set_socket_send_buffer_size(client, SEND_BUFFER)?;
    // Counts also where the client is there and its window stays shut.
    set_tcp_user_timeout(client, TAKES_WITHIN_MS)?;
    Ok(())
}

/// No connection could be taken up.
async fn refused(error: &io::Error) {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    // The client itself is gone; the next one has nothing to do with it.
    if matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset) {
        return;
    }
    // No file is left, say: it would fail again at once, and a moment later perhaps not.
    tracing::warn!(%error, "no connection can be taken up");
    tokio::time::sleep(AGAIN_AFTER).await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clients_take_half_of_the_files_at_most() {
        for files in [256, 512, 1024, 4096] {
            let all = 2 * places(Some(files)) + CLIENTS_MOST;
            assert!(files / 2 >= all as u64, "{files}: {all}");
        }
        assert_eq!(places(Some(0)), PLACES_LEAST, "some are served anyway");
        assert_eq!((places(Some(1 << 20)), places(None)), (PLACES_MOST, PLACES_MOST));
    }
}
