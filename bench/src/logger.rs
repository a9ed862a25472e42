//! The logger: a thread of its own that subscribes to the published samples and writes one MCAP recording a run. It sees what
//! any other subscriber sees, nothing else.

use recordings::{CampaignError, Event, McapWriter, RunMetadata};
use rt_core::{Delivery, LinkError, LossCertificate, Sample, SampleSubscriber};
use std::path::PathBuf;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Longest wait for samples before the logger looks for orders.
const LOOK: Duration = Duration::from_millis(20);
/// Longest time that closing a recording may take after its run has ended, for a slow disk.
const CLOSE: Duration = Duration::from_secs(60);

/// Why a run could not be recorded.
#[derive(Debug, thiserror::Error)]
pub enum LoggerError {
    /// The samples could not be received.
    #[error("logger: {0}")]
    Link(#[from] LinkError),
    /// The recording could not be written.
    #[error("logger: {0}")]
    Recording(#[from] CampaignError),
    /// A sample of another run than the one that was announced.
    #[error(
        "logger: expected samples of run {expected}, got one of run {got}; does another service publish on this instance?"
    )]
    OtherRun {
        /// The run that was announced.
        expected: u32,
        /// The run that came.
        got: u32,
    },
    /// The thread could not be started, or has ended.
    #[error("logger: its thread {0}")]
    Thread(String),
}

/// What the logger is to do.
enum Order {
    /// Record this run.
    Begin { run: u32, path: PathBuf, metadata: Box<RunMetadata>, count: Box<dyn Fn(u64) + Send> },
    /// The run is over; `ticks` is its length where the loop knows it.
    End { run: u32, ticks: Option<u64>, events: Vec<Event> },
}

/// A finished recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// The file.
    pub path: PathBuf,
    /// How much of the run it holds.
    pub certificate: LossCertificate,
}

/// Handle of the logger's thread. One run at a time: [`Logger::begin`], the run, [`Logger::end`].
pub struct Logger {
    orders: Option<Sender<Order>>,
    answers: Receiver<Result<Option<Recorded>, LoggerError>>,
    thread: Option<JoinHandle<()>>,
}

impl Logger {
    /// Subscribes to `instance`. Samples that are published from now on arrive.
    pub fn start(instance: &str) -> Result<Self, LoggerError> {
        let (orders, from_owner) = mpsc::channel();
        let (to_owner, answers) = mpsc::channel();
        let instance = instance.to_owned();
        let thread = thread::Builder::new()
            .name("logger".to_owned())
            .spawn(move || {
                // The ports belong to the thread that opens them.
                let outcome = SampleSubscriber::open(&instance, Delivery::Lossless).map_err(LoggerError::from);
                let outcome = outcome.and_then(|subscriber| {
                    let _ = to_owner.send(Ok(None));
                    serve(subscriber, &from_owner, &to_owner)
                });
                if let Err(error) = outcome {
                    // The owner may be gone already; it hears of it when it asks next.
                    let _ = to_owner.send(Err(error));
                }
            })
            .map_err(|error| LoggerError::Thread(format!("could not be started: {error}")))?;
        let logger = Logger { orders: Some(orders), answers, thread: Some(thread) };
        logger.answer(CLOSE)?;
        Ok(logger)
    }

    /// Opens the recording of `run`. `count` is called with the number of samples recorded so far, now and then.
    pub fn begin(
        &mut self,
        run: u32,
        path: PathBuf,
        metadata: RunMetadata,
        count: impl Fn(u64) + Send + 'static,
    ) -> Result<(), LoggerError> {
        self.order(Order::Begin { run, path, metadata: Box::new(metadata), count: Box::new(count) })?;
        self.answer(CLOSE).map(drop)
    }

    /// Closes the recording of `run`, which has ended after `ticks` ticks (`None`: the loop failed; the last sample tells).
    pub fn end(&mut self, run: u32, ticks: Option<u64>, events: Vec<Event>) -> Result<Recorded, LoggerError> {
        self.order(Order::End { run, ticks, events })?;
        self.answer(CLOSE)?.ok_or_else(|| LoggerError::Thread("closed no recording".to_owned()))
    }

