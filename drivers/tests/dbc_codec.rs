//! Random signals in random places: against a codec that goes bit by bit, and by what a codec must satisfy. Decoding and encoding
//! allocate nothing.
#![allow(clippy::unwrap_used, reason = "a test")]

mod counting;

use counting::allocations;
use drivers::can::FrameId;
use drivers::dbc::{Codec, Database, OutOfRange};
use proptest::prelude::*;
use std::path::Path;

/// What a random signal is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Unsigned,
    Signed,
    Float,
    Double,
}

#[derive(Clone, Debug)]
struct Layout {
    length: usize,
    /// From the first bit in the order of the bits: bit 0 of byte 0 in Intel order, bit 7 in Motorola order.
    first: usize,
    width: usize,
    big_endian: bool,
    kind: Kind,
    factor: f64,
    offset: f64,
}

impl Layout {
    /// The numbers of the signal's bits (bit n is bit n mod 8 of byte n / 8), the lowest of its value first: the reference.
    fn bits(&self) -> Vec<usize> {
        let place = |k: usize| if self.big_endian { k / 8 * 8 + 7 - k % 8 } else { k };
        let mut bits: Vec<usize> = (self.first..self.first + self.width).map(place).collect();
        if self.big_endian {
            bits.reverse();
        }
        bits
    }

    fn codec(&self) -> Codec {
        let bits = self.bits();
        let start = if self.big_endian { bits[bits.len() - 1] } else { bits[0] };
        let sign = if self.kind == Kind::Unsigned { '+' } else { '-' };
        let order = u8::from(!self.big_endian);
        let value_type = match self.kind {
            Kind::Unsigned | Kind::Signed => 0,
            Kind::Float => 1,
            Kind::Double => 2,
        };
        let (length, width, factor, offset) = (self.length, self.width, self.factor, self.offset);
        let text = format!(
            "BU_: N\n\nBO_ 1 M: {length} N\n SG_ S : {start}|{width}@{order}{sign} ({factor},{offset}) [0|0] \"\" N\n\n\
             SIG_VALTYPE_ 1 S : {value_type};\n"
        );
        Database::parse(&text, "random.dbc").unwrap().signal("M.S").unwrap().1.codec
    }

    /// The raw value, bit by bit.
    fn raw(&self, data: &[u8]) -> u64 {
        let set = |bit: usize| u64::from(data[bit / 8] >> (bit % 8) & 1);
        self.bits().iter().enumerate().map(|(k, bit)| set(*bit) << k).sum()
    }

    fn physical(&self, raw: u64) -> f64 {
        let unscaled = match self.kind {
            Kind::Unsigned => raw as f64,
            Kind::Signed if raw >> (self.width - 1) == 1 => (i128::from(raw) - (1i128 << self.width)) as f64,
            Kind::Signed => raw as f64,
            Kind::Float => f64::from(f32::from_bits(raw as u32)),
            Kind::Double => f64::from_bits(raw),
        };
        unscaled * self.factor + self.offset
    }

    fn is_float(&self) -> bool {
        matches!(self.kind, Kind::Float | Kind::Double)
    }

    /// Lowest and highest raw value of an integer.
    fn integers(&self) -> (i128, i128) {
        match self.kind {
            Kind::Signed => (-(1i128 << (self.width - 1)), (1i128 << (self.width - 1)) - 1),
            _ => (0, (1i128 << self.width) - 1),
        }
    }
}

fn layouts() -> impl Strategy<Value = Layout> {
    let kinds = prop_oneof![4 => Just(Kind::Unsigned), 4 => Just(Kind::Signed), 1 => Just(Kind::Float), 1 => Just(Kind::Double)];
    let scales =
        (prop_oneof![Just(1.0), Just(0.1), Just(-0.25), Just(3.0), 1e-4..1e4f64], prop_oneof![Just(0.0), -1e3..1e3f64]);
    (kinds, 1usize..=64, any::<bool>(), scales, any::<prop::sample::Index>(), any::<prop::sample::Index>()).prop_map(
        |(kind, width, big_endian, (factor, offset), first, length)| {
            let width = match kind {
                Kind::Float => 32,
                Kind::Double => 64,
                _ => width,
            };
            let first = first.index(65 - width);
            let shortest = (first + width).div_ceil(8);
            let length = shortest + length.index(9 - shortest);
            Layout { length, first, width, big_endian, kind, factor, offset }
        },
    )
}

