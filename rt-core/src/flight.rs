//! The flight recorder: the last ticks of the loop with their stage times, in memory that exists before the run. On a missed
//! deadline, a trip or a fault it goes on for a moment and is then handed to whoever writes it down; the loop itself neither
//! copies nor allocates nor waits, it goes on with a spare recorder.

use std::fmt;

use ringbuf::traits::{Consumer, Producer, Split};
use ringbuf::{HeapCons, HeapProd, HeapRb};

use crate::supervisor::Channel;
use crate::types::{PERIOD_NS, Sample};

/// Ticks that the recorder holds.
pub const DEPTH: usize = 2_000;
/// Ticks that it still records after an incident.
const AFTERMATH_TICKS: u64 = 200;
/// Recorders: one records, the others are being written or wait to take over.
const SPARES: usize = 3;

/// A tick in the recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightTick {
    /// As it was published.
    pub sample: Sample,
    /// Duration of its hand-over to the publication, ns.
    pub publish_ns: u32,
    /// From the time at which the tick should have begun to the end of its last stage, ns; 0 in virtual time.
    pub ended_ns: u64,
}

/// What the recorder was kept for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// This tick ended after the next one should have begun.
    Overrun,
    /// The supervisor tripped at this tick.
    Trip,
    /// The device failed within this tick.
    Fault,
}

impl Reason {
    /// For people and files.
    pub fn name(self) -> &'static str {
        match self {
            Reason::Overrun => "overrun",
            Reason::Trip => "trip",
            Reason::Fault => "fault",
        }
    }
}

/// Who took the time of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Culprit {
    /// The system woke the loop's thread too late.
    Kernel,
    /// The ticks before it were late already.
    EarlierTicks,
    /// The device took long to read or to write.
    Device,
    /// Supervisor, profile or controller took long.
    Controller,
    /// The hand-over to the publication took long.
    Publication,
}

impl Culprit {
    /// For people and files.
    pub fn name(self) -> &'static str {
        match self {
            Culprit::Kernel => "late wake-up by the kernel",
            Culprit::EarlierTicks => "backlog of earlier ticks",
            Culprit::Device => "slow device",
            Culprit::Controller => "slow controller",
            Culprit::Publication => "slow publication",
        }
    }
}

impl fmt::Display for Culprit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FlightTick {
    /// Nothing recorded.
    const BLANK: FlightTick = FlightTick { sample: Sample::BLANK, publish_ns: 0, ended_ns: 0 };

    /// It ended after the next tick should have begun.
    pub fn overran(&self) -> bool {
        self.ended_ns >= PERIOD_NS
    }

    /// The parts of the tick, ns, from the time at which it should have begun.
    pub fn shares(&self) -> [(Culprit, u64); 5] {
        let s = &self.sample;
        let sum = |parts: &[u32]| parts.iter().map(|&part| u64::from(part)).sum();
        [
            (Culprit::Kernel, s.lateness_ns.saturating_sub(u64::from(s.behind_ns))),
            (Culprit::EarlierTicks, u64::from(s.behind_ns)),
            (Culprit::Device, sum(&[s.read_ns, s.write_ns])),
            (Culprit::Controller, sum(&[s.check_ns, s.reference_ns, s.control_ns])),
            (Culprit::Publication, u64::from(self.publish_ns)),
        ]
    }

    /// The largest part.
    pub fn culprit(&self) -> Culprit {
        self.shares().into_iter().max_by_key(|&(_, ns)| ns).map_or(Culprit::Kernel, |(culprit, _)| culprit)
    }
}

/// A handed-over recorder: what happened, and the ticks around it, oldest first.
#[derive(Clone, Debug, PartialEq)]
pub struct Incident {
    /// Why it was kept.
    pub reason: Reason,
    /// The tick at which it happened.
    pub tick: u64,
    /// Further incidents within the recorded ticks, which this one record covers.
    pub further: u32,
    /// At most [`DEPTH`] ticks; the incident's tick is among them.
    pub ticks: Vec<FlightTick>,
}

impl Incident {
    /// The incident's tick.
    pub fn at(&self) -> Option<&FlightTick> {
        self.ticks.iter().find(|t| t.sample.tick == self.tick)
    }

    /// Median of a culprit's share over the recorded ticks, ns: what is usual.
    pub fn usual_ns(&self, culprit: Culprit) -> u64 {
        let of = |tick: &FlightTick| tick.shares().into_iter().find(|s| s.0 == culprit).map_or(0, |s| s.1);
        let mut all: Vec<u64> = self.ticks.iter().map(of).collect();
        all.sort_unstable();
        all.get(all.len() / 2).copied().unwrap_or(0)
    }
}

impl fmt::Display for Incident {
    /// One line: what, at which tick, and who took the time.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at tick {}", self.reason.name(), self.tick)?;
        let Some(at) = self.at() else { return Ok(()) };
        if self.reason == Reason::Overrun {
            let culprit = at.culprit();
            let ms = |ns: u64| ns as f64 * 1e-6;
            let took = at.shares().into_iter().find(|s| s.0 == culprit).map_or(0, |s| s.1);
            write!(
                f,
                ": {culprit}, {:.3} ms (usually {:.4} ms) of {:.3} ms; a period is {:.0} ms",
                ms(took),
                ms(self.usual_ns(culprit)),
                ms(at.ended_ns),
                ms(PERIOD_NS),
            )?;
        }
        if self.further > 0 {
            write!(f, "; {} more within the record", self.further)?;
        }
        Ok(())
    }
}

