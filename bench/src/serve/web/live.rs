//! The live connection: what is new to each client, when the client can take it. Nobody is waited for.

use super::Shared;
use super::api::Refused;
use crate::serve::buckets::{CHANNELS, TICKS};
use crate::serve::stream::{Cursor, HISTORY_S};
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::time::{MissedTickBehavior, interval, timeout};

/// Clients at a time.
pub const CLIENTS_MOST: usize = 64;
/// Between two states.
const STATE_EVERY: Duration = Duration::from_millis(100);
/// A client that takes nothing for so long is left.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes of what a client says at most; it is not read.
const SAID_MOST: usize = 4096;
/// Bytes for a client that lie in this process at most, but for one frame.
const BUFFER: usize = 64 * 1024;

/// `GET /live`
pub async fn upgrade(
    State(shared): State<Arc<Shared>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(rejection) => {
            let remedy = "open it as a WebSocket";
            return Refused::new(rejection.status(), rejection.body_text(), remedy).into_response();
        }
    };
    if shared.live_clients.fetch_add(1, Ordering::Relaxed) >= CLIENTS_MOST {
        shared.live_clients.fetch_sub(1, Ordering::Relaxed);
        let error = format!("{CLIENTS_MOST} clients are connected already");
        return Refused::new(StatusCode::SERVICE_UNAVAILABLE, error, "close some").into_response();
    }
    let place = Place(shared);
    upgrade.write_buffer_size(BUFFER).max_message_size(SAID_MOST).max_frame_size(SAID_MOST).on_upgrade(move |socket| {
        async move {
            // A client that is gone needs no answer.
            let _ = talk(socket, &place.0).await;
            drop(place);
        }
    })
}

/// A client's place among those that are allowed.
struct Place(Arc<Shared>);

impl Drop for Place {
    fn drop(&mut self) {
        self.0.live_clients.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The client is gone, or takes nothing.
struct Gone;

#[derive(Serialize)]
struct Typed<'a, T: Serialize> {
    #[serde(rename = "type")]
    kind: &'static str,
    #[serde(flatten)]
    content: &'a T,
}

async fn send(socket: &mut WebSocket, message: Message) -> Result<(), Gone> {
    match timeout(PATIENCE, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(Gone),
    }
}

async fn tell(socket: &mut WebSocket, kind: &'static str, content: &impl Serialize) -> Result<(), Gone> {
    let text = serde_json::to_string(&Typed { kind, content }).expect("names and numbers always have a JSON form");
    send(socket, Message::text(text)).await
}

async fn talk(mut socket: WebSocket, shared: &Shared) -> Result<(), Gone> {
    let board = &shared.web.board;
    let hello = json!({"api": 1, "ticks_per_bucket": TICKS, "history_s": HISTORY_S, "channels": CHANNELS});
    tell(&mut socket, "hello", &hello).await?;
    let (mut changes, mut frames) = (board.changes(), board.frames());
    let mut clock = interval(STATE_EVERY);
    clock.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut cursor, mut told, mut timed) = (Cursor::default(), 0, None);
    frames.mark_changed();
    loop {
        let (mut state, mut buckets) = (false, false);
        tokio::select! {
            said = socket.recv() => match said {
                // What a client says has no effect; pings are answered below this.
                Some(Ok(Message::Close(_)) | Err(_)) | None => return Err(Gone),
                Some(Ok(_)) => {}
            },
            changed = changes.changed() => state = changed.is_ok(),
            _ = clock.tick() => state = true,
            changed = frames.changed() => buckets = changed.is_ok(),
        }
        if state {
            send(&mut socket, Message::text(board.state_json(Some("state")))).await?;
            for event in board.events_since(told) {
                told = event.number;
                tell(&mut socket, "event", &*event).await?;
            }
            let timing = board.watched(|watched| watched.timing.clone());
            if timing.is_some() && timing != timed {
                timed = timing;
                tell(&mut socket, "timing", &timed).await?;
            }
        }
        if buckets {
            let parcel = board.next(&mut cursor);
            if let Some(begin) = &parcel.begin {
                tell(&mut socket, "begin", begin).await?;
            }
            if !parcel.bytes.is_empty() {
                send(&mut socket, Message::Binary(parcel.bytes)).await?;
            }
        }
    }
}
