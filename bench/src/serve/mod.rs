//! The long-running service: queue, states, runs as processes of their own, live data for browsers, commands over HTTP and shared
//! memory. Described in `docs/SERVICE.md`.
//!
//! | module | what | thread |
//! |---|---|---|
//! | [`supervisor`] | commands, starts and ends of runs | the process's first |
//! | [`state`] | states and queue, pure | |
//! | [`process`] | a run as a process | |
//! | [`monitor`] | follows the samples, makes buckets of them | `samples` |
//! | [`buckets`], [`stream`], [`lateness`] | what clients get of them | |
//! | [`described`] | what a run is | |
//! | [`people`] | what a run asks people for | `people` |
//! | [`line`] | stops to the run, over a channel that is kept open | `line` |
//! | [`channel`] | commands over shared memory | `channel` |
//! | [`web`] | HTTP | `web` |
//! | [`board`] | what the threads know of each other | |
//! | [`view`], [`event_log`] | what clients are told | |
//! | [`library`], [`finished`] | profiles, finished runs | |
//! | [`token`], [`notify`] | who may command; signs of life for the service manager | |

pub mod board;
pub mod buckets;
pub mod channel;
pub mod described;
pub mod event_log;
pub mod finished;
pub mod lateness;
pub mod library;
pub mod line;
pub mod monitor;
pub mod notify;
pub mod people;
pub mod process;
pub mod state;
pub mod stream;
pub mod supervisor;
pub mod token;
pub mod view;
pub mod web;

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::rig_file::{DeviceSpec, Rig};
use crate::{interrupt, machine};
use board::Board;
use event_log::{Severity, utc_now};
use finished::Finished;
use library::Library;
use notify::Notifier;
use process::Common;
use profiles::Hands;
use std::ffi::OsString;
use std::net::{SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use supervisor::{Message, Supervisor};
use token::Token;
use web::Web;

/// Longest wait for the threads at the end.
const LEAVE_WITHIN: Duration = Duration::from_secs(3);

/// What the service is to be.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Rig file; `None`: the emulated rig.
    pub rig: Option<PathBuf>,
    /// Folder of scripts.
    pub profiles: Option<PathBuf>,
    /// Folder of recordings.
    pub data: PathBuf,
    /// Where to listen.
    pub listen: SocketAddr,
    /// Other machines may reach it.
    pub allow_remote: bool,
    /// Further names of the service.
    pub hosts: Vec<String>,
    /// Under which runs are published.
    pub instance: String,
    /// It takes commands.
    pub control: bool,
    /// Where the token is.
    pub token_file: Option<PathBuf>,
    /// Further options of the runs.
    pub run_options: Vec<OsString>,
}

/// Runs the service until it is told to end.
///
/// # Errors
/// A rig file, a script, an address or a token that is wrong (2), a port or an instance in use (4), a run that was cut short by the
/// service's end (130).
pub fn serve(settings: Settings, progress: &Progress) -> Result<(), Failure> {
    let rig = Rig::read(settings.rig.as_deref())?;
    let library = Arc::new(Library::read(settings.profiles.as_deref())?);
    let (listener, address) = listen(&settings)?;
    let given = settings.token_file.as_deref().filter(|_| settings.control).map(Token::read).transpose()?;
    let (switches, _driving) = interrupt::driving()?;
    let board = Arc::new(Board::new(service_view(&rig, &settings), Arc::default()));
    let over = Arc::new(AtomicBool::new(false));
    let (to_supervisor, messages) = mpsc::channel();

    let (line, orders) = mpsc::channel();
    let mut threads = Threads(Vec::new());
    threads.start_channel(&settings, &board, &over, &to_supervisor)?;
    // Now that no other service serves this instance: its token's file would be replaced.
    let drawn = (settings.control && given.is_none()).then(|| Token::draw(&settings.instance)).transpose()?;
    let token = given.or(drawn).map(Arc::new);
    threads.start(&settings, &board, &over, &to_supervisor, orders, {
        let web = Web {
            board: Arc::clone(&board),
            library: Arc::clone(&library),
            finished: Arc::new(Finished::of(&settings.data)),
            token: token.clone(),
            to_supervisor: to_supervisor.clone(),
            instance: settings.instance.clone(),
            hosts: settings.hosts.clone(),
            over: Arc::clone(&over),
        };
        (web, listener, address)
    })?;
    let mut notifier = Notifier::default();
    announce(address, token.as_deref(), progress);
    board.note(Severity::Info, "service", "the service begins", None);
    notifier.ready(&format!("listening on {address}"));

    let supervisor = Supervisor {
        common: Common {
            rig: settings.rig.clone(),
            instance: settings.instance.clone(),
            options: settings.run_options.clone(),
        },
        data: settings.data.clone(),
        u_max_v: rig.facts.u_max_v,
        hands: hands(&rig),
        library,
        board,
        messages,
        line,
    };
    let cut_short = supervisor.work(&switches.stop, &mut notifier);
    over.store(true, Ordering::Relaxed);
    threads.join();
    if cut_short {
        let message =
            "the service was ended while a run was under way; the run was stopped, and its outputs are zeroed";
        return Err(Failure::new(Kind::Interrupted, message));
    }
    Ok(())
}

