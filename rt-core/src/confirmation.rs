//! What people at the rig are asked for, and how their word reaches the loop: a slot without locks between any thread and the tick.
//!
//! The loop judges a confirmation at the tick at which it finds it, and says what became of it. So nobody has to guess whether a word came
//! in time.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::types::{Input, Measurement, Tick};

/// A number that a confirmation must bring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Amount {
    /// What the measuring cylinder reads, ml.
    VolumeMl,
}

/// What the run waits for at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waiting {
    /// Number of the request among those of the run's profile.
    pub request: u32,
    /// The number that is asked for, if any.
    pub amount: Option<Amount>,
}

/// What somebody at the rig says: it is done.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Confirmation {
    /// The request that it answers; `None` = the one that is open, whichever it is.
    pub request: Option<u32>,
    /// What the measuring cylinder reads, ml.
    pub volume_ml: Option<f64>,
}

/// Why a confirmation was not taken. The run goes on as if it had not been said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Nothing is asked for at this tick: it comes too early, too late, or twice.
    #[error("nothing waits for a confirmation now; `bench confirm --show` says what is asked")]
    NothingWaits,
    /// Another request is open by now.
    #[error("it answers a request that is not the open one; look at what is asked for now")]
    OtherRequest,
    /// A number is asked for, and neither the confirmation nor the device has it.
    #[error("expected the amount in ml with the confirmation, got none")]
    AmountMissing,
    /// No number is asked for.
    #[error("expected a confirmation without an amount, got one with; is it meant for another request?")]
    AmountUnasked,
    /// It is no number.
    #[error("expected a finite amount in ml, got none")]
    AmountNotFinite,
    /// No run looks at confirmations, or its loop is held up.
    #[error("no run has answered; does one go on?")]
    NoAnswer,
    /// Whoever carries the command to the rig's machine may only look there.
    #[error("the link to the rig's machine is read-only; start it there with --control")]
    ReadOnly,
    /// The rig's machine can't be reached.
    #[error("the rig's machine does not answer; use the emergency stop at the rig, and check the link")]
    Unreachable,
}

impl Refusal {
    /// All of them.
    pub const ALL: [Refusal; 8] = [
        Refusal::NothingWaits,
        Refusal::OtherRequest,
        Refusal::AmountMissing,
        Refusal::AmountUnasked,
        Refusal::AmountNotFinite,
        Refusal::NoAnswer,
        Refusal::ReadOnly,
        Refusal::Unreachable,
    ];
}

impl Confirmation {
    /// Whether it is what the run waits for. An amount may be left out where the device itself measures it at this tick.
    ///
    /// # Errors
    /// Why it is not.
    pub fn judge(&self, waiting: Option<Waiting>, measured: &Measurement) -> Result<(), Refusal> {
        let waiting = waiting.ok_or(Refusal::NothingWaits)?;
        if self.request.is_some_and(|request| request != waiting.request) {
            return Err(Refusal::OtherRequest);
        }
        match (waiting.amount, self.volume_ml) {
            (_, Some(volume_ml)) if !volume_ml.is_finite() => Err(Refusal::AmountNotFinite),
            (None, Some(_)) => Err(Refusal::AmountUnasked),
            (Some(Amount::VolumeMl), None) if !measured.is_valid(Input::Volume) => Err(Refusal::AmountMissing),
            _ => Ok(()),
        }
    }

    /// The amount becomes the measured value of the tick: valid, and of this moment.
    pub(crate) fn enter(&self, measured: &mut Measurement) {
        if let Some(volume_ml) = self.volume_ml {
            measured.volume_ml = volume_ml;
            measured.age_ns[Input::Volume as usize] = 0;
            measured.faulty &= !Input::Volume.bit();
        }
    }
}

/// Nobody has offered anything.
const FREE: u32 = 0;
/// Somebody is about to offer.
const CLAIMED: u32 = 1;
/// For the loop to judge.
const OFFERED: u32 = 2;
/// The loop is judging.
const HELD: u32 = 3;
/// For whoever offered to read.
const JUDGED: u32 = 4;

/// No request; or no amount, as the bits of a NaN that no amount has.
const NONE: u64 = u64::MAX;
/// The verdict of a confirmation that was taken; otherwise 1 + index of [`Refusal::ALL`].
const TAKEN: u32 = 0;

/// Between two looks of a thread that waits for a verdict.
const LOOK: Duration = Duration::from_millis(1);

/// One confirmation on its way to the loop, and the loop's word on it. Any thread may offer one; while it is on its way, others must
/// wait their turn. The loop's side neither waits nor allocates.
#[derive(Debug)]
pub struct ConfirmationSlot {
    stage: AtomicU32,
    request: AtomicU64,
    volume_bits: AtomicU64,
    verdict: AtomicU32,
    tick: AtomicU64,
    /// What the run waits for, as [`packed`].
    waiting: AtomicU64,
}

impl Default for ConfirmationSlot {
    fn default() -> Self {
        ConfirmationSlot::new()
    }
}

fn packed(waiting: Option<Waiting>) -> u64 {
    waiting.map_or(NONE, |waiting| u64::from(waiting.request) << 1 | u64::from(waiting.amount.is_some()))
}

