//! The emulated rig at the other end of both wires: behind a pty an amplifier that speaks VESC or TMCL, on CAN valves, sensors and a
//! fixture, and behind both the model's plant. The drivers that run a real rig run against it unchanged.
//!
//! What is where on the bus is read from a rig file from the other end: what the bench commands the nodes obey, what the bench reads the
//! nodes send. The frame with the counter is the nodes' SYNC; [`Plant`] says what that means for time.
//!
//! | module | what |
//! |---|---|
//! | [`plant`] | the plant between two SYNCs: a state machine without a clock |
//! | [`command_map`], [`sensor_map`] | frames to commands, measured quantities to frames |
//! | [`motor`] | what the amplifier measures of its motor |
//! | [`server`] | the thread that owns pty, bus and plant |

pub mod command_map;
pub mod exchange;
pub mod motor;
pub mod plant;
pub mod sensor_map;
mod server;

pub use command_map::CommandMap;
pub use exchange::{Answer, Sync};
pub use plant::{Plant, PlantFactory};
pub use sensor_map::SensorMap;

use crate::amplifier::{self, AmplifierError, Fault};
use crate::can::{CanError, Interface};
use crate::dbc::Database;
use crate::journal::Journal;
use crate::serial::Pty;
use crate::wired::{AmplifierSettings, CanSettings, MappingError};
use rt_core::{Measurement, SafeState};
use std::collections::VecDeque;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use tokio::sync::{mpsc, watch};

/// What is at the other end of the wires.
#[derive(Clone, Debug)]
pub struct EmulatorSettings {
    /// The amplifier that is emulated: protocol, baud rate, full scale. Its `port` is the bench's business, not read here.
    pub amplifier: AmplifierSettings,
    /// The bus as the bench sees it. Its `interface` is not read here.
    pub can: CanSettings,
    /// The bus on which the nodes are. A socket's path is bound here.
    pub interface: Interface,
    /// A symbolic link to the pty, made here and removed with it; `None` = the pty's own name only.
    pub link: Option<PathBuf>,
    /// Without a fresh command for so long (ms, > 0) the valves go to their safe state by themselves.
    pub node_timeout_ms: f64,
    /// Without a command or keep-alive for so long (ms, > 0) the amplifier goes to 0 V by itself.
    pub amplifier_timeout_ms: f64,
    /// Where the valves go.
    pub safe_state: SafeState,
}

impl EmulatorSettings {
    /// With time-outs of 50 ms (nodes) and 100 ms (amplifier), and without a link.
    pub fn new(amplifier: AmplifierSettings, can: CanSettings, interface: Interface) -> Self {
        EmulatorSettings {
            amplifier,
            can,
            interface,
            link: None,
            node_timeout_ms: 50.0,
            amplifier_timeout_ms: 100.0,
            safe_state: SafeState::default(),
        }
    }
}

/// Something that goes wrong at the rig's end, for tests of the bench's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// The amplifier reports this fault and its motor stands; `None` ends it.
    AmplifierFault(Option<Fault>),
    /// The amplifier says nothing and obeys nothing.
    AmplifierSilent(bool),
    /// No node says anything; the valves still obey.
    NodesSilent(bool),
    /// The valves obey nothing: they stay where they are.
    ValvesStuck(bool),
    /// A second node with the encoder's identifier answers, too: its angle is 90 degrees off.
    EncoderTwice(bool),
}

/// What an emulated rig did, since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Command frames that nodes act on.
    pub syncs: u64,
    /// SYNCs whose counter stood.
    pub repeated: u64,
    /// Ticks that counters passed over.
    pub passed_over: u64,
    /// Commands of the amplifier.
    pub commands: u64,
    /// SYNCs of a run for which no command of the amplifier had come half a tick after them: the one before stayed.
    pub late: u64,
    /// Commands that no rig could be told.
    pub refused: u64,
    /// Times that the nodes went to the safe state by themselves.
    pub node_timeouts: u64,
    /// Times that the amplifier went to 0 V by itself.
    pub amplifier_timeouts: u64,
    /// Rigs that were prepared.
    pub preparations: u64,
    /// Tick of the present run.
    pub tick: u64,
    /// Frames that the bus did not take.
    pub unsent: u64,
}

/// The rig as its own hands see it: what it has in force, and what its sensors showed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seen {
    /// At the amplifier, V.
    pub voltage_v: f64,
    /// As the valve stands.
    pub brake_open: bool,
    /// As the valve stands.
    pub bypass_open: bool,
    /// Answers of the present run: its last [`MOST_SHOWN`] ticks with what was measured at them.
    pub shown: VecDeque<(u64, Measurement)>,
}

/// Ticks that are remembered of a run.
pub const MOST_SHOWN: usize = 1024;

