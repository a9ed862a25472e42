//! Requests of other processes, each with an answer, and the wake-up that lets the answering end sleep until there is one: what the command
//! channels of a run and of the service have in common. Messages have a fixed size and say their version.

use std::fmt::Debug;
use std::time::{Duration, Instant};

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::client::Client;
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::server::ServerCreateError;
use iceoryx2::service::port_factory::{event, request_response};

use crate::leftovers::watched;
use crate::link::{Ipc, LinkError, patiently};
use crate::presence::{failed, participant};

/// Programs that may ask one instance at a time.
const MAX_CLIENTS: usize = 8;
/// Those that answer, and such as begin to and are refused.
const MAX_LISTENERS: usize = 8;
const MAX_NODES: usize = 16;
/// Between two looks after an answer.
pub(crate) const LOOK: Duration = Duration::from_millis(1);
/// For "none" where a number stands in a message.
pub(crate) const NONE: u64 = u64::MAX;

/// What goes through shared memory as it is.
pub(crate) trait Plain: Copy + Debug + ZeroCopySend + 'static {}
impl<T: Copy + Debug + ZeroCopySend + 'static> Plain for T {}

type Requests<Q, A> = request_response::PortFactory<Ipc, Q, (), A, ()>;
type Wakes = event::PortFactory<Ipc>;
/// A request that waits for its answer.
pub(crate) type Asked<Q, A> = ActiveRequest<Ipc, Q, (), A, ()>;

/// Which exchange of an instance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kind {
    /// Last part of the service's name; that of the wake-up is `<part>-wake`.
    pub part: &'static str,
    /// Nobody answers on this instance.
    pub nobody: fn(String) -> LinkError,
    /// How many may answer at a time; the transport counts them in one step.
    pub servers: usize,
}

impl Kind {
    fn names(&self, instance: &str) -> Result<(Node<Ipc>, ServiceName, ServiceName), LinkError> {
        let (node, requests) = participant(instance, self.part)?;
        // What a killed process left behind would take a request without anybody hearing it.
        node.try_cleanup_dead_nodes();
        let wake = ServiceName::new(&format!("{requests}-wake"));
        Ok((node, requests, wake.map_err(|e| failed(instance, "name a service", &e))?))
    }
}

/// The end that answers. Belongs to the thread that opened it.
#[derive(Debug)]
pub(crate) struct Answering<Q: Plain, A: Plain> {
    server: Server<Ipc, Q, (), A, ()>,
    listener: Listener<Ipc>,
    _requests: Requests<Q, A>,
    _wakes: Wakes,
    _node: Node<Ipc>,
    instance: String,
}

impl<Q: Plain, A: Plain> Answering<Q, A> {
    /// Listens for requests to `instance`.
    ///
    /// # Errors
    /// A name that is none, another one that answers where only one may, no shared memory.
    pub fn open(instance: &str, kind: Kind) -> Result<Self, LinkError> {
        watched(|| Self::open_watched(instance, kind))
    }

    fn open_watched(instance: &str, kind: Kind) -> Result<Self, LinkError> {
        let (node, name, wake_name) = kind.names(instance)?;
        let requests = patiently(|| {
            node.service_builder(&name)
                .request_response::<Q, A>()
                .enable_safe_overflow_for_requests(false)
                .enable_safe_overflow_for_responses(false)
                .max_active_requests_per_client(2)
                .max_response_buffer_size(2)
                .max_clients(MAX_CLIENTS)
                .max_servers(kind.servers)
                .max_nodes(MAX_NODES)
                .open_or_create()
        });
        let requests = requests.map_err(|e| failed(instance, "open the command channel", &e))?;
        let wakes = patiently(|| {
            node.service_builder(&wake_name)
                .event()
                .max_notifiers(MAX_CLIENTS)
                .max_listeners(MAX_LISTENERS)
                .max_nodes(MAX_NODES)
                .open_or_create()
        });
        let wakes = wakes.map_err(|e| failed(instance, "open the command channel's wake-up", &e))?;
        let listener = wakes.listener_builder().create();
        let listener = listener.map_err(|e| failed(instance, "create the command channel's listener", &e))?;
        let server = requests.server_builder().backpressure_strategy(BackpressureStrategy::DiscardData).create();
        let server = server.map_err(|error| match error {
            ServerCreateError::ExceedsMaxSupportedServers => LinkError::InUse { instance: instance.to_owned() },
            other => failed(instance, "create the command channel's server", &other),
        })?;
        let instance = instance.to_owned();
        Ok(Answering { server, listener, _requests: requests, _wakes: wakes, _node: node, instance })
    }

