//! Requests and their answers.

use super::Shared;
use super::work::in_thread;
use crate::serve::state::Refusal;
use crate::serve::supervisor::{Message, Way};
use axum::body::{Body, Bytes};
use axum::extract::rejection::BytesRejection;
use axum::extract::{Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_LENGTH, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::http::{HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use rt_core::{Confirmation, LinkError, RunCommand, ServiceCommand, send_command};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio_util::io::ReaderStream;

/// For how long the service is armed where nothing else is said, s.
const ARMED_S: f64 = 600.0;
/// The run answers within a tick; a machine under load a little later.
const PATIENCE: Duration = Duration::from_secs(5);
/// Bytes of a recording that are sent at once.
const PIECE: usize = 256 * 1024;
/// A finished run's page is a file of its own with script and style within: it may run them, and reach nothing else.
const PAGE_POLICY: &str = "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; \
                           style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'";

/// A request that was not done.
#[derive(Debug)]
pub struct Refused {
    status: StatusCode,
    refusal: Refusal,
}

impl Refused {
    /// With these words.
    pub fn new(status: StatusCode, error: impl Into<String>, remedy: impl Into<String>) -> Self {
        Refused { status, refusal: Refusal::new(error, remedy) }
    }

    /// For this reason.
    pub fn of(status: StatusCode, refusal: Refusal) -> Self {
        Refused { status, refusal }
    }

    fn not_found(what: &str) -> Self {
        Refused::new(StatusCode::NOT_FOUND, format!("there is no {what}"), "look into the list again")
    }

    fn internal(what: impl std::fmt::Display) -> Self {
        Refused::new(StatusCode::INTERNAL_SERVER_ERROR, what.to_string(), "see the service's log")
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        let Refusal { error, remedy } = self.refusal;
        let body = serde_json::json!({"error": error, "remedy": remedy});
        (self.status, [(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-store")], body.to_string())
            .into_response()
    }
}

type Answer = Result<Response, Refused>;
type Web = State<Arc<Shared>>;
type Sent = Result<Bytes, BytesRejection>;

fn json(body: String) -> Response {
    ([(CONTENT_TYPE, "application/json"), (CACHE_CONTROL, "no-store")], body).into_response()
}

fn as_json(value: &impl Serialize) -> Answer {
    serde_json::to_string(value).map(json).map_err(Refused::internal)
}

fn body<T: DeserializeOwned>(sent: Sent) -> Result<T, Refused> {
    let remedy = "see docs/SERVICE.md";
    let bytes = sent.map_err(|rejection| Refused::new(rejection.status(), rejection.body_text(), remedy))?;
    let bytes: &[u8] = if bytes.is_empty() { b"{}" } else { &bytes };
    serde_json::from_slice(bytes)
        .map_err(|error| Refused::new(StatusCode::BAD_REQUEST, format!("the request's body: {error}"), remedy))
}

/// `GET /state`
pub async fn state(State(shared): Web) -> Response {
    json(shared.web.board.state_json(None))
}

/// `GET /profiles`
pub async fn profiles(State(shared): Web) -> Answer {
    as_json(&shared.web.library.lines())
}

/// `GET /runs`
pub async fn runs(State(shared): Web) -> Answer {
    let finished = Arc::clone(&shared.web.finished);
    let lines = in_thread(move || finished.lines()).await.map_err(Refused::internal)?;
    as_json(&lines.iter().map(AsRef::as_ref).collect::<Vec<_>>())
}

/// `GET /runs/ID`
pub async fn page(State(shared): Web, Path(id): Path<String>) -> Answer {
    let finished = Arc::clone(&shared.web.finished);
    let named = format!("run {id:?}");
    let page = in_thread(move || finished.page(&id)).await.map_err(Refused::internal)?;
    match page {
        None => Err(Refused::not_found(&named)),
        Some(Err(error)) => Err(Refused::internal(error)),
        Some(Ok(page)) => {
            let headers = [
                (CONTENT_TYPE, "text/html; charset=utf-8"),
                (CACHE_CONTROL, "no-store"),
                (CONTENT_SECURITY_POLICY, PAGE_POLICY),
            ];
            Ok((headers, page).into_response())
        }
    }
}

/// `GET /runs/ID/recording`
pub async fn recording(State(shared): Web, Path(id): Path<String>) -> Answer {
    let finished = Arc::clone(&shared.web.finished);
    let named = format!("run {id:?}");
    let opened = in_thread(move || finished.path(&id).map(|path| open(&path))).await.map_err(Refused::internal)?;
    let Some(opened) = opened else { return Err(Refused::not_found(&named)) };
    let (file, length, name) = opened.map_err(Refused::internal)?;
    // A piece is read when the client has taken those before it: one that takes none holds no thread meanwhile.
    let body = Body::from_stream(ReaderStream::with_capacity(tokio::fs::File::from_std(file), PIECE));
    let quoted: String = name.chars().filter(|c| c.is_ascii_graphic() && !matches!(c, '"' | '\\')).collect();
    let disposition =
        HeaderValue::from_str(&format!("attachment; filename=\"{quoted}\"")).map_err(Refused::internal)?;
    let mut response = body.into_response();
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
    headers.insert(CONTENT_LENGTH, HeaderValue::from(length));
    headers.insert(CONTENT_DISPOSITION, disposition);
    Ok(response)
}

/// A file, its length and its name.
fn open(path: &std::path::Path) -> io::Result<(File, u64, String)> {
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    Ok((file, length, path.file_name().unwrap_or_default().to_string_lossy().into_owned()))
}

/// Does a command; answers with the id, or the state.
async fn command(shared: &Shared, command: ServiceCommand) -> Result<Option<u64>, Refused> {
    let gone = || Refused::new(StatusCode::SERVICE_UNAVAILABLE, "the service is about to end", "start it again");
    let absent = matches!(command, ServiceCommand::Unqueue { .. });
    let (reply, answer) = oneshot::channel();
    shared.web.to_supervisor.send(Message::Command(command, Way::Web, reply)).map_err(|_| gone())?;
    let status = if absent { StatusCode::NOT_FOUND } else { StatusCode::CONFLICT };
    answer.await.map_err(|_| gone())?.map_err(|refusal| Refused::of(status, refusal))
}

async fn then_state(shared: &Shared, wanted: ServiceCommand) -> Answer {
    command(shared, wanted).await?;
    Ok(json(shared.web.board.state_json(None)))
}

/// Nothing is to be said.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmBody {
    for_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct QueueBody {
    profile: String,
    seed: Option<u64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ConfirmBody {
    request: Option<u32>,
    volume_ml: Option<f64>,
}

/// `POST /arm`
pub async fn arm(State(shared): Web, sent: Sent) -> Answer {
    let ArmBody { for_s } = body(sent)?;
    then_state(&shared, ServiceCommand::Arm { for_s: for_s.unwrap_or(ARMED_S) }).await
}

/// `POST /disarm`
pub async fn disarm(State(shared): Web, sent: Sent) -> Answer {
    let Nothing {} = body(sent)?;
    then_state(&shared, ServiceCommand::Disarm).await
}

/// `POST /queue`
pub async fn queue(State(shared): Web, sent: Sent) -> Answer {
    let QueueBody { profile, seed } = body(sent)?;
    if shared.web.library.find(&profile).is_none() {
        let remedy = format!("there are {}", shared.web.library.names());
        return Err(Refused::new(StatusCode::NOT_FOUND, format!("there is no profile {profile:?}"), remedy));
    }
    let id = command(&shared, ServiceCommand::Queue { profile, seed: seed.unwrap_or(1) }).await?;
    Ok(json(serde_json::json!({ "id": id }).to_string()))
}

/// `DELETE /queue/ID`
pub async fn unqueue(State(shared): Web, Path(id): Path<String>) -> Answer {
    let id = id.parse().map_err(|_| Refused::not_found(&format!("queued profile {id:?}")))?;
    then_state(&shared, ServiceCommand::Unqueue { id }).await
}

/// `POST /stop`. The body is not looked at: nothing is to keep anybody from stopping.
pub async fn stop(State(shared): Web) -> Answer {
    then_state(&shared, ServiceCommand::Stop).await
}

/// `POST /emergency-stop`. The body is not looked at, either.
pub async fn emergency_stop(State(shared): Web) -> Answer {
    then_state(&shared, ServiceCommand::EmergencyStop).await
}

/// `POST /acknowledge`
pub async fn acknowledge(State(shared): Web, sent: Sent) -> Answer {
    let Nothing {} = body(sent)?;
    then_state(&shared, ServiceCommand::Acknowledge).await
}

/// `POST /confirm`
pub async fn confirm(State(shared): Web, sent: Sent) -> Answer {
    let ConfirmBody { request, volume_ml } = body(sent)?;
    let instance = shared.web.instance.clone();
    let confirm = RunCommand::Confirm(Confirmation { request, volume_ml });
    let sent = in_thread(move || send_command(&instance, confirm, PATIENCE));
    let answer = sent.await.map_err(Refused::internal)?.map_err(|error| {
        let (status, remedy) = match error {
            LinkError::Nobody { .. } => (StatusCode::CONFLICT, "start a run first"),
            _ => (StatusCode::SERVICE_UNAVAILABLE, "try again"),
        };
        Refused::new(status, error.to_string(), remedy)
    })?;
    match answer.taken {
        Ok(tick) => Ok(json(serde_json::json!({ "tick": tick }).to_string())),
        Err(refusal) => {
            Err(Refused::new(StatusCode::CONFLICT, format!("not taken: {refusal}"), "look what is asked for now"))
        }
    }
}

/// No such path.
pub async fn nothing() -> Refused {
    Refused::new(StatusCode::NOT_FOUND, "there is nothing of this name", "see docs/SERVICE.md")
}

/// The path is there, for another method.
pub async fn other_method() -> Refused {
    Refused::new(StatusCode::METHOD_NOT_ALLOWED, "this path is for another method", "see docs/SERVICE.md")
}