/// One recorder's memory.
struct Ring {
    ticks: Box<[FlightTick]>,
    recorded: usize,
    incident: Option<(Reason, u64)>,
    further: u32,
}

impl Ring {
    fn new() -> Box<Self> {
        Box::new(Ring { ticks: vec![FlightTick::BLANK; DEPTH].into(), recorded: 0, incident: None, further: 0 })
    }

    fn push(&mut self, tick: FlightTick) {
        self.ticks[self.recorded % DEPTH] = tick;
        self.recorded += 1;
    }

    fn clear(&mut self) {
        (self.recorded, self.incident, self.further) = (0, None, 0);
    }

    fn read(&self) -> Option<Incident> {
        let (reason, tick) = self.incident?;
        let oldest = self.recorded.saturating_sub(DEPTH);
        let ticks = (oldest..self.recorded).map(|i| self.ticks[i % DEPTH]).collect();
        Some(Incident { reason, tick, further: self.further, ticks })
    }
}

/// The loop's end.
pub struct FlightRecorder {
    ring: Box<Ring>,
    spares: HeapCons<Box<Ring>>,
    kept: HeapProd<Box<Ring>>,
    tripped: bool,
    unwritten: u64,
}

/// The other end, for a thread that may write files.
pub struct FlightLog {
    kept: HeapCons<Box<Ring>>,
    spares: HeapProd<Box<Ring>>,
}

/// A recorder and the end from which its incidents are taken.
pub fn recorder() -> (FlightRecorder, FlightLog) {
    let (mut spare_in, spare_out) = HeapRb::new(SPARES + 1).split();
    let (kept_in, kept_out) = HeapRb::new(SPARES + 1).split();
    spare_in.push_iter((0..SPARES).map(|_| Ring::new()));
    let recorder = FlightRecorder { ring: Ring::new(), spares: spare_out, kept: kept_in, tripped: false, unwritten: 0 };
    (recorder, FlightLog { kept: kept_out, spares: spare_in })
}

impl FlightRecorder {
    /// A run begins: the recorder forgets the one before.
    pub fn begin_run(&mut self) {
        self.ring.clear();
        self.tripped = false;
        self.unwritten = 0;
    }

    /// A tick is over.
    pub fn record(&mut self, tick: FlightTick) {
        self.ring.push(tick);
        let sample = &tick.sample;
        if sample.fault() {
            self.mark(Reason::Fault, sample.tick);
        } else if tick.overran() {
            self.mark(Reason::Overrun, sample.tick);
        }
        // The latch shows in every later sample too; the incident is its first.
        if sample.tripped() && !self.tripped && !self.follows_overrun(sample) {
            self.mark(Reason::Trip, sample.tick);
        }
        self.tripped = sample.tripped();
        if self.ring.incident.is_some_and(|(_, at)| sample.tick >= at + AFTERMATH_TICKS) {
            self.hand_over();
        }
    }

    /// The run is over: an incident that is still waiting for its aftermath is handed over. Returns how many incidents
    /// could not be kept, because nobody took those before them.
    pub fn end_run(&mut self) -> u64 {
        if self.ring.incident.is_some() {
            self.hand_over();
        }
        self.unwritten
    }

    /// A trip for the missed deadline that is on record already: the culprit is in that tick, not in this one.
    fn follows_overrun(&self, sample: &Sample) -> bool {
        let overran = self.ring.incident.is_some_and(|(reason, _)| reason == Reason::Overrun);
        overran && Channel::of_code(sample.trip) == Some(Channel::Deadline)
    }

    fn mark(&mut self, reason: Reason, tick: u64) {
        match self.ring.incident {
            None => self.ring.incident = Some((reason, tick)),
            // What stops a run is told before what only delayed it.
            Some((Reason::Overrun, _)) if reason != Reason::Overrun => {
                self.ring.incident = Some((reason, tick));
                self.ring.further += 1;
            }
            Some(_) => self.ring.further += 1,
        }
    }

    fn hand_over(&mut self) {
        match self.spares.try_pop() {
            Some(spare) => {
                let full = std::mem::replace(&mut self.ring, spare);
                // There is room for every ring that exists.
                if self.kept.try_push(full).is_err() {
                    self.unwritten += 1;
                }
            }
            None => {
                self.unwritten += 1;
                self.ring.clear();
            }
        }
    }
}

impl FlightLog {
    /// The oldest incident that was handed over and not taken yet. Allocates: not for the loop's thread.
    pub fn take(&mut self) -> Option<Incident> {
        let mut ring = self.kept.try_pop()?;
        let incident = ring.read();
        ring.clear();
        // There is room for every ring that exists; the recorder copes with one less.
        let _ = self.spares.try_push(ring);
        incident
    }
}
