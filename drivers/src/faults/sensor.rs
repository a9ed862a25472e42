//! A sensor's way to the loop.

use super::injected::Injected;
use super::route::Route;
use rt_core::fault::{FaultKind, RAW_BITS};
use rt_core::{Input, Measurement, Tick};

/// A value with the time at which it was measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    value: f64,
    /// Since the run's start, ns; below 0 where it was measured before.
    measured_ns: i64,
    /// The device calls it wrong.
    faulty: bool,
}

impl Frame {
    /// What the device gives for this input at this time.
    pub fn of(measured: &Measurement, input: Input, now_ns: i64) -> Frame {
        Frame {
            value: measured.value(input),
            measured_ns: now_ns - i64::from(measured.age_ns[input as usize]),
            faulty: measured.faulty & input.bit() != 0,
        }
    }

    /// The device gives nothing new.
    fn is_the_same(&self, other: &Frame) -> bool {
        let Frame { value, measured_ns, faulty } = *other;
        self.value.to_bits() == value.to_bits() && (self.measured_ns, self.faulty) == (measured_ns, faulty)
    }
}

/// What becomes of a frame on its way.
#[derive(Clone, Copy)]
enum Fate {
    Arrives,
    Lost,
    Late { ticks: u64, unnoticed: bool },
    Repeated { unnoticed: bool },
    Held { unnoticed: bool },
    Refused,
}

/// A frame that is late or held back, and what the driver can tell of it.
#[derive(Clone, Copy)]
struct Delayed {
    frame: Frame,
    /// Age when it was sent, ns, where the driver takes it for fresh.
    unnoticed_age_ns: Option<i64>,
}

impl Delayed {
    fn new(frame: Frame, unnoticed: bool, now_ns: i64) -> Self {
        Delayed { frame, unnoticed_age_ns: unnoticed.then_some(now_ns - frame.measured_ns) }
    }
}

/// A sensor, its frames on their way, and what the loop sees.
pub(super) struct Sensor {
    pub input: Input,
    /// A fault of the run concerns it; otherwise it is not looked at.
    pub concerned: bool,
    /// What the device gave last.
    given: Option<Frame>,
    /// To the loop. What is shown is its newest.
    route: Route<Delayed>,
    /// A frame that waits for the one after it, with its number.
    held: Option<(u64, Delayed)>,
    /// A frame of this tick was refused.
    refused: bool,
}

impl Sensor {
    pub fn new(input: Input, concerned: bool, delay_ticks: u32) -> Self {
        Sensor { input, concerned, given: None, route: Route::new(delay_ticks, None), held: None, refused: false }
    }

    pub fn begin_run(&mut self) {
        self.route.begin_run();
        (self.given, self.held, self.refused) = (None, None, false);
    }

    /// What the device gives at this tick goes on its way, and what arrives at this tick does.
    pub fn hear(&mut self, given: Frame, now: Tick, bus_off: bool, faults: &mut [Injected]) {
        self.refused = false;
        let fresh = self.given.is_none_or(|before| !before.is_the_same(&given));
        self.given = Some(given);
        if bus_off {
            self.route.cut();
            self.held = None;
            return;
        }
        let now_ns = now.scheduled_ns as i64;
        // Before the frame of this tick: what was on its way longer is there first.
        while let Some((number, late)) = self.route.arrived(now) {
            self.arrive(now, number, late);
        }
        if !fresh {
            return;
        }
        let (frame, fate) = self.meet(given, now, faults);
        let held = self.held.take();
        match fate {
            Fate::Arrives => self.route.arrive(now, Delayed::new(frame, false, now_ns)),
            Fate::Lost => {
                self.route.skip();
            }
            Fate::Late { ticks, unnoticed } => self.route.send_late(now, ticks, Delayed::new(frame, unnoticed, now_ns)),
            Fate::Repeated { unnoticed } => {
                self.route.skip();
                if unnoticed {
                    self.route.renew(|shown| shown.frame.measured_ns = frame.measured_ns);
                }
            }
            Fate::Held { unnoticed } => {
                self.held = Some((self.route.skip(), Delayed::new(frame, unnoticed, now_ns)));
            }
            Fate::Refused => {
                self.route.skip();
                self.refused = true;
            }
        }
        if let Some((number, held)) = held {
            self.arrive(now, number, held);
        }
    }

