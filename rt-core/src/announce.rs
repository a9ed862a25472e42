//! What a run is, told to whoever records it in another process: bytes that this crate does not look into, published before the run's
//! first sample and kept for who comes later.
//!
//! | service | pattern | carries |
//! |---|---|---|
//! | `rec-bench/<instance>/setup` | publish-subscribe, the last one is kept | the run's number, and bytes |
//!
//! The publisher has a thread of its own, which is neither the loop's nor that of the samples: it may allocate and take its time.

use std::collections::VecDeque;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe;

use crate::leftovers::watched;
use crate::link::{Ipc, LinkError, MAX_SUBSCRIBERS, patiently};
use crate::presence::{failed, participant};

/// A recorder that came later gets the last announcement after so long at most.
const LOOK: Duration = Duration::from_millis(20);
/// Between two looks of a recorder that waits for an announcement.
const NAP: Duration = Duration::from_millis(2);
/// Announcements that a recorder may lag behind.
const BUFFER: usize = 2;
/// Announcements that a recorder remembers.
const KEPT: usize = 8;
/// Bytes for which there is room at once; for more the transport makes new room.
const ROOM: usize = 32 * 1024;
/// Layout of what is sent.
const VERSION: u32 = 1;

type Setups = publish_subscribe::PortFactory<Ipc, [u8], Header>;

/// What stands before the bytes.
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchSetup1")]
struct Header {
    version: u32,
    run: u32,
}

fn open(instance: &str) -> Result<(Node<Ipc>, Setups), LinkError> {
    watched(|| open_watched(instance))
}

fn open_watched(instance: &str) -> Result<(Node<Ipc>, Setups), LinkError> {
    let (node, name) = participant(instance, "setup")?;
    let service = patiently(|| {
        node.service_builder(&name)
            .publish_subscribe::<[u8]>()
            .user_header::<Header>()
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(BUFFER)
            .subscriber_max_borrowed_samples(1)
            .history_size(1)
            .max_subscribers(MAX_SUBSCRIBERS)
            .max_publishers(2)
            .max_nodes(2 * MAX_SUBSCRIBERS)
            .open_or_create()
    });
    Ok((node, service.map_err(|e| failed(instance, "open the setup service", &e))?))
}

struct Order {
    run: u32,
    bytes: Vec<u8>,
    done: mpsc::Sender<Result<(), LinkError>>,
}

/// The service's end. Dropped, it ends its thread; what was announced last is kept until then.
#[derive(Debug)]
pub struct Announcer {
    orders: Option<mpsc::Sender<Order>>,
    thread: Option<JoinHandle<()>>,
}

impl Announcer {
    /// Announces on `instance` from a thread of its own.
    ///
    /// # Errors
    /// The service can't be had.
    pub fn start(instance: &str) -> Result<Self, LinkError> {
        let (orders, from_owner) = mpsc::channel();
        let (ready, started) = mpsc::channel();
        let instance_there = instance.to_owned();
        let thread = thread::Builder::new().name("announcer".to_owned()).spawn(move || {
            // Ports belong to the thread that opens them. The owner is gone only where its thread has ended: then so does this one.
            match Speaker::open(&instance_there) {
                Ok(speaker) => {
                    let _ = ready.send(Ok(()));
                    speaker.serve(&from_owner);
                }
                Err(error) => drop(ready.send(Err(error))),
            }
        });
        let thread = thread.map_err(|e| failed(instance, "start the announcer's thread", &e))?;
        started.recv().map_err(|_| LinkError::Ended)??;
        Ok(Announcer { orders: Some(orders), thread: Some(thread) })
    }

    /// Tells what run number `run` is. When this returns, every recorder that is there has it before any later sample.
    ///
    /// # Errors
    /// The transport has no room, or has failed.
    pub fn announce(&self, run: u32, bytes: Vec<u8>) -> Result<(), LinkError> {
        let (done, told) = mpsc::channel();
        let sent = self.orders.as_ref().is_some_and(|orders| orders.send(Order { run, bytes, done }).is_ok());
        if sent { told.recv().unwrap_or(Err(LinkError::Ended)) } else { Err(LinkError::Ended) }
    }
}

impl Drop for Announcer {
    fn drop(&mut self) {
        self.orders = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the announcer's thread panicked");
        }
    }
}

/// What the announcer's thread has.
struct Speaker {
    publisher: Publisher<Ipc, [u8], Header>,
    _service: Setups,
    _node: Node<Ipc>,
    instance: String,
}