impl ConfirmationSlot {
    /// Nothing is asked for and nothing is on its way.
    pub const fn new() -> Self {
        ConfirmationSlot {
            stage: AtomicU32::new(FREE),
            request: AtomicU64::new(NONE),
            volume_bits: AtomicU64::new(NONE),
            verdict: AtomicU32::new(TAKEN),
            tick: AtomicU64::new(0),
            waiting: AtomicU64::new(NONE),
        }
    }

    /// What the run waits for, as of its last tick.
    pub fn waiting(&self) -> Option<Waiting> {
        match self.waiting.load(Ordering::Relaxed) {
            NONE => None,
            bits => Some(Waiting { request: (bits >> 1) as u32, amount: (bits & 1 != 0).then_some(Amount::VolumeMl) }),
        }
    }

    /// Puts a confirmation before the loop. `false`: another one is on its way, try again.
    #[must_use]
    pub fn offer(&self, confirmation: Confirmation) -> bool {
        if self.stage.compare_exchange(FREE, CLAIMED, Ordering::Acquire, Ordering::Relaxed).is_err() {
            return false;
        }
        self.request.store(confirmation.request.map_or(NONE, u64::from), Ordering::Relaxed);
        // A NaN of whatever payload is refused; it must only not read as absence.
        let bits =
            confirmation.volume_ml.map_or(NONE, |ml| if ml.is_nan() { f64::NAN.to_bits() } else { ml.to_bits() });
        self.volume_bits.store(bits, Ordering::Relaxed);
        self.stage.store(OFFERED, Ordering::Release);
        true
    }

    /// For whoever offered: the tick at which it was taken, or why not; `None` = not judged yet. Said once.
    pub fn verdict(&self) -> Option<Result<u64, Refusal>> {
        if self.stage.load(Ordering::Acquire) != JUDGED {
            return None;
        }
        let verdict = match self.verdict.load(Ordering::Relaxed) {
            TAKEN => Ok(self.tick.load(Ordering::Relaxed)),
            refused => Err(Refusal::ALL[refused as usize - 1]),
        };
        self.stage.store(FREE, Ordering::Release);
        Some(verdict)
    }

    /// For whoever offered: takes the confirmation back. `false`: it is judged, or just being judged.
    #[must_use]
    pub fn withdraw(&self) -> bool {
        self.stage.compare_exchange(OFFERED, FREE, Ordering::AcqRel, Ordering::Relaxed).is_ok()
    }

    /// Offers a confirmation and waits for the loop's word, up to `patience`. Not for the loop's thread.
    ///
    /// # Errors
    /// Why it was not taken.
    pub fn confirm(&self, confirmation: Confirmation, patience: Duration) -> Result<u64, Refusal> {
        let begun = Instant::now();
        while !self.offer(confirmation) {
            if begun.elapsed() >= patience {
                return Err(Refusal::NoAnswer);
            }
            std::thread::sleep(LOOK);
        }
        loop {
            if let Some(verdict) = self.verdict() {
                return verdict;
            }
            // A verdict that is just being made is waited for: it takes less than a tick.
            if begun.elapsed() >= patience && self.withdraw() {
                return Err(Refusal::NoAnswer);
            }
            std::thread::sleep(LOOK);
        }
    }

    /// The loop's side: shows what is waited for, and takes what was offered if it is that.
    pub fn take(&self, now: Tick, waiting: Option<Waiting>, measured: &Measurement) -> Option<Confirmation> {
        let shown = packed(waiting);
        if self.waiting.load(Ordering::Relaxed) != shown {
            self.waiting.store(shown, Ordering::Relaxed);
        }
        if self.stage.load(Ordering::Relaxed) != OFFERED {
            return None;
        }
        self.judge_offered(now, waiting, measured)
    }

    #[cold]
    fn judge_offered(&self, now: Tick, waiting: Option<Waiting>, measured: &Measurement) -> Option<Confirmation> {
        // It may have been withdrawn meanwhile.
        self.stage.compare_exchange(OFFERED, HELD, Ordering::Acquire, Ordering::Relaxed).ok()?;
        let request = Some(self.request.load(Ordering::Relaxed)).filter(|&bits| bits != NONE);
        let volume = Some(self.volume_bits.load(Ordering::Relaxed)).filter(|&bits| bits != NONE);
        let confirmation =
            Confirmation { request: request.map(|request| request as u32), volume_ml: volume.map(f64::from_bits) };
        let judged = confirmation.judge(waiting, measured);
        let verdict = match judged {
            Ok(()) => TAKEN,
            Err(refusal) => 1 + Refusal::ALL.iter().position(|&other| other == refusal).unwrap_or(0) as u32,
        };
        self.verdict.store(verdict, Ordering::Relaxed);
        self.tick.store(now.index, Ordering::Relaxed);
        self.stage.store(JUDGED, Ordering::Release);
        judged.is_ok().then_some(confirmation)
    }

    /// The run is over, whatever its end: nothing is asked for any more.
    pub fn run_over(&self) {
        self.waiting.store(NONE, Ordering::Relaxed);
    }
}