    /// A frame that was held up arrives. A driver that can't tell takes it for the newest there is.
    fn arrive(&mut self, now: Tick, number: u64, delayed: Delayed) {
        match delayed.unnoticed_age_ns {
            None => self.route.take(now, number, delayed),
            Some(age_ns) => {
                let measured_ns = now.scheduled_ns as i64 - age_ns;
                let frame = Frame { measured_ns, ..delayed.frame };
                self.route.arrive(now, Delayed { frame, unnoticed_age_ns: None });
            }
        }
    }

    /// What the faults that act on this sensor make of a frame.
    fn meet(&self, given: Frame, now: Tick, faults: &mut [Injected]) -> (Frame, Fate) {
        let mut frame = given;
        // The sensor itself, then the wire.
        for fault in faults.iter_mut().filter(|fault| fault.acting() && fault.kind().input() == Some(self.input)) {
            let finite = frame.value.is_finite();
            match fault.kind() {
                FaultKind::Stuck { .. } if finite => frame.value = fault.remember_value(frame.value),
                FaultKind::Drift { per_s, .. } if finite => frame.value += per_s * fault.seconds(now),
                FaultKind::Nan { .. } if fault.hits(now) => frame.value = f64::NAN,
                _ => continue,
            }
            fault.struck();
        }
        let mut fate = Fate::Arrives;
        for fault in faults.iter_mut().filter(|fault| fault.acting() && fault.kind().input() == Some(self.input)) {
            if !matches!(fate, Fate::Arrives) {
                break;
            }
            let next = match fault.kind() {
                FaultKind::BitFlip { .. } => None,
                FaultKind::Lost { .. } => Some(Fate::Lost),
                FaultKind::Late { ticks, unnoticed, .. } => Some(Fate::Late { ticks: u64::from(ticks), unnoticed }),
                FaultKind::Repeated { unnoticed, .. } => Some(Fate::Repeated { unnoticed }),
                FaultKind::Swapped { unnoticed, .. } if self.held.is_none() => Some(Fate::Held { unnoticed }),
                FaultKind::CrcError { .. } => Some(Fate::Refused),
                _ => continue,
            };
            if !fault.hits(now) {
                continue;
            }
            match (next, fault.kind()) {
                (Some(next), _) => fate = next,
                (None, FaultKind::BitFlip { bit, low, high, .. }) if frame.value.is_finite() => {
                    let bit = bit.unwrap_or_else(|| fault.any_bit(RAW_BITS));
                    frame.value = flipped(frame.value, bit, low, high);
                }
                (None, _) => continue,
            }
            fault.struck();
        }
        (frame, fate)
    }

    /// Puts what the driver would know at this time into the measurement.
    pub fn show(&self, now_ns: i64, measured: &mut Measurement) {
        let (value, measured_ns, faulty) = match self.route.newest() {
            Some(Delayed { frame: Frame { value, measured_ns, faulty }, .. }) => (value, measured_ns, faulty),
            // Nothing was heard since the run's start.
            None => (f64::NAN, 0, false),
        };
        *measured.value_mut(self.input) = value;
        measured.age_ns[self.input as usize] = u32::try_from((now_ns - measured_ns).max(0)).unwrap_or(u32::MAX);
        let bit = self.input.bit();
        measured.faulty = if faulty || self.refused { measured.faulty | bit } else { measured.faulty & !bit };
    }
}

/// The value with one bit of its raw value being the other one: 0 .. 65535 over `low` .. `high`, and at the ends beyond.
fn flipped(value: f64, bit: u8, low: f64, high: f64) -> f64 {
    let most = f64::from((1u32 << RAW_BITS) - 1);
    // Within 0 ..= 65535 after the clamp.
    let raw = ((value - low) / (high - low) * most).round().clamp(0.0, most) as u32;
    let other = raw ^ (1 << bit);
    value + (f64::from(other) - f64::from(raw)) / most * (high - low)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flipped_bit_moves_the_value_by_its_weight_and_back() {
        for input in Input::ALL {
            let (low, high) = rt_core::fault::full_scale(input);
            let step = (high - low) / 65_535.0;
            for bit in 0..RAW_BITS {
                let value = low + 0.3 * (high - low);
                let moved = flipped(value, bit, low, high);
                let weight = step * f64::from(1u32 << bit);
                assert!(((moved - value).abs() - weight).abs() < 1e-9, "{input:?}, bit {bit}: {value} -> {moved}");
                assert!((flipped(moved, bit, low, high) - value).abs() < 1e-9);
                assert!((low - 1e-9..=high + 1e-9).contains(&moved));
            }
        }
    }
}
