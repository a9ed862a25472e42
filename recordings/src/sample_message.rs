//! The message of a sample as this project writes it, read without going through the schema: the fields in the order of their numbers,
//! each at most once. Whatever stands otherwise is left to the general decoder, which gives the same for what both understand.

use rt_core::{SAMPLE_VERSION, Sample, flags};

/// Bytes that must follow a message in its buffer, so that a whole word can be read at any of its places.
pub(crate) const SLACK: usize = 16;

/// Reads the message in the first `length` bytes of `window` into `sample`, all fields of which are set. False: it needs the general
/// decoder, which also knows what is wrong with it; `sample` is then of no use.
#[inline]
pub(crate) fn decode(window: &[u8], length: usize, sample: &mut Sample) -> bool {
    let mut fields = Fields { window, at: 0, sound: true };
    sample.version = fields.small(1);
    sample.run = fields.small(2);
    sample.tick = fields.whole(3);
    sample.scheduled_ns = fields.whole(4);
    sample.lateness_ns = fields.whole(5);
    // Field 6 is of version 1 only.
    sample.segment = fields.small(7);
    sample.voltage_v = fields.double(8);
    sample.angle_deg = fields.double(9);
    sample.pressure1_bar = fields.double(10);
    sample.pressure2_bar = fields.double(11);
    sample.torque_nm = fields.double(12);
    sample.volume_ml = fields.double(13);
    let mut bits = fields.flag(14, flags::BRAKE_OPEN)
        | fields.flag(15, flags::BYPASS_OPEN)
        | fields.flag(16, flags::TRIPPED)
        | fields.flag(17, flags::LAST)
        | fields.flag(18, flags::FAULT);
    bits |= fields.small(19) & !FLAG_FIELDS;
    sample.woken_ns = fields.whole(20);
    sample.skipped = fields.whole(21);
    fields.ages(22, &mut sample.age_ns);
    sample.heartbeat_age_ns = fields.small(23);
    sample.behind_ns = fields.small(24);
    sample.read_ns = fields.small(25);
    sample.check_ns = fields.small(26);
    sample.reference_ns = fields.small(27);
    sample.control_ns = fields.small(28);
    sample.write_ns = fields.small(29);
    sample.publish_ns = fields.small(30);
    sample.step = fields.small(31);
    sample.quality = fields.small(32);
    sample.trip = fields.small(33);
    // Five that are rarely there: one look for all of them.
    if fields.at < length && !fields.stands_here(39, FIXED_64) {
        bits |= fields.flag(34, flags::OVERRUN)
            | fields.flag(35, flags::STOPPED)
            | fields.flag(36, flags::SLEW_LIMITED)
            | fields.flag(37, flags::WAITING)
            | fields.flag(38, flags::CONFIRMED);
    }
    sample.flags = bits;
    (sample.target, sample.target_of, sample.reserved) = (f64::NAN, 0, 0);
    if fields.at < length {
        sample.target = fields.double(39);
        sample.target_of = fields.small(40);
    }
    // What looked beyond the message has gone beyond its end, too: then the places disagree.
    let known = NEWEST_OF_THIS_FORM.contains(&sample.version);
    sample.version = SAMPLE_VERSION;
    fields.sound && fields.at == length && known && sample.in_range().is_ok()
}

/// Layouts of the sample whose message is read here: version 2 had all fields but the last two, which are absent then.
const NEWEST_OF_THIS_FORM: std::ops::RangeInclusive<u32> = 2..=SAMPLE_VERSION;

/// The flag bits that have a field of their own in the message.
pub(crate) const FLAG_FIELDS: u32 = flags::BRAKE_OPEN
    | flags::BYPASS_OPEN
    | flags::TRIPPED
    | flags::LAST
    | flags::FAULT
    | flags::OVERRUN
    | flags::STOPPED
    | flags::SLEW_LIMITED
    | flags::WAITING
    | flags::CONFIRMED;

/// Wire types of protobuf.
const VARINT: u32 = 0;
const FIXED_64: u32 = 1;
const LENGTH_DELIMITED: u32 = 2;

/// The fields of a message, in their order. An absent one is 0 or NaN.
struct Fields<'w> {
    window: &'w [u8],
    at: usize,
    /// False: something stands here that the general decoder must judge.
    sound: bool,
}

