//! Samples of a running instance for Foxglove and whatever speaks its protocol: a WebSocket server that shows and takes no orders. Topic
//! and schema are those of a recording ([`recordings::live`]), so a layout serves the live run and the file.

use foxglove::websocket::{Status, StatusLevel};
use foxglove::{ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use recordings::{RunMetadata, live};
use rt_core::announce::Announcements;
use rt_core::{Delivery, LinkError, Sample, SampleSubscriber};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Messages that a slow client may lag behind before its oldest are dropped: 8 s.
const BACKLOG: usize = 8192;
/// Longest wait for samples before the bridge looks for its end.
const LOOK: Duration = Duration::from_millis(50);
/// What a run is said to be arrives before its samples, or not much later.
const PATIENCE: Duration = Duration::from_millis(100);
/// The status line that clients show.
const STATUS: &str = "rec-bench.run";

/// Why there is no bridge (any more).
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The samples can't be received.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The server can't listen.
    #[error("--listen {address}: can't listen there: {source}; choose another port, or end what uses it")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// The server's own words.
        source: FoxgloveError,
    },
    /// The channel of the samples is refused: a defect.
    #[error("the channel of the samples: {0}")]
    Channel(FoxgloveError),
}

/// A server that has begun to listen.
pub struct Bridge {
    server: Option<WebSocketServerHandle>,
    samples: Arc<RawChannel>,
    /// Dropped, it takes its channels with it, and clients would be told of none.
    _context: Arc<Context>,
    announcements: Announcements,
    subscriber: SampleSubscriber,
    /// The run that is forwarded, and the wall's time of its tick 0, ns since 1970.
    run: Option<Forwarded>,
    message: Vec<u8>,
}

#[derive(Clone, Copy)]
struct Forwarded {
    number: u32,
    next_sequence: u64,
    origin_ns: u64,
}

impl Bridge {
    /// Subscribes to `instance` and listens at `address`; port 0 takes any that is free.
    ///
    /// # Errors
    /// The instance can't be subscribed to, the address can't be listened at.
    pub fn open(instance: &str, address: SocketAddr) -> Result<Bridge, BridgeError> {
        let announcements = Announcements::open(instance)?;
        let subscriber = SampleSubscriber::open(instance, Delivery::BestEffort)?;
        // A context of its own: nothing else of the process is shown.
        let context = Context::new();
        let samples = ChannelBuilder::new(live::TOPIC)
            .context(&context)
            .schema(Schema::new(live::SCHEMA_NAME, live::ENCODING, live::SCHEMA))
            .message_encoding(live::ENCODING)
            .build_raw()
            .map_err(BridgeError::Channel)?;
        let server = context
            .websocket_server()
            .name(format!("rec-bench {instance}"))
            .bind(address.ip().to_string(), address.port())
            // No capability is announced: clients can publish, set and call nothing.
            .capabilities([])
            .message_backlog_size(BACKLOG)
            .start_blocking()
            .map_err(|source| BridgeError::Listen { address, source })?;
        let (server, run, message) = (Some(server), None, Vec::new());
        Ok(Bridge { server, samples, _context: context, announcements, subscriber, run, message })
    }

    /// The port that is listened at.
    pub fn port(&self) -> u16 {
        self.server.as_ref().map_or(0, WebSocketServerHandle::port)
    }

    /// Forwards samples until `end` is set; `say` hears of each run.
    ///
    /// # Errors
    /// The transport failed, or sends what is no run.
    pub fn serve(&mut self, end: &AtomicBool, say: &mut dyn FnMut(&str)) -> Result<(), BridgeError> {
        let mut samples = Vec::with_capacity(rt_core::subscribe::DRAIN_MAX);
        while !end.load(Ordering::Relaxed) {
            samples.clear();
            self.subscriber.receive(LOOK, &mut samples)?;
            while self.subscriber.take_certificate().is_some() {}
            self.announcements.hear()?;
            for sample in &samples {
                self.forward(sample, say)?;
            }
        }
        Ok(())
    }

    fn forward(&mut self, sample: &Sample, say: &mut dyn FnMut(&str)) -> Result<(), BridgeError> {
        let continues = |run: &Forwarded| run.number == sample.run && sample.sequence() >= run.next_sequence;
        let origin_ns = match self.run.filter(continues) {
            Some(run) => run.origin_ns,
            None => self.begin(sample, say)?,
        };
        // Ticks are as far apart in a client's time as they were scheduled, whatever the transport did.
        let log_time = origin_ns + sample.scheduled_ns;
        if self.samples.has_sinks() {
            live::encode(sample, &mut self.message);
            self.samples.log_with_meta(&self.message, PartialMetadata { log_time: Some(log_time) });
        }
        let next_sequence = sample.sequence() + 1;
        self.run = (!sample.last()).then_some(Forwarded { number: sample.run, next_sequence, origin_ns });
        if sample.last() {
            let (severity, how) = crate::monitor::happenings::ending(sample);
            let level = match severity {
                recordings::Severity::Info => StatusLevel::Info,
                recordings::Severity::Warning => StatusLevel::Warning,
                recordings::Severity::Error => StatusLevel::Error,
            };
            self.tell(level, &format!("run {} ended: {how}", sample.run), say);
        }
        Ok(())
    }

    /// Another run: what it is, and the wall's time of its tick 0.
    fn begin(&mut self, first: &Sample, say: &mut dyn FnMut(&str)) -> Result<u64, BridgeError> {
        let announced = self.announcements.of_run(first.run, PATIENCE)?.map(RunMetadata::from_record);
        let name = match announced {
            Some(Ok(run)) => format!("{}, {}, {}, {}", run.name, run.protocol, run.role, run.plane),
            Some(Err(_)) | None => "its service does not say what it is".to_owned(),
        };
        self.tell(StatusLevel::Info, &format!("run {}: {name}", first.run), say);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(u64::try_from(now.as_nanos()).unwrap_or(u64::MAX).saturating_sub(first.scheduled_ns))
    }

    fn tell(&self, level: StatusLevel, text: &str, say: &mut dyn FnMut(&str)) {
        if let Some(server) = &self.server {
            server.publish_status(Status::new(level, text).with_id(STATUS));
        }
        say(text);
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        if let Some(server) = self.server.take() {
            server.stop().wait_blocking();
        }
    }
}
