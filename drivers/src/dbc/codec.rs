//! One signal as shifts and masks: what the loop calls for each frame. No allocation, no text.

use arrayvec::{ArrayString, ArrayVec};
use thiserror::Error;

/// Most bytes of a classic frame: a signal lies in one 64-bit word.
pub(super) const FRAME_BYTES: usize = 8;
/// Names in a database have at most 32 characters; longer ones are cut in messages of the codec.
const NAME_BYTES: usize = 32;
/// Most conditions that one signal can depend on.
pub(super) const MOST_GATES: usize = 4;

/// Added before truncation it rounds to the nearest, ties away from 0: the largest double below 0.5, for 0.5 itself would carry the value
/// before 0.5 and odd values beyond 2^52 too far. `f64::round` would be a call on processors of the base architecture.
const HALF: f64 = 0.5f64.next_down();

/// A signal that can't take a value, or a frame that has no room for the signal. Made without allocation.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum OutOfRange {
    /// The value has no representation in the signal's bits.
    #[error("signal {signal}: expected a value in {minimum}..={maximum}, got {got}")]
    Value {
        /// Name of the signal, its first 32 bytes.
        signal: ArrayString<NAME_BYTES>,
        /// What was to be encoded, in the signal's unit.
        got: f64,
        /// Lowest value that the bits can hold, in the signal's unit.
        minimum: f64,
        /// Highest.
        maximum: f64,
    },
    /// The frame ends before the signal does.
    #[error("signal {signal}: expected a frame of at least {needed} bytes, got {got}")]
    Frame {
        /// Name of the signal, its first 32 bytes.
        signal: ArrayString<NAME_BYTES>,
        /// Bytes of the frame.
        got: usize,
        /// Bytes up to the signal's end.
        needed: usize,
    },
}

/// Where bits lie in a frame of at most 8 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Field {
    /// Motorola: the word is read with the first byte as its highest.
    big_endian: bool,
    /// From the word's lowest bit to the field's lowest, 0..=63.
    shift: u8,
    /// Bits of a word that the field has not, 0..=63.
    unused: u8,
    /// Bytes that a frame must have to hold it, 1..=8.
    bytes: u8,
}

// Shifts are masked with 63 where they are used: they are below 64 by construction, and the mask spares the loop the check.
impl Field {
    /// A field as the file describes it: `start` is the number of its lowest bit in Intel order, that of its highest in Motorola order;
    /// bit n is bit n mod 8 of byte n / 8. `None` where it does not lie in 8 bytes, or has not 1 to 64 bits.
    pub(super) fn new(start: u64, width: u64, big_endian: bool) -> Option<Field> {
        if !(1..=64).contains(&width) || start >= 64 {
            return None;
        }
        // In the order in which the field's bits follow one another, its first bit's place.
        let first = if big_endian { start / 8 * 8 + (7 - start % 8) } else { start };
        let end = first + width;
        if end > 64 {
            return None;
        }
        // All at most 64.
        let shift = if big_endian { 64 - end } else { first } as u8;
        Some(Field { big_endian, shift, unused: (64 - width) as u8, bytes: end.div_ceil(8) as u8 })
    }

    pub(super) fn bytes(&self) -> usize {
        usize::from(self.bytes)
    }

    /// Number of its bits, 1..=64.
    fn width(&self) -> i32 {
        64 - i32::from(self.unused)
    }

    /// The largest raw value.
    #[inline]
    pub(super) fn mask(&self) -> u64 {
        u64::MAX >> (self.unused & 63)
    }

    /// Its bits in the little-endian word of a frame.
    pub(super) fn bits(&self) -> u64 {
        let bits = self.mask() << self.shift;
        if self.big_endian { bits.swap_bytes() } else { bits }
    }

    /// Its raw value; `word` is a frame's data, little-endian, 0 beyond its end.
    #[inline]
    fn read(&self, word: u64) -> u64 {
        let word = if self.big_endian { word.swap_bytes() } else { word };
        (word >> (self.shift & 63)) & self.mask()
    }

    /// The same with the highest bit as sign.
    #[inline]
    fn read_signed(&self, word: u64) -> i64 {
        let unused = self.unused & 63;
        ((self.read(word) << unused) as i64) >> unused
    }

    /// The word with this raw value put in; other bits stay.
    #[inline]
    fn put(&self, word: u64, raw: u64) -> u64 {
        let (mask, raw) = (self.mask() << (self.shift & 63), (raw & self.mask()) << (self.shift & 63));
        let (mask, raw) = if self.big_endian { (mask.swap_bytes(), raw.swap_bytes()) } else { (mask, raw) };
        (word & !mask) | raw
    }
}

/// The first 8 bytes, little-endian; 0 where the data has ended. Short data by two words that overlap: a copy of unknown length would cost
/// more than all the rest.
#[inline]
fn load(data: &[u8]) -> u64 {
    if let Some(all) = data.first_chunk::<FRAME_BYTES>() {
        return u64::from_le_bytes(*all);
    }
    if let (Some(low), Some(high)) = (data.first_chunk::<4>(), data.last_chunk::<4>()) {
        let above = 8 * (data.len() - 4) as u32;
        return u64::from(u32::from_le_bytes(*low)) | u64::from(u32::from_le_bytes(*high)) << (above & 63);
    }
    data.iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte))
}

