//! The logger: a thread of its own that subscribes to the published samples and writes one MCAP recording a run. It sees what
//! any other subscriber sees, nothing else.
//!
//! When the system refuses to write a recording on (a full disk), the owner is told at once; the run goes on unrecorded unless
//! the owner ends it, and its certificate says what is missing.

use crate::amplifier_log::AmplifierLog;
use drivers::telemetry::TelemetryReader;
use recordings::{AmplifierReport, CampaignError, CutShort, Event, McapWriter, RunMetadata, Severity};
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
    /// Record the reports that are read here, from the next run on.
    Amplifier(TelemetryReader),
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
    /// Reports of the amplifier that are missing in it: they came faster than they were read.
    pub lost_reports: u64,
    /// Samples that no recording can hold: they are missing in it.
    pub refused: Refused,
    /// The system refused to write it on. The file may then be a `.part`.
    pub cut_short: Option<CutShort>,
}

/// Samples that arrived and that no recording can hold.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Refused {
    /// How many.
    pub samples: u64,
    /// Why the first of them was refused.
    pub first: String,
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
        Self::start_with(instance, |cut| tracing::error!("{cut}; the run goes on unrecorded"))
    }

    /// The same; `on_cut` hears at once, in the logger's thread, when the system refuses to write a recording on.
    pub fn start_with(instance: &str, mut on_cut: impl FnMut(&CutShort) + Send + 'static) -> Result<Self, LoggerError> {
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
                    serve(subscriber, &from_owner, &to_owner, &mut on_cut)
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

    /// Records the amplifier's reports too, from the next run on.
    ///
    /// # Errors
    /// The logger's thread has ended, and why.
    pub fn record_amplifier(&mut self, reader: TelemetryReader) -> Result<(), LoggerError> {
        self.order(Order::Amplifier(reader))
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
    on_cut: &mut dyn FnMut(&CutShort),
) -> Result<(), LoggerError> {
    let mut samples = Vec::with_capacity(rt_core::subscribe::DRAIN_MAX);
    let mut amplifier = None;
    while let Ok(order) = orders.recv() {
        let (run, path, metadata, count) = match order {
            Order::Begin { run, path, metadata, count } => (run, path, metadata, count),
            Order::Amplifier(reader) => {
                amplifier = Some(AmplifierLog::new(reader));
                continue;
            }
            Order::End { .. } => {
                return Err(LoggerError::Thread("was told to end a run that never began".to_owned()));
            }
        };
        let writer = McapWriter::create(&path, &metadata)?;
        let mut open =
            Open { run, writer, recorded: 0, refused: Refused::default(), last: None, amplifier: amplifier.as_mut() };
        if let Some(amplifier) = &mut open.amplifier {
            amplifier.begin();
        }
        if answers.send(Ok(None)).is_err() {
            return Ok(());
        }
        let (ticks, events) = loop {
            let order = orders.try_recv();
            let over = !matches!(order, Err(TryRecvError::Empty));
            // Everything that was published before the end was announced is in the buffer by then.
            while take(&mut subscriber, &mut samples, if over { Duration::ZERO } else { LOOK })? > 0 {
                open.record(&samples, on_cut)?;
                count(open.recorded);
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
        // The subscriber counted what arrived; the writer signs it only if it is what the file holds.
        let arrived = std::iter::from_fn(|| subscriber.take_certificate())
            .find(|certificate| certificate.run == run)
            .unwrap_or_else(|| open.writer.certificate(ticks.unwrap_or(0)));
        if answers.send(open.close(&events, arrived, on_cut).map(Some)).is_err() {
            return Ok(());
        }
    }
    Ok(())
}

/// The recording of a run under way.
struct Open<'a> {
    run: u32,
    writer: McapWriter,
    /// Samples that the writer took.
    recorded: u64,
    refused: Refused,
    /// The newest of those that are recorded.
    last: Option<Sample>,
    amplifier: Option<&'a mut AmplifierLog>,
}

impl Open<'_> {
    fn record(&mut self, samples: &[Sample], on_cut: &mut dyn FnMut(&CutShort)) -> Result<(), LoggerError> {
        for sample in samples {
            if sample.run != self.run {
                return Err(LoggerError::OtherRun { expected: self.run, got: sample.run });
            }
            if self.writer.cut_short().is_some() {
                continue;
            }
            let reports = reports(&mut self.writer, || self.amplifier.as_mut()?.before(sample));
            match reports.and_then(|()| self.writer.write(sample)) {
                Ok(()) => {
                    self.recorded += 1;
                    self.last = Some(*sample);
                }
                Err(CampaignError::CutShort(cut)) => on_cut(&cut),
                // One sample that can't be recorded is no reason to lose those after it.
                Err(error @ CampaignError::Content(_)) => {
                    if self.refused.samples == 0 {
                        self.refused.first = error.to_string();
                    }
                    self.refused.samples += 1;
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// The amplifier's reports within the last tick, and what is missing of all.
    fn end_reports(&mut self) -> Result<u64, CampaignError> {
        let (Some(amplifier), Some(last)) = (&mut self.amplifier, self.last) else { return Ok(0) };
        reports(&mut self.writer, || amplifier.within(&last))?;
        let lost = amplifier.lost();
        if lost > 0 {
            let text = format!("{lost} reports of the amplifier are missing: they came faster than they were recorded");
            let (tick, scheduled_ns, source) = (last.tick, last.scheduled_ns, "logger".to_owned());
            self.writer.write_event(&Event { tick, scheduled_ns, severity: Severity::Warning, source, text })?;
        }
        Ok(lost)
    }

    /// `arrived`: what the subscriber can certify of the run.
    fn close(
        mut self,
        events: &[Event],
        arrived: LossCertificate,
        on_cut: &mut dyn FnMut(&CutShort),
    ) -> Result<Recorded, LoggerError> {
        let cut_before = self.writer.cut_short().is_some();
        let written = self.end_reports();
        let lost_reports = *written.as_ref().unwrap_or(&0);
        let written = written.and_then(|_| events.iter().try_for_each(|event| self.writer.write_event(event)));
        let refused = self.refused;
        let certificate = if refused.samples == 0 {
            arrived
        } else {
            // What arrived and was refused is missing in the file all the same.
            let LossCertificate { run, expected, end_seen, .. } = arrived;
            LossCertificate { run, end_seen, ..self.writer.certificate(expected) }
        };
        let finished = written.and_then(|()| self.writer.finish(&certificate));
        match finished {
            Ok(path) => Ok(Recorded { path, certificate, lost_reports, refused, cut_short: None }),
            Err(CampaignError::CutShort(cut)) => {
                if !cut_before {
                    on_cut(&cut);
                }
                let LossCertificate { run, expected, end_seen, .. } = certificate;
                let certificate = LossCertificate { run, end_seen, ..cut.of_run(expected) };
                Ok(Recorded { path: cut.file.clone(), certificate, lost_reports, refused, cut_short: Some(cut) })
            }
            Err(error) => Err(error.into()),
        }
    }
}

/// Appends reports for as long as there are any.
fn reports(writer: &mut McapWriter, mut next: impl FnMut() -> Option<AmplifierReport>) -> Result<(), CampaignError> {
    std::iter::from_fn(&mut next).try_for_each(|report| writer.write_amplifier(&report))
}

fn take(subscriber: &mut SampleSubscriber, into: &mut Vec<Sample>, wait: Duration) -> Result<usize, LoggerError> {
    into.clear();
    Ok(if wait.is_zero() { subscriber.drain(into)? } else { subscriber.receive(wait, into)? })
}
