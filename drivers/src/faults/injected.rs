//! A fault with its place in time, its chance and its entries in the journal.

use crate::journal::{Journal, Severity, When};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rt_core::fault::{Fault, FaultKind};
use rt_core::{PERIOD_NS, Tick};

/// The first stream of the seed for faults: those before are the emulated rig's, which may have the same seed.
const FIRST_STREAM: u64 = 1000;
/// Words of a fault's stream for one tick.
const WORDS_A_TICK: u128 = 16;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Before,
    /// Acts since this tick.
    Acting(u64),
    Over,
}

/// A fault of a run.
pub(super) struct Injected {
    fault: Fault,
    number: usize,
    phase: Phase,
    struck: u64,
    random: ChaCha8Rng,
    /// What was seen when it began to act: a stuck sensor's value.
    value: Option<f64>,
    /// What was seen when it began to act: a stuck valve's position.
    open: Option<bool>,
}

impl Injected {
    pub fn new(fault: Fault, index: usize, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(FIRST_STREAM + index as u64);
        Injected { fault, number: index + 1, phase: Phase::Before, struck: 0, random, value: None, open: None }
    }

    pub fn begin_run(&mut self) {
        (self.phase, self.struck, self.value, self.open) = (Phase::Before, 0, None, None);
    }

    pub fn kind(&self) -> FaultKind {
        self.fault.kind
    }

    pub fn acting(&self) -> bool {
        matches!(self.phase, Phase::Acting(_))
    }

    /// Begins or ends by this tick, and notes it; says whether it has ended just now.
    pub fn reach(&mut self, now: Tick, journal: &mut Journal) -> bool {
        let acts = self.fault.acts_at(now.index);
        if self.phase == Phase::Before && now.index >= self.fault.from_tick {
            self.phase = Phase::Acting(now.index);
            let Fault { kind, probability, ticks, .. } = self.fault;
            let number = self.number;
            let when = When::Tick(now.index);
            match ticks {
                Some(ticks) => {
                    let text = format_args!("fault {number} began, {kind}; share {probability}, for {ticks} ms");
                    journal.note(when, Severity::Warning, text);
                }
                None => {
                    let text = format_args!("fault {number} began, {kind}; share {probability}, to the run's end");
                    journal.note(when, Severity::Warning, text);
                }
            }
        }
        let ends = !acts && self.acting();
        if ends {
            self.end(now, "over", journal);
        }
        ends
    }

    /// The run is over; says whether this acted until now.
    pub fn end_run(&mut self, now: Tick, journal: &mut Journal) -> bool {
        let acted = self.acting();
        if acted {
            self.end(now, "over with the run", journal);
        }
        acted
    }

    fn end(&mut self, now: Tick, how: &str, journal: &mut Journal) {
        let since = match self.phase {
            Phase::Acting(since) => since,
            _ => now.index,
        };
        self.phase = Phase::Over;
        let Injected { number, fault: Fault { kind, .. }, struck, .. } = self;
        let text = format_args!("fault {number} {how}, {kind}; struck {struck} times since tick {since}");
        journal.note(When::Tick(now.index), Severity::Info, text);
    }

    /// Whether it hits a frame of this tick. The same at each call: chance is a function of seed, fault and tick.
    pub fn hits(&mut self, now: Tick) -> bool {
        self.random.set_word_pos(u128::from(now.index) * WORDS_A_TICK);
        self.fault.probability >= 1.0 || self.random.random_bool(self.fault.probability)
    }

    /// A bit below `bits`, drawn for the frame that was hit just now.
    pub fn any_bit(&mut self, bits: u8) -> u8 {
        self.random.random_range(0..bits)
    }

    /// It has done something.
    pub fn struck(&mut self) {
        self.struck += 1;
    }

    /// The value that it was given first since it acts.
    pub fn remember_value(&mut self, value: f64) -> f64 {
        *self.value.get_or_insert(value)
    }

    /// The position that it was given first since it acts.
    pub fn remember_open(&mut self, open: bool) -> bool {
        *self.open.get_or_insert(open)
    }

    /// Time since it should have begun, s.
    pub fn seconds(&self, now: Tick) -> f64 {
        now.index.saturating_sub(self.fault.from_tick) as f64 * PERIOD_NS as f64 * 1e-9
    }
}