/// Writes the word over the first 8 bytes, or as many as there are.
#[inline]
fn store(data: &mut [u8], word: u64) {
    if let Some(all) = data.first_chunk_mut::<FRAME_BYTES>() {
        *all = word.to_le_bytes();
        return;
    }
    let above = 8 * data.len().saturating_sub(4) as u32;
    if let Some(low) = data.first_chunk_mut::<4>() {
        *low = (word as u32).to_le_bytes();
        if let Some(high) = data.last_chunk_mut::<4>() {
            *high = ((word >> (above & 63)) as u32).to_le_bytes();
        }
        return;
    }
    for (byte, new) in data.iter_mut().zip(word.to_le_bytes()) {
        *byte = new;
    }
}

/// What the bits are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Unsigned,
    /// Two's complement.
    Signed,
    /// IEEE 754, 32 bits.
    Float,
    /// IEEE 754, 64 bits.
    Double,
}

/// A range of raw values of a multiplexor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Gate {
    pub(super) multiplexor: Field,
    pub(super) lowest: u64,
    pub(super) highest: u64,
    /// Enough that this one or the next holds; the last of such a row has `false`.
    pub(super) or_next: bool,
}

/// A signal's place, meaning and condition.
///
/// A multiplexed signal is in the frame only while its multiplexor (and that one's, where it is multiplexed itself) says so.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Codec {
    field: Field,
    kind: Kind,
    /// Bytes that a frame must have: to the end of the signal and of its multiplexors.
    bytes: u8,
    gate_count: u8,
    factor: f64,
    offset: f64,
    /// Of an integer: the raw values before truncation are between these two, which themselves are beyond.
    below_raw: f64,
    beyond_raw: f64,
    name: ArrayString<NAME_BYTES>,
    /// The outermost multiplexor first.
    gates: [Gate; MOST_GATES],
}

impl Codec {
    /// `gates` has at most [`MOST_GATES`]; the factor is finite and not 0, a float's width is its kind's.
    pub(super) fn new(
        name: &str,
        field: Field,
        kind: Kind,
        (factor, offset): (f64, f64),
        gates: &ArrayVec<Gate, MOST_GATES>,
    ) -> Codec {
        let mut cut = ArrayString::new();
        for c in name.chars() {
            if cut.try_push(c).is_err() {
                break;
            }
        }
        let bytes = gates.iter().map(|g| g.multiplexor.bytes).fold(field.bytes, u8::max);
        let never = Gate { multiplexor: field, lowest: 1, highest: 0, or_next: false };
        let mut table = [never; MOST_GATES];
        table[..gates.len()].copy_from_slice(gates);
        // A power of two, hence exact where the highest value itself is not.
        let beyond_raw = 2f64.powi(field.width() - i32::from(kind == Kind::Signed));
        let below_raw = match kind {
            // One less than the lowest, or the next double where that is none.
            Kind::Signed => (-beyond_raw - 1.0).min((-beyond_raw).next_down()),
            _ => -1.0,
        };
        let gate_count = gates.len() as u8;
        Codec { field, kind, bytes, gate_count, factor, offset, below_raw, beyond_raw, name: cut, gates: table }
    }

    /// The value in this frame, in the signal's unit; `None` where the frame is too short, or the signal is not in it by what its
    /// multiplexor says. Integers beyond 2^53 are rounded to the nearest `f64`; a float may be NaN or infinite.
    #[inline]
    pub fn decode(&self, data: &[u8]) -> Option<f64> {
        if data.len() < usize::from(self.bytes) {
            return None;
        }
        let word = load(data);
        if self.gate_count > 0 && !self.is_open(word) {
            return None;
        }
        let unscaled = match self.kind {
            Kind::Unsigned => self.field.read(word) as f64,
            Kind::Signed => self.field.read_signed(word) as f64,
            // Has 32 bits.
            Kind::Float => f64::from(f32::from_bits(self.field.read(word) as u32)),
            Kind::Double => f64::from_bits(self.field.read(word)),
        };
        Some(unscaled * self.factor + self.offset)
    }

    /// Puts a value in the signal's unit into the frame, rounded to the nearest that its bits can hold, ties away from 0. It touches no bits
    /// but the signal's own: a multiplexor is a signal of its own and stays as it is ([`Codec::select`] sets it).
    ///
    /// # Errors
    /// A value beyond [`Codec::range`], NaN or infinity for an integer, a frame too short; the frame is then unchanged.
    #[inline]
    pub fn encode(&self, physical: f64, data: &mut [u8]) -> Result<(), OutOfRange> {
        if data.len() < self.field.bytes() {
            return Err(self.short(data, self.field.bytes()));
        }
        let Some(raw) = self.raw(physical) else { return Err(self.beyond(physical)) };
        store(data, self.field.put(load(data), raw));
        Ok(())
    }