fn listen(settings: &Settings) -> Result<(TcpListener, SocketAddr), Failure> {
    let Settings { listen, allow_remote, .. } = settings;
    if !listen.ip().is_loopback() && !allow_remote {
        let message = format!(
            "--listen {listen}: other machines could reach this address, and there is no encryption; add --allow-remote if \
             that is meant, or listen on 127.0.0.1 and use an SSH tunnel"
        );
        return Err(Failure::new(Kind::Input, message));
    }
    let failed = |error: std::io::Error| {
        Failure::new(Kind::Device, format!("--listen {listen}: {error}; choose another port, 0 for any free one"))
    };
    let listener = TcpListener::bind(listen).map_err(failed)?;
    let address = listener.local_addr().map_err(failed)?;
    Ok((listener, address))
}

fn service_view(rig: &Rig, settings: &Settings) -> view::Service {
    view::Service {
        state: rt_core::ServiceState::Idle.as_str(),
        instance: settings.instance.clone(),
        version: machine::program(),
        rig: rig.name.clone(),
        device: if matches!(rig.device, DeviceSpec::Emulated(_)) { "emulated" } else { "wired" },
        control: settings.control,
        started_utc: utc_now(),
        armed_left_s: None,
        trip: None,
        limits: (&rig.limits).into(),
    }
}

/// Who will do the operator's part, as far as the rig file tells.
fn hands(rig: &Rig) -> Hands {
    match &rig.device {
        DeviceSpec::Emulated(_) => Hands::Rig,
        DeviceSpec::Wired(settings) if settings.can.fixture.is_some() => Hands::Rig,
        DeviceSpec::Wired(_) => Hands::People,
    }
}

fn announce(address: SocketAddr, token: Option<&Token>, progress: &Progress) {
    // An address that stands for all of this machine's is called by the loopback's.
    let called =
        if address.ip().is_unspecified() { SocketAddr::from(([127, 0, 0, 1], address.port())) } else { address };
    progress.result(&format!("listening on http://{address}/"));
    match token {
        None => progress.result("read-only: --control takes commands"),
        Some(token) => {
            progress.result(&format!("token: {}", token.file.display()));
            // A journal is kept, and read by others.
            if std::env::var_os("JOURNAL_STREAM").is_none() {
                progress.result(&format!("open http://{called}/#token={}", token.reveal()));
            }
        }
    }
}

/// The threads beside the supervision.
struct Threads(Vec<JoinHandle<()>>);

impl Threads {
    fn spawn(&mut self, name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), Failure> {
        let thread = thread::Builder::new().name(name.to_owned()).spawn(work);
        self.0.push(thread.map_err(|error| Failure::new(Kind::Internal, format!("thread {name:?}: {error}")))?);
        Ok(())
    }

    /// First: who else serves this instance is found out before anything else is begun.
    fn start_channel(
        &mut self,
        settings: &Settings,
        board: &Arc<Board>,
        over: &Arc<AtomicBool>,
        to_supervisor: &mpsc::Sender<Message>,
    ) -> Result<(), Failure> {
        let (ready, is_ready) = mpsc::channel();
        let (instance, to) = (settings.instance.clone(), to_supervisor.clone());
        let (board, over) = (Arc::clone(board), Arc::clone(over));
        self.spawn("channel", move || {
            channel::serve(&instance, &board, &to, &over, |outcome| drop(ready.send(outcome)));
        })?;
        let served =
            is_ready.recv().map_err(|_| Failure::new(Kind::Internal, "thread \"channel\" ended at its start"))?;
        served.map_err(|error| Failure::of(Kind::Device, &error))
    }

    fn start(
        &mut self,
        settings: &Settings,
        board: &Arc<Board>,
        over: &Arc<AtomicBool>,
        to_supervisor: &mpsc::Sender<Message>,
        orders: mpsc::Receiver<line::Order>,
        (web, listener, address): (Web, TcpListener, SocketAddr),
    ) -> Result<(), Failure> {
        let parts = || (settings.instance.clone(), Arc::clone(board), Arc::clone(over), to_supervisor.clone());

        let (instance, board_there, over_there, to) = parts();
        let control = settings.control;
        let trip_seen = move |held| {
            // A service that starts nothing has nothing to hold. A supervision that is gone needs no word.
            if control {
                let _ = to.send(Message::TripSeen(held));
            }
        };
        self.spawn("samples", move || monitor::follow(&instance, &board_there, &over_there, trip_seen))?;
        let (instance, board_there, over_there, to) = parts();
        self.spawn("line", move || line::serve(&instance, &board_there, &orders, &to, &over_there))?;
        let (instance, board_there, over_there, _) = parts();
        self.spawn("people", move || people::watch(&instance, &board_there, &over_there))?;
        let board_there = Arc::clone(board);
        self.spawn("web", move || {
            if let Err(error) = web::serve(web, listener, address) {
                board_there.note(Severity::Error, "service", &format!("HTTP: {error}"), None);
            }
        })
    }

    /// Waits for them; one that does not come to its end goes with the process.
    fn join(self) {
        let begun = Instant::now();
        for thread in self.0 {
            while !thread.is_finished() && begun.elapsed() < LEAVE_WITHIN {
                thread::sleep(Duration::from_millis(10));
            }
            if thread.is_finished() && thread.join().is_err() {
                tracing::error!("a thread of the service panicked");
            }
        }
    }
}