/// Why an emulated rig can't be put on the wires.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// What the settings say of the bus.
    #[error(transparent)]
    Mapping(#[from] MappingError),
    /// A time-out that makes no sense.
    #[error("{name}: expected more than 0 and less than 1e6 ms, got {timeout_ms}")]
    Timeout {
        /// Name of the option.
        name: &'static str,
        /// What is there, ms.
        timeout_ms: f64,
    },
    /// The amplifier's settings.
    #[error(transparent)]
    Amplifier(#[from] AmplifierError),
    /// The bus.
    #[error(transparent)]
    Can(#[from] CanError),
    /// The pty or its link.
    #[error("the amplifier's port: {0}")]
    Pty(#[source] io::Error),
    /// The rig that is there before the first preparation.
    #[error(transparent)]
    Plant(#[from] crate::EmulatedError),
    /// The system.
    #[error("the emulated rig's thread: {0}")]
    Thread(#[source] io::Error),
}

impl EmulatorError {
    /// Whether the configuration is to be corrected, and not the machine.
    pub fn is_configuration(&self) -> bool {
        use EmulatorError::{Amplifier, Mapping, Plant, Timeout};
        matches!(self, Mapping(_) | Timeout { .. } | Amplifier(_) | Plant(_))
    }
}

/// An emulated rig on the wires, in a thread of its own. Dropped, it goes away as if it had been unplugged.
#[derive(Debug)]
pub struct Emulator {
    port: PathBuf,
    orders: mpsc::UnboundedSender<Order>,
    statistics: watch::Receiver<Statistics>,
    seen: Arc<Mutex<Seen>>,
    thread: Option<JoinHandle<()>>,
}

/// What the thread is told.
#[derive(Debug)]
enum Order {
    /// With whom to tell that it is so.
    Trouble(Trouble, std::sync::mpsc::Sender<()>),
    Stop,
}

impl Emulator {
    /// Puts a rig on the wires; both can be opened when this returns. `factory` makes a rig for each preparation, `prepare` is called in
    /// the thread before it begins (priority), `journal` hears of connections, time-outs and what was refused.
    ///
    /// # Errors
    /// Signals that don't exist, a bus or a link that can't be had.
    pub fn start(
        settings: &EmulatorSettings,
        database: &Database,
        mut factory: PlantFactory,
        prepare: impl FnOnce() + Send + 'static,
        journal: Journal,
    ) -> Result<Emulator, EmulatorError> {
        let timeouts =
            [("node_timeout_ms", settings.node_timeout_ms), ("amplifier_timeout_ms", settings.amplifier_timeout_ms)];
        for (name, timeout_ms) in timeouts {
            if !(timeout_ms > 0.0 && timeout_ms < 1e6) {
                return Err(EmulatorError::Timeout { name, timeout_ms });
            }
        }
        let mut commands = CommandMap::new(&settings.can, database)?;
        let sensors = SensorMap::new(&settings.can, database)?;
        let mut drive = (amplifier::protocol(&settings.amplifier.protocol)?.drive)(&settings.amplifier)?;
        drive.set_timeout(Some((settings.amplifier_timeout_ms * 1e6) as u64));
        let idle = factory(&commands.preparation())?;
        let plant = Plant::new(factory, idle, (settings.node_timeout_ms * 1e6) as u64, settings.safe_state);
        let pty = Pty::open(settings.link.as_deref()).map_err(EmulatorError::Pty)?;
        let port = pty.path().to_owned();
        let (orders, heard) = mpsc::unbounded_channel();
        let (shown, statistics) = watch::channel(Statistics::default());
        let seen = Arc::new(Mutex::new(Seen::default()));
        let wiring = server::Wiring {
            commands,
            sensors,
            drive,
            plant,
            interface: settings.interface.clone(),
            baud: settings.amplifier.baud,
            supply_v: settings.amplifier.full_scale_v,
            journal,
            seen: seen.clone(),
        };
        let thread = server::spawn(wiring, pty, prepare, heard, shown)?;
        Ok(Emulator { port, orders, statistics, seen, thread: Some(thread) })
    }

    /// The port that the bench opens: the link, or the pty's own name.
    pub fn port(&self) -> &Path {
        &self.port
    }

    /// This is wrong, or right again, for all that is sent to the rig after the return.
    pub fn inject(&self, trouble: Trouble) {
        let (taken, wait) = std::sync::mpsc::channel();
        // A thread that has ended has no trouble any more: it has dropped its end.
        if self.orders.send(Order::Trouble(trouble, taken)).is_ok() {
            let _ = wait.recv();
        }
    }

    /// What it did so far.
    pub fn statistics(&self) -> Statistics {
        *self.statistics.borrow()
    }

    /// A look at what it has in force now, and at what it showed. It waits meanwhile.
    pub fn seen<R>(&self, look: impl FnOnce(&Seen) -> R) -> R {
        look(&self.seen.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether the thread still serves; it ends by itself where the bus is gone for good.
    pub fn is_serving(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        let _ = self.orders.send(Order::Stop);
        if let Some(thread) = self.thread.take() {
            // A panic there was told on stderr.
            let _ = thread.join();
        }
    }
}