    /// Sets the multiplexors on which the signal depends to their lowest values with which it is in the frame, and touches no other bits.
    /// Nothing to do for a signal that is always there.
    ///
    /// # Errors
    /// A frame too short; it is then unchanged.
    pub fn select(&self, data: &mut [u8]) -> Result<(), OutOfRange> {
        if data.len() < usize::from(self.bytes) {
            return Err(self.short(data, usize::from(self.bytes)));
        }
        let (mut word, mut alternative) = (load(data), false);
        for gate in self.gates() {
            if !alternative {
                word = gate.multiplexor.put(word, gate.lowest);
            }
            alternative = gate.or_next;
        }
        store(data, word);
        Ok(())
    }

    /// Whether the signal is in this frame: the frame is long enough and the multiplexors say so.
    pub fn is_in(&self, data: &[u8]) -> bool {
        data.len() >= usize::from(self.bytes) && self.is_open(load(data))
    }

    /// Whether the signal depends on a multiplexor.
    pub fn is_multiplexed(&self) -> bool {
        self.gate_count > 0
    }

    /// Step between two neighbouring values, in the signal's unit, > 0. Of a float: that at 1 (of its own, before the factor).
    pub fn resolution(&self) -> f64 {
        let step = match self.kind {
            Kind::Unsigned | Kind::Signed => 1.0,
            Kind::Float => f64::from(f32::EPSILON),
            Kind::Double => f64::EPSILON,
        };
        step * self.factor.abs()
    }

    /// Lowest and highest finite value that the bits can hold, in the signal's unit.
    pub fn range(&self) -> (f64, f64) {
        let (low, high) = match self.kind {
            Kind::Unsigned => (0.0, self.field.mask() as f64),
            Kind::Signed => (-self.beyond_raw, (self.field.mask() >> 1) as f64),
            Kind::Float => (f64::from(f32::MIN), f64::from(f32::MAX)),
            Kind::Double => (f64::MIN, f64::MAX),
        };
        let (a, b) = (low * self.factor + self.offset, high * self.factor + self.offset);
        if a <= b { (a, b) } else { (b, a) }
    }

    /// Bytes that a frame must have to hold the signal and its multiplexors, 1..=8.
    pub fn bytes_needed(&self) -> usize {
        usize::from(self.bytes)
    }

    /// Its bits, without those of its multiplexors: bit n is bit n mod 8 of byte n / 8.
    pub fn bits(&self) -> u64 {
        self.field.bits()
    }

    fn gates(&self) -> &[Gate] {
        &self.gates[..usize::from(self.gate_count)]
    }

    fn is_open(&self, word: u64) -> bool {
        let mut open = false;
        for gate in self.gates() {
            open |= (gate.lowest..=gate.highest).contains(&gate.multiplexor.read(word));
            if !gate.or_next {
                if !open {
                    return false;
                }
                open = false;
            }
        }
        true
    }

    /// The bits for a value, in the lowest places; `None` where there are none.
    #[inline]
    fn raw(&self, physical: f64) -> Option<u64> {
        let unscaled = (physical - self.offset) / self.factor;
        match self.kind {
            // NaN is in no range.
            Kind::Unsigned | Kind::Signed => {
                let untruncated = unscaled + HALF.copysign(unscaled);
                if !(untruncated > self.below_raw && untruncated < self.beyond_raw) {
                    return self.end(physical);
                }
                Some(if self.kind == Kind::Signed { untruncated as i64 as u64 } else { untruncated as u64 })
            }
            Kind::Float => {
                let float = unscaled as f32;
                // NaN and infinity are values of a float; a finite one that becomes infinite does not fit.
                (float.is_finite() || !physical.is_finite()).then_some(u64::from(float.to_bits()))
            }
            Kind::Double => (unscaled.is_finite() || !physical.is_finite()).then_some(unscaled.to_bits()),
        }
    }

    /// The end of an integer's range, where a value of the range comes out beyond it because 53 bits could not hold it better.
    #[cold]
    fn end(&self, physical: f64) -> Option<u64> {
        let (minimum, maximum) = self.range();
        let highest = self.field.mask();
        let is_high = (physical - self.offset) / self.factor > 0.0;
        let end = match (self.kind, is_high) {
            (Kind::Signed, true) => highest >> 1,
            (Kind::Signed, false) => highest ^ (highest >> 1),
            (_, true) => highest,
            (_, false) => 0,
        };
        (minimum..=maximum).contains(&physical).then_some(end)
    }

    #[cold]
    fn short(&self, data: &[u8], needed: usize) -> OutOfRange {
        OutOfRange::Frame { signal: self.name, got: data.len(), needed }
    }

    #[cold]
    fn beyond(&self, got: f64) -> OutOfRange {
        let (minimum, maximum) = self.range();
        OutOfRange::Value { signal: self.name, got, minimum, maximum }
    }
}