impl Fields<'_> {
    /// The next eight bytes, the first one lowest; 0 beyond the window.
    #[inline(always)]
    fn word(&self, at: usize) -> u64 {
        match self.window.get(at..).and_then(<[u8]>::first_chunk) {
            Some(bytes) => u64::from_le_bytes(*bytes),
            None => 0,
        }
    }

    /// Whether the tag of this field stands here.
    #[inline(always)]
    fn stands_here(&self, field: u32, wire_type: u32) -> bool {
        let key = field << 3 | wire_type;
        let word = self.word(self.at);
        if key < 0x80 { word as u8 == key as u8 } else { word as u16 == (key & 0x7f | 0x80 | key >> 7 << 8) as u16 }
    }

    /// Takes the tag of this field, if it stands here.
    #[inline(always)]
    fn tag(&mut self, field: u32, wire_type: u32) -> bool {
        let there = self.stands_here(field, wire_type);
        if there {
            self.at += if field << 3 < 0x80 { 1 } else { 2 };
        }
        there
    }

    /// A number of seven bits a byte. Longer than eight bytes: left to the general decoder.
    #[inline(always)]
    fn varint(&mut self) -> u64 {
        let word = self.word(self.at);
        // Lengths repeat from message to message, so these branches are foreseen.
        if word & 0x80 == 0 {
            self.at += 1;
            return word & 0x7f;
        }
        if word & 0x8000 == 0 {
            self.at += 2;
            return word & 0x7f | word >> 1 & 0x3f80;
        }
        if word & 0x80_0000 == 0 {
            self.at += 3;
            return word & 0x7f | word >> 1 & 0x3f80 | word >> 2 & 0x1f_c000;
        }
        let ends = !word & 0x8080_8080_8080_8080;
        self.sound &= ends != 0;
        let bytes = ends.trailing_zeros() / 8 + 1;
        self.at += bytes as usize;
        // The bytes up to the end, then their sevens moved together: by one bit, by two, by four.
        let sevens = word & (ends ^ ends.wrapping_sub(1)) & 0x7f7f_7f7f_7f7f_7f7f;
        let pairs = sevens & 0x007f_007f_007f_007f | (sevens & 0x7f00_7f00_7f00_7f00) >> 1;
        let fours = pairs & 0x0000_3fff_0000_3fff | (pairs & 0x3fff_0000_3fff_0000) >> 2;
        fours & 0x0fff_ffff | (fours & 0x0fff_ffff_0000_0000) >> 4
    }

    #[inline(always)]
    fn whole(&mut self, field: u32) -> u64 {
        if self.tag(field, VARINT) { self.varint() } else { 0 }
    }

    #[inline(always)]
    fn small(&mut self, field: u32) -> u32 {
        if self.tag(field, VARINT) { self.bits_32() } else { 0 }
    }

    #[inline(always)]
    fn bits_32(&mut self) -> u32 {
        let value = self.varint();
        self.sound &= value <= u64::from(u32::MAX);
        value as u32
    }

    #[inline(always)]
    fn flag(&mut self, field: u32, bit: u32) -> u32 {
        if !self.tag(field, VARINT) {
            return 0;
        }
        let value = self.varint();
        self.sound &= value <= 1;
        if value == 1 { bit } else { 0 }
    }

    #[inline(always)]
    fn double(&mut self, field: u32) -> f64 {
        if !self.tag(field, FIXED_64) {
            return f64::NAN;
        }
        let bits = self.word(self.at);
        self.at += 8;
        f64::from_bits(bits)
    }

    #[inline(always)]
    fn ages(&mut self, field: u32, ages: &mut [u32; 5]) {
        // Without ages it is no sample of this version.
        self.sound &= self.tag(field, LENGTH_DELIMITED);
        let bytes = self.varint();
        let begin = self.at;
        for age in ages {
            *age = self.bits_32();
        }
        self.sound &= (self.at - begin) as u64 == bytes;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test")]

    use super::*;
    use crate::wire::{decode_sample, encode_sample};
    use proptest::prelude::*;

    /// As bits, so that NaN equals NaN.
    fn bits(sample: &Sample) -> String {
        let values = [
            sample.voltage_v,
            sample.angle_deg,
            sample.pressure1_bar,
            sample.pressure2_bar,
            sample.torque_nm,
            sample.volume_ml,
            sample.target,
        ];
        let values = values.map(f64::to_bits);
        let numbers = Sample {
            voltage_v: 0.0,
            angle_deg: 0.0,
            pressure1_bar: 0.0,
            pressure2_bar: 0.0,
            torque_nm: 0.0,
            volume_ml: 0.0,
            target: 0.0,
            ..*sample
        };
        format!("{values:?} {numbers:?}")
    }

    fn fast(message: &[u8], behind: &[u8]) -> Option<Sample> {
        let window: Vec<u8> = message.iter().chain(behind).copied().collect();
        // Whatever stood there before must not shine through.
        let mut sample =
            Sample { tick: 77, angle_deg: 7.0, age_ns: [7; 5], flags: 7, trip: 7, target: 7.0, ..Sample::BLANK };
        decode(&window, message.len(), &mut sample).then_some(sample)
    }

    /// Whole numbers of every length.
    fn number() -> impl Strategy<Value = u64> {
        (any::<u64>(), 0..64u32).prop_map(|(number, shift)| number >> shift)
    }

    fn sample() -> impl Strategy<Value = Sample> {
        let value = prop_oneof![any::<f64>(), Just(f64::NAN), Just(0.0), Just(-0.0)];
        (
            proptest::collection::vec(number(), 27),
            proptest::collection::vec(value, 7),
            prop_oneof![Just(0u64), Just(u64::MAX >> 9)],
        )
            .prop_map(|(n, v, limit)| {
                // Eight bytes of seven bits: what a run's times come to. Longer ones are the general decoder's.
                let whole = |at: usize| if limit == 0 { n[at] } else { n[at] & limit };
                let small = |at: usize| n[at] as u32;
                Sample {
                    version: if n[24] % 2 == 0 { SAMPLE_VERSION } else { 2 },
                    run: small(0),
                    tick: whole(1) >> if n[26] % 4 == 0 { 0 } else { 22 },
                    scheduled_ns: whole(2),
                    woken_ns: whole(3),
                    lateness_ns: whole(4),
                    skipped: whole(5) >> if n[26] % 4 == 1 { 0 } else { 22 },
                    voltage_v: v[0],
                    angle_deg: v[1],
                    pressure1_bar: v[2],
                    pressure2_bar: v[3],
                    torque_nm: v[4],
                    volume_ml: v[5],
                    age_ns: [6, 7, 8, 9, 10].map(small),
                    heartbeat_age_ns: small(11),
                    behind_ns: small(12),
                    read_ns: small(13),
                    check_ns: small(14),
                    reference_ns: small(15),
                    control_ns: small(16),
                    write_ns: small(17),
                    publish_ns: small(18),
                    segment: small(19),
                    step: small(20),
                    flags: small(21),
                    quality: small(22),
                    trip: small(23),
                    target: v[6],
                    target_of: small(25),
                    reserved: 0,
                }
            })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4_000))]
        #[test]
        fn what_is_written_is_read_as_the_general_decoder_reads_it(
            sample in sample(), behind in proptest::collection::vec(any::<u8>(), SLACK..40),
        ) {
            let mut message = Vec::new();
            encode_sample(&sample, &mut message);
            let general = decode_sample(&message);
            prop_assert_eq!(general.is_ok(), sample.in_range().is_ok());
            if let Some(read) = fast(&message, &behind) {
                prop_assert_eq!(Ok(bits(&read)), general.map(|general| bits(&general)));
            }
            let times = [sample.scheduled_ns, sample.woken_ns, sample.lateness_ns];
            if sample.in_range().is_ok() && times.iter().all(|time_ns| *time_ns < 1 << 56) {
                prop_assert!(fast(&message, &behind).is_some(), "the way that is meant to be the usual one");
            }
        }

        #[test]
        fn damaged_messages_are_never_read_otherwise_than_by_the_general_decoder(
            sample in sample(),
            changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
            cut in proptest::option::of(any::<prop::sample::Index>()),
            twice in any::<bool>(),
            behind in proptest::collection::vec(any::<u8>(), SLACK..40),
        ) {
            let mut message = Vec::new();
            encode_sample(&sample, &mut message);
            for (at, byte) in changes {
                let at = at.index(message.len());
                message[at] = byte;
            }
            if let Some(cut) = cut {
                message.truncate(cut.index(message.len()));
            }
            if twice {
                message.extend_from_within(..);
            }
            if let Some(read) = fast(&message, &behind) {
                let general = decode_sample(&message);
                prop_assert_eq!(general.map(|sample| bits(&sample)), Ok(bits(&read)));
            }
        }
    }
}
