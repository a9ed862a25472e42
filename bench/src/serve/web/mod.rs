//! The HTTP side: the page, the API, the live connection. See `docs/SERVICE.md`, which is the contract.
//!
//! | module | what |
//! |---|---|
//! | [`guard`] | who may ask what |
//! | [`api`] | requests and their answers |
//! | [`live`] | the WebSocket |
//! | [`assets`] | the page's files |

mod api;
mod assets;
mod guard;
mod live;

use super::board::Board;
use super::finished::Finished;
use super::library::Library;
use super::supervisor::Message;
use super::token::Token;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::{any, delete, get, post};
use axum::serve::ListenerExt;
use guard::Names;
use rustix::net::sockopt::set_socket_send_buffer_size;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;

/// Bytes of a request's body at most.
const BODY_MOST: usize = 16 * 1024;
/// Bytes for a client that lie in the system at most; the system takes twice this.
const SEND_BUFFER: usize = 64 * 1024;
/// Between two signs of life.
const BEAT: Duration = Duration::from_millis(250);

/// What the HTTP side needs.
pub struct Web {
    /// Where everything stands.
    pub board: Arc<Board>,
    /// The profiles.
    pub library: Arc<Library>,
    /// Finished runs.
    pub finished: Arc<Finished>,
    /// Of who may command; `None`: nobody may.
    pub token: Option<Arc<Token>>,
    /// The supervision of the runs.
    pub to_supervisor: Sender<Message>,
    /// Under which runs are published.
    pub instance: String,
    /// Further names of the service.
    pub hosts: Vec<String>,
    /// Set when the service ends.
    pub over: Arc<AtomicBool>,
}

/// What every request sees.
struct Shared {
    web: Web,
    names: Names,
    live_clients: AtomicUsize,
}

/// Serves until the service is over. To be called in a thread of its own: all clients share it, and none of them can take
/// a processor from the loop for long.
///
/// # Errors
/// The port can't be served.
pub fn serve(web: Web, listener: TcpListener, address: SocketAddr) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        // For recordings that are read; one at a time leaves the processors to the runs.
        .max_blocking_threads(2)
        .build()?;
    runtime.block_on(async move {
        listener.set_nonblocking(true)?;
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let over = Arc::clone(&web.over);
        let board = Arc::clone(&web.board);
        let names = Names::new(address, &web.hosts);
        let shared = Arc::new(Shared { web, names, live_clients: AtomicUsize::new(0) });
        tokio::spawn(beat(board));
        let ended = async move {
            while !over.load(Ordering::Relaxed) {
                tokio::time::sleep(BEAT).await;
            }
        };
        // Small frames go out at once, and few of them lie in the system for a client that takes none: what it gets then is not old.
        let listener = listener.tap_io(|client| {
            let set = client.set_nodelay(true);
            let set = set.and_then(|()| Ok(set_socket_send_buffer_size(&*client, SEND_BUFFER)?));
            if let Err(error) = set {
                tracing::debug!(%error, "options of a client's socket");
            }
        });
        let serving = axum::serve(listener, router(shared));
        tokio::select! {
            outcome = async { serving.await } => outcome,
            () = ended => Ok(()),
        }
    })
}

async fn beat(board: Arc<Board>) {
    loop {
        board.web_beat.beat();
        tokio::time::sleep(BEAT).await;
    }
}

fn router(shared: Arc<Shared>) -> Router {
    let api = Router::new()
        .route("/state", get(api::state))
        .route("/profiles", get(api::profiles))
        .route("/runs", get(api::runs))
        .route("/runs/{id}", get(api::page))
        .route("/runs/{id}/recording", get(api::recording))
        .route("/arm", post(api::arm))
        .route("/disarm", post(api::disarm))
        .route("/queue", post(api::queue))
        .route("/queue/{id}", delete(api::unqueue))
        .route("/stop", post(api::stop))
        .route("/emergency-stop", post(api::emergency_stop))
        .route("/acknowledge", post(api::acknowledge))
        .route("/confirm", post(api::confirm))
        .route("/live", any(live::upgrade))
        .fallback(api::nothing)
        .method_not_allowed_fallback(api::other_method);
    Router::new()
        .nest("/api/v1", api)
        .fallback(assets::serve)
        .layer(DefaultBodyLimit::max(BODY_MOST))
        .layer(from_fn_with_state(Arc::clone(&shared), guard::check))
        .layer(from_fn(guard::headers))
        .with_state(shared)
}
