//! The HTTP side: the page, the API, the live connection. See `docs/SERVICE.md`, which is the contract.
//!
//! | module | what |
//! |---|---|
//! | [`accept`] | clients' connections |
//! | [`guard`] | who may ask what |
//! | [`api`] | requests and their answers |
//! | [`work`] | what takes a thread for a while |
//! | [`live`] | the WebSocket |
//! | [`assets`] | the page's files |

mod accept;
mod api;
mod assets;
mod guard;
mod live;
mod work;

use super::board::Board;
use super::finished::Finished;
use super::library::Library;
use super::supervisor::Message;
use super::token::Token;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::{any, delete, get, post};
use guard::Names;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;

/// Bytes of a request's body at most.
const BODY_MOST: usize = 16 * 1024;
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
        // For recordings that are read; few at a time leave the processors to the runs. No client may hold one of them: who takes
        // nothing would keep the others from confirming.
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
        tokio::select! {
            () = accept::clients(listener, router(shared)) => {}
            () = ended => {}
        }
        Ok(())
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