    /// Waits up to `timeout` for a request.
    ///
    /// # Errors
    /// The transport failed.
    pub fn wait(&self, timeout: Duration) -> Result<(), LinkError> {
        match self.listener.timed_wait(|_| (), timeout) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(error) => Err(self.broken("waiting for a command", error.to_string())),
        }
    }

    /// The next request, where there is one.
    ///
    /// # Errors
    /// The transport failed.
    pub fn receive(&self) -> Result<Option<Asked<Q, A>>, LinkError> {
        self.server.receive().map_err(|e| self.broken("taking a command", e.to_string()))
    }

    fn broken(&self, what: &'static str, cause: String) -> LinkError {
        LinkError::Transport { instance: self.instance.clone(), what, cause }
    }
}

/// The end that asks, opened once for any number of requests. Belongs to the thread that opened it.
#[derive(Debug)]
pub(crate) struct Asking<Q: Plain, A: Plain> {
    client: Client<Ipc, Q, (), A, ()>,
    notifier: Notifier<Ipc>,
    requests: Requests<Q, A>,
    _wakes: Wakes,
    _node: Node<Ipc>,
    instance: String,
    kind: Kind,
}

impl<Q: Plain, A: Plain> Asking<Q, A> {
    /// Opens the way.
    ///
    /// # Errors
    /// Nobody answers on this instance, or never did.
    pub fn open(instance: &str, kind: Kind) -> Result<Self, LinkError> {
        watched(|| Self::open_watched(instance, kind))
    }

    fn open_watched(instance: &str, kind: Kind) -> Result<Self, LinkError> {
        let (node, name, wake_name) = kind.names(instance)?;
        let nobody = || (kind.nobody)(instance.to_owned());
        let requests = node.service_builder(&name).request_response::<Q, A>().open().map_err(|_| nobody())?;
        let wakes = node.service_builder(&wake_name).event().open().map_err(|_| nobody())?;
        let client = requests.client_builder().backpressure_strategy(BackpressureStrategy::DiscardData).create();
        let client = client.map_err(|e| failed(instance, "create the command channel's client", &e))?;
        let notifier = wakes.notifier_builder().create();
        let notifier = notifier.map_err(|e| failed(instance, "create the command channel's notifier", &e))?;
        let instance = instance.to_owned();
        Ok(Asking { client, notifier, requests, _wakes: wakes, _node: node, instance, kind })
    }

    /// Whether somebody listens at the other end.
    pub fn is_heard(&self) -> bool {
        self.requests.dynamic_config().number_of_servers() > 0
    }

    /// Sends a request and waits for its answer, up to `patience`. `read`: what an answer says, `None` where it is of another version.
    ///
    /// # Errors
    /// Nobody listens any more, or does not answer in time.
    pub fn send<T>(&self, request: Q, patience: Duration, read: impl Fn(&A) -> Option<T>) -> Result<T, LinkError> {
        let instance = &self.instance;
        let pending = self.client.send_copy(request).map_err(|e| failed(instance, "send a command", &e))?;
        if pending.number_of_server_connections() == 0 {
            return Err((self.kind.nobody)(instance.clone()));
        }
        // A server that is not woken looks by itself, a little later.
        let _ = self.notifier.notify();
        let begun = Instant::now();
        loop {
            let reply = pending.receive().map_err(|e| failed(instance, "take the answer", &e))?;
            if let Some(reply) = reply {
                let other = || failed(instance, "use the answer", &"it is of another version");
                return read(reply.payload()).ok_or_else(other);
            }
            let waited = begun.elapsed();
            if waited >= patience {
                let what = format!("the answer of instance {instance:?}");
                return Err(LinkError::Timeout { what, waited_s: waited.as_secs_f64() });
            }
            std::thread::sleep(LOOK);
        }
    }
}

/// As much of a text as a message has room for, to whole characters, and its length in bytes.
pub(crate) fn packed<const ROOM: usize>(text: &str) -> ([u8; ROOM], u32) {
    let fits = (0..=text.len().min(ROOM)).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
    let mut bytes = [0; ROOM];
    bytes[..fits].copy_from_slice(&text.as_bytes()[..fits]);
    (bytes, fits as u32)
}

/// The text that a message holds; `None` where it claims more than it has room for.
pub(crate) fn unpacked(bytes: &[u8], length: u32) -> Option<String> {
    Some(String::from_utf8_lossy(bytes.get(..length as usize)?).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_cut_at_a_whole_character_and_one_that_claims_too_much_is_none() {
        let (bytes, length) = packed::<7>("aüü\u{1f600}");
        assert_eq!(unpacked(&bytes, length), Some("aüü".to_owned()));
        assert_eq!(packed::<4>(""), ([0; 4], 0));
        assert_eq!(unpacked(&bytes, 8), None);
    }
}