fn same(a: f64, b: f64) -> bool {
    a == b || (a.is_nan() && b.is_nan())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn decoding_is_that_of_the_bits(layout in layouts(), data in prop::array::uniform8(any::<u8>())) {
        let codec = layout.codec();
        let data = &data[..layout.length];
        let expected = layout.physical(layout.raw(data));
        let got = codec.decode(data).unwrap();
        prop_assert!(same(got, expected), "expected {expected}, got {got}");
        // One byte less than it needs is too short, whatever the message's length.
        let needed = (layout.first + layout.width).div_ceil(8);
        prop_assert_eq!(codec.bytes_needed(), needed);
        prop_assert_eq!(codec.bits(), layout.bits().iter().fold(0, |mask, bit| mask | 1 << bit));
        prop_assert_eq!(codec.decode(&data[..needed - 1]), None);
        prop_assert!(same(codec.decode(&data[..needed]).unwrap(), expected));
    }

    #[test]
    fn encoding_gives_the_nearest_value_and_touches_no_other_bit(
        layout in layouts(),
        before in prop::array::uniform8(any::<u8>()),
        part in 0.0..1.0f64,
        magnitude in -30..30i32,
    ) {
        let codec = layout.codec();
        let (minimum, maximum) = codec.range();
        let value = if layout.is_float() {
            (part - 0.5) * 10f64.powi(magnitude)
        } else {
            minimum + (maximum - minimum) * part
        };
        let mut data = before[..layout.length].to_vec();
        codec.encode(value, &mut data).unwrap();
        let own = layout.bits();
        for bit in (0..layout.length * 8).filter(|b| !own.contains(b)) {
            prop_assert_eq!(data[bit / 8] >> (bit % 8) & 1, before[bit / 8] >> (bit % 8) & 1, "bit {}", bit);
        }
        let raw = layout.raw(&data);
        let got = codec.decode(&data).unwrap();
        prop_assert!(same(got, layout.physical(raw)));
        let slack = 1e-15 * (value.abs() + layout.offset.abs());
        if layout.is_float() {
            let unscaled = (value - layout.offset) / layout.factor;
            let nearest = if layout.kind == Kind::Float { u64::from((unscaled as f32).to_bits()) } else { unscaled.to_bits() };
            prop_assert_eq!(raw, nearest);
        } else {
            prop_assert!((got - value).abs() <= codec.resolution() * 0.5 * (1.0 + 1e-9) + slack, "{} gave {}", value, got);
        }
    }

    #[test]
    fn every_raw_value_survives(layout in layouts(), data in prop::array::uniform8(any::<u8>())) {
        let codec = layout.codec();
        let data = &data[..layout.length];
        let value = codec.decode(data).unwrap();
        let mut again = data.to_vec();
        let encoded = codec.encode(value, &mut again);
        // A double holds neither every sum of a float and an offset nor every integer beyond 2^53; the nearest one is never refused.
        let exact = if layout.is_float() { layout.factor == 1.0 && layout.offset == 0.0 } else { layout.width <= 36 };
        if !exact {
            let slack = 1e-15 * (value.abs() + layout.offset.abs());
            let got = codec.decode(&again).unwrap();
            prop_assert!(layout.is_float() || encoded.is_ok(), "{:?}", encoded);
            prop_assert!(layout.is_float() || (got - value).abs() <= slack, "{} gave {}", value, got);
        } else if !value.is_nan() {
            prop_assert_eq!(encoded, Ok(()));
            // The two zeros of a float are the same value.
            prop_assert!(again == data || value == 0.0, "{:?} {:?}", again, data);
        }
    }

    #[test]
    fn the_ends_of_the_range_survive(layout in layouts(), data in any::<[u8; 8]>()) {
        let codec = layout.codec();
        let (minimum, maximum) = codec.range();
        if layout.is_float() {
            return Ok(());
        }
        let (low, high) = layout.integers();
        let ends = if layout.factor > 0.0 { [(minimum, low), (maximum, high)] } else { [(minimum, high), (maximum, low)] };
        for (value, raw) in ends {
            let mut data = data;
            prop_assert_eq!(codec.encode(value, &mut data), Ok(()));
            let got = layout.raw(&data) as i128 - if layout.kind == Kind::Signed && raw < 0 { 1i128 << layout.width } else { 0 };
            // Offset and factor cost digits.
            prop_assert!((got - raw).abs() as f64 <= 1e-14 * (raw.abs() as f64 + (layout.offset / layout.factor).abs()), "{got} {raw}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_and_changes_nothing(layout in layouts(), beyond in 0.6..1e6f64, data in any::<[u8; 8]>()) {
        let codec = layout.codec();
        let (minimum, maximum) = codec.range();
        let short = (layout.first + layout.width).div_ceil(8) - 1;
        let mut frame = data;
        let refused = codec.encode(minimum, &mut frame[..short]).unwrap_err();
        let told = matches!(refused, OutOfRange::Frame { got, needed, .. } if got == short && needed == short + 1);
        prop_assert!(told, "{}", refused);
        prop_assert_eq!(frame, data);
        let refused = |value: f64| {
            let mut frame = data;
            let refused = codec.encode(value, &mut frame);
            let told = matches!(refused, Err(OutOfRange::Value { got, minimum: a, maximum: b, signal })
                if same(got, value) && (a, b) == (minimum, maximum) && &*signal == "S");
            prop_assert!(told && frame == data, "{value} against {minimum}..={maximum}: {refused:?}");
            Ok(())
        };
        match layout.kind {
            Kind::Unsigned | Kind::Signed => {
                for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                    refused(value)?;
                }
                let (low, high) = layout.integers();
                for raw in [low as f64 - beyond.max(low.abs() as f64 * 1e-15), high as f64 + beyond.max(high as f64 * 1e-15)] {
                    refused(raw * layout.factor + layout.offset)?;
                }
            }
            Kind::Float => {
                refused(1e39 * layout.factor + layout.offset)?;
                refused(-1e39 * layout.factor + layout.offset)?;
            }
            // Only a small factor makes a finite value overflow.
            Kind::Double if layout.factor.abs() < 0.5 => refused(f64::MAX)?,
            Kind::Double => {}
        }
        if layout.is_float() {
            for value in [f64::NAN, f64::INFINITY] {
                let mut frame = data;
                codec.encode(value, &mut frame).unwrap();
                prop_assert!(same(codec.decode(&frame).unwrap(), value));
            }
        }
    }
}

fn database(file: &str) -> Database {
    Database::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/dbc").join(file)).unwrap()
}

#[test]
fn a_multiplexed_signal_is_there_with_its_values_alone() {
    let database = database("multiplexed.dbc");
    let codec = |path: &str| database.signal(path).unwrap().1.codec;
    let (group, kind, gain) = (codec("NESTED.Group"), codec("NESTED.Kind"), codec("NESTED.Gain"));
    assert!(gain.is_multiplexed() && kind.is_multiplexed() && !group.is_multiplexed());
    let mut present = 0;
    for group_value in 0..8 {
        for kind_value in 0..256 {
            let mut data = [0xFF; 8];
            group.encode(f64::from(group_value), &mut data).unwrap();
            let inner = [2, 3].contains(&group_value);
            assert_eq!(kind.is_in(&data), inner);
            // The bits of Kind, whether it is in the frame or not.
            data[1] = kind_value as u8;
            assert_eq!(kind.decode(&data), inner.then_some(f64::from(kind_value)));
            let there = inner && ((0..=4).contains(&kind_value) || kind_value == 9);
            assert_eq!(gain.decode(&data).is_some(), there, "{group_value} {kind_value}");
            present += u32::from(there);
        }
    }
    assert_eq!(present, 2 * 6);

    // Encoding leaves the multiplexors alone; `select` sets them, and them alone.
    let mut data = [0; 8];
    gain.encode(1.5, &mut data).unwrap();
    assert_eq!((gain.decode(&data), group.decode(&data)), (None, Some(0.0)));
    let before = data;
    gain.select(&mut data).unwrap();
    assert_eq!((gain.decode(&data), group.decode(&data), kind.decode(&data)), (Some(1.5), Some(2.0), Some(0.0)));
    assert_eq!(data[2..], before[2..]);
    assert_eq!(gain.decode(&data[..3]), None, "too short");
    assert!(matches!(gain.select(&mut [0; 3]), Err(OutOfRange::Frame { got: 3, needed: 4, .. })));
}

#[test]
fn the_units_of_a_latin_file_and_what_stands_beside_a_codec() {
    let kinds = database("kinds.dbc");
    let (message, signal) = kinds.signal("SHORT.Command").unwrap();
    assert_eq!((message.id, message.length, message.sender.as_deref()), (FrameId::Standard(263), 3, Some("BENCH")));
    assert_eq!((signal.unit.as_str(), signal.minimum, signal.maximum), ("V", -24.0, 24.0));
    assert_eq!(signal.codec.resolution(), 0.0125);
    assert_eq!(signal.codec.range(), (-25.6, 2047.0 * 0.0125));
    let (_, negative) = kinds.signal("EXTENDED.Negative").unwrap();
    assert_eq!(negative.codec.range(), (100.0 - 0.25 * 32767.0, 100.0 + 0.25 * 32768.0));
    assert_eq!((negative.minimum, negative.maximum), negative.codec.range(), "[0|0] says none");
    assert_eq!(database("multiplexed.dbc").signal("SIMPLE.Temperature").unwrap().1.unit, "°C");
    assert_eq!(database("multiplexed.dbc").signal("SIMPLE.Viscosity").unwrap().1.unit, "µPas");
}

#[test]
fn decoding_and_encoding_allocate_nothing_whatever_comes() {
    let before = allocations();
    std::hint::black_box(vec![1u8; 100]);
    assert_eq!(allocations() - before, 2, "the counter counts");
    let mut counted = 0;
    for file in ["kinds.dbc", "multiplexed.dbc", "cantools/signed.dbc", "cantools/multiplex_2.dbc"] {
        let database = database(file);
        let before = allocations();
        for message in database.messages() {
            let found = database.by_id(message.id).unwrap();
            for signal in found.signals() {
                let mut data = [0x5A; 8];
                for length in 0..=8 {
                    counted += u32::from(signal.codec.decode(&data[..length]).is_some());
                    for value in [0.0, -1e300, f64::NAN, 12.5] {
                        counted += u32::from(signal.codec.encode(value, &mut data[..length]).is_err());
                        counted += u32::from(signal.codec.select(&mut data[..length]).is_err());
                    }
                }
            }
        }
        assert_eq!(allocations() - before, 0, "{file}");
    }
    assert!(counted > 1_000, "{counted}");
}