    fn order(&self, order: Order) -> Result<(), LoggerError> {
        let sent = self.orders.as_ref().is_some_and(|orders| orders.send(order).is_ok());
        // A thread that has ended said why: the reason is better than the fact.
        if sent { Ok(()) } else { self.answer(Duration::ZERO).and(Err(gone())) }
    }

    fn answer(&self, timeout: Duration) -> Result<Option<Recorded>, LoggerError> {
        match self.answers.recv_timeout(timeout) {
            Ok(answer) => answer,
            Err(RecvTimeoutError::Disconnected) => Err(gone()),
            Err(RecvTimeoutError::Timeout) => {
                Err(LoggerError::Thread(format!("gave no answer within {} s", timeout.as_secs())))
            }
        }
    }
}

impl Drop for Logger {
    fn drop(&mut self) {
        self.orders = None; // ends the thread
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the logger's thread panicked");
        }
    }
}

fn gone() -> LoggerError {
    LoggerError::Thread("has ended".to_owned())
}

/// Serves one run after the other until the owner is gone.
fn serve(
    mut subscriber: SampleSubscriber,
    orders: &Receiver<Order>,
    answers: &Sender<Result<Option<Recorded>, LoggerError>>,
) -> Result<(), LoggerError> {
    let mut samples = Vec::with_capacity(rt_core::subscribe::DRAIN_MAX);
    while let Ok(order) = orders.recv() {
        let Order::Begin { run, path, metadata, count } = order else {
            return Err(LoggerError::Thread("was told to end a run that never began".to_owned()));
        };
        let mut writer = McapWriter::create(&path, &metadata)?;
        if answers.send(Ok(None)).is_err() {
            return Ok(());
        }
        let mut recorded = 0;
        let (ticks, events) = loop {
            let order = orders.try_recv();
            let over = !matches!(order, Err(TryRecvError::Empty));
            // Everything that was published before the end was announced is in the buffer by then.
            while take(&mut subscriber, &mut samples, if over { Duration::ZERO } else { LOOK })? > 0 {
                record(&mut writer, run, &samples)?;
                recorded += samples.len() as u64;
                count(recorded);
                if !over {
                    break;
                }
            }
            match order {
                Ok(Order::End { run: ended, ticks, events }) if ended == run => break (ticks, events),
                Ok(_) => return Err(LoggerError::Thread(format!("was told to leave run {run} unfinished"))),
                Err(TryRecvError::Empty) => {}
                // The owner is gone: the recording stays a `.part` with its complete chunks.
                Err(TryRecvError::Disconnected) => return Ok(()),
            }
        };
        match ticks {
            Some(ticks) => subscriber.close_run(run, ticks),
            None => subscriber.abandon_run(),
        }
        for event in &events {
            writer.write_event(event)?;
        }
        // The subscriber counted what arrived; the writer signs it only if it is what the file holds.
        let certificate = std::iter::from_fn(|| subscriber.take_certificate())
            .find(|certificate| certificate.run == run)
            .unwrap_or_else(|| writer.certificate(ticks.unwrap_or(0)));
        let path = writer.finish(&certificate)?;
        if answers.send(Ok(Some(Recorded { path, certificate }))).is_err() {
            return Ok(());
        }
    }
    Ok(())
}

fn take(subscriber: &mut SampleSubscriber, into: &mut Vec<Sample>, wait: Duration) -> Result<usize, LoggerError> {
    into.clear();
    Ok(if wait.is_zero() { subscriber.drain(into)? } else { subscriber.receive(wait, into)? })
}

fn record(writer: &mut McapWriter, run: u32, samples: &[Sample]) -> Result<(), LoggerError> {
    for sample in samples {
        if sample.run != run {
            return Err(LoggerError::OtherRun { expected: run, got: sample.run });
        }
        writer.write(sample)?;
    }
    Ok(())
}