impl Speaker {
    fn open(instance: &str) -> Result<Self, LinkError> {
        let (node, service) = open(instance)?;
        let publisher = service
            .publisher_builder()
            .initial_max_slice_len(ROOM)
            .allocation_strategy(AllocationStrategy::PowerOfTwo)
            .max_loaned_samples(1)
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|e| failed(instance, "create the setup publisher", &e))?;
        Ok(Speaker { publisher, _service: service, _node: node, instance: instance.to_owned() })
    }

    fn serve(&self, orders: &Receiver<Order>) {
        loop {
            match orders.recv_timeout(LOOK) {
                // An owner that does not wait for the answer has none to give it to.
                Ok(Order { run, bytes, done }) => drop(done.send(self.send(run, &bytes))),
                Err(RecvTimeoutError::Timeout) => {
                    // Whoever came meanwhile gets what was said last.
                    if let Err(error) = self.publisher.update_connections() {
                        tracing::warn!(%error, "setup of the run for a recorder that joins");
                    }
                }
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn send(&self, run: u32, bytes: &[u8]) -> Result<(), LinkError> {
        let broken = |what, cause: String| LinkError::Transport { instance: self.instance.clone(), what, cause };
        let room = self.publisher.loan_slice_uninit(bytes.len());
        let mut room = room.map_err(|e| broken("making room for a run's setup", e.to_string()))?;
        *room.user_header_mut() = Header { version: VERSION, run };
        room.write_from_slice(bytes).send().map_err(|e| broken("announcing a run", e.to_string()))?;
        Ok(())
    }
}

/// A recorder's end. Belongs to the thread that opened it.
#[derive(Debug)]
pub struct Announcements {
    subscriber: Subscriber<Ipc, [u8], Header>,
    service: Setups,
    _node: Node<Ipc>,
    instance: String,
    /// The newest last.
    heard: VecDeque<(u32, Vec<u8>)>,
}

impl Announcements {
    /// Listens to what is announced on `instance`, the last one that was included.
    ///
    /// # Errors
    /// The service can't be had.
    pub fn open(instance: &str) -> Result<Self, LinkError> {
        let (node, service) = open(instance)?;
        let subscriber = service.subscriber_builder().create();
        let subscriber = subscriber.map_err(|e| failed(instance, "create the setup subscriber", &e))?;
        Ok(Announcements { subscriber, service, _node: node, instance: instance.to_owned(), heard: VecDeque::new() })
    }

    /// What was announced of run number `run`, of which a sample has come. It is waited for up to `patience` where somebody announces, as
    /// what was said before this end was opened comes a little later. `None`: nobody says what this run is.
    ///
    /// # Errors
    /// The transport has failed; it is of another version.
    pub fn of_run(&mut self, run: u32, patience: Duration) -> Result<Option<&[u8]>, LinkError> {
        let begin = Instant::now();
        loop {
            self.hear()?;
            let found = self.heard.iter().rposition(|(of, _)| *of == run);
            let nobody = self.service.dynamic_config().number_of_publishers() == 0;
            if found.is_some() || nobody || begin.elapsed() >= patience {
                return Ok(found.map(|at| self.heard[at].1.as_slice()));
            }
            thread::sleep(NAP);
        }
    }

    /// What was announced last, with the number of its run; `None`: nothing since this end was opened.
    ///
    /// # Errors
    /// As [`Announcements::of_run`].
    pub fn newest(&mut self) -> Result<Option<(u32, &[u8])>, LinkError> {
        self.hear()?;
        Ok(self.heard.back().map(|(run, bytes)| (*run, bytes.as_slice())))
    }

    /// Takes what has come; to be called now and then, or what is announced meanwhile is lost.
    ///
    /// # Errors
    /// As [`Announcements::of_run`].
    pub fn hear(&mut self) -> Result<(), LinkError> {
        let instance = &self.instance;
        let broken = |what, cause: String| LinkError::Transport { instance: instance.clone(), what, cause };
        while let Some(arrival) =
            self.subscriber.receive().map_err(|e| broken("receiving a run's setup", e.to_string()))?
        {
            let Header { version, run } = *arrival.user_header();
            if version != VERSION {
                let cause = format!("expected version {VERSION}, got {version}; use programs of the same build");
                return Err(broken("understanding a run's setup", cause));
            }
            if self.heard.len() == KEPT {
                self.heard.pop_front();
            }
            self.heard.push_back((run, arrival.payload().to_vec()));
        }
        Ok(())
    }
}
