use super::*;
use crate::amplifier::Outbox;
use crate::can::Frame;
use crate::wired::settings::Settings;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The bits of a frame from its start to the end of its checksum, as they are before stuffing. Written bit by bit after ISO 11898-1, and no
/// part of the bound's reasoning.
fn bits(frame: &Frame) -> Vec<bool> {
    let mut bits = vec![false];
    let mut put = |value: u32, width: u32| bits.extend((0..width).rev().map(|bit| value >> bit & 1 == 1));
    match frame.id {
        // Identifier; remote request, extension and reserved bit dominant.
        FrameId::Standard(id) => {
            put(u32::from(id), 11);
            put(0, 3);
        }
        // Eleven bits, substitute and extension recessive, eighteen bits; remote request and two reserved bits dominant.
        FrameId::Extended(id) => {
            put(id >> 18, 11);
            put(0b11, 2);
            put(id & 0x3_FFFF, 18);
            put(0, 3);
        }
    }
    put(frame.data().len() as u32, 4);
    frame.data().iter().for_each(|byte| put(u32::from(*byte), 8));
    let mut checksum = 0u32;
    for bit in &bits {
        let carry = u32::from(*bit) ^ (checksum >> 14 & 1);
        checksum = (checksum << 1 & 0x7FFF) ^ (carry * 0x4599);
    }
    bits.extend((0..15).rev().map(|bit| checksum >> bit & 1 == 1));
    bits
}

/// Bits that a sender puts in: the opposite after five equal ones, itself the first of the next five.
fn stuffed(bits: &[bool]) -> u32 {
    let (mut last, mut run, mut stuffed) = (None, 0, 0);
    for &bit in bits {
        run = if last == Some(bit) { run + 1 } else { 1 };
        last = Some(bit);
        if run == 5 {
            stuffed += 1;
            (last, run) = (Some(!bit), 1);
        }
    }
    stuffed
}

/// Checksum's and acknowledge's delimiter, acknowledge, seven bits of end and three of intermission.
const NEVER_STUFFED: u32 = 3 + 7 + 3;

fn on_the_wire(frame: &Frame) -> u32 {
    let bits = bits(frame);
    bits.len() as u32 + stuffed(&bits) + NEVER_STUFFED
}

fn random_frame(rng: &mut ChaCha8Rng, extended: bool, length: usize) -> Frame {
    let id = if extended {
        FrameId::Extended(rng.random_range(0..1 << 29))
    } else {
        FrameId::Standard(rng.random_range(0..1 << 11))
    };
    let data: Vec<u8> = (0..length).map(|_| rng.random()).collect();
    Frame::new(id, &data).expect("at most 8 bytes")
}

fn mutated(rng: &mut ChaCha8Rng, frame: &Frame) -> Frame {
    let mut changed = *frame;
    for _ in 0..rng.random_range(1..4) {
        let places = 8 * changed.data().len();
        let place = rng.random_range(0..places + 11);
        if place < places {
            changed.data_mut()[place / 8] ^= 1 << (place % 8);
        } else {
            changed.id = match changed.id {
                FrameId::Standard(id) => FrameId::Standard(id ^ 1 << (place - places)),
                FrameId::Extended(id) => FrameId::Extended(id ^ 1 << rng.random_range(0..29)),
            };
        }
    }
    changed
}

/// Chooses the bits of a frame so that a bit is stuffed after every four of them.
struct Greedy {
    last: bool,
    run: u32,
}

impl Greedy {
    /// A bit that the standard fixes.
    fn fixed(&mut self, bit: bool) {
        self.run = if bit == self.last { self.run + 1 } else { 1 };
        self.last = bit;
        if self.run == 5 {
            // The stuffed bit begins the next run.
            (self.last, self.run) = (!bit, 1);
        }
    }

    /// A number of so many free bits: each goes on with the run that there is.
    fn number(&mut self, width: u32) -> u32 {
        (0..width).fold(0, |number, _| {
            let bit = self.last;
            self.fixed(bit);
            number << 1 | u32::from(bit)
        })
    }
}

/// A frame whose free bits each go on with the run that there is. Its fixed bits and its checksum fall as they may.
fn greedy_frame(extended: bool, length: usize) -> Frame {
    // The start bit is dominant.
    let mut bits = Greedy { last: false, run: 1 };
    let id = if extended {
        let high = bits.number(11);
        bits.fixed(true);
        bits.fixed(true);
        FrameId::Extended(high << 18 | bits.number(18))
    } else {
        FrameId::Standard(bits.number(11) as u16)
    };
    for _ in 0..3 {
        bits.fixed(false);
    }
    for place in (0..4).rev() {
        bits.fixed(length >> place & 1 == 1);
    }
    let data: Vec<u8> = (0..length).map(|_| bits.number(8) as u8).collect();
    Frame::new(id, &data).expect("at most 8 bytes")
}

#[test]
fn the_bit_stream_is_that_of_the_standard() {
    // Published example of a checksum (Bosch's polynomial over a bit stream): 15 zeros stay zero, and a single one leaves the polynomial.
    let empty = Frame::new(FrameId::Standard(0), &[]).expect("fits");
    let stream = bits(&empty);
    assert_eq!((stream.len(), stream.iter().filter(|bit| **bit).count()), (34, 0));
    // 34 zeros: one stuffed after the first five, then one after each further... a stuffed one breaks the run, so every five zeros.
    assert_eq!(stuffed(&stream), 6);
    assert_eq!(stuffed(&[true; 5]), 1);
    // 11111 0000 1111: every four after the first five.
    let worst: Vec<bool> = (0..13).map(|n| !(5..9).contains(&n)).collect();
    assert_eq!(stuffed(&worst), 3);
    let stream = bits(&Frame::new(FrameId::Standard(0x7FF), &[1]).expect("fits"));
    let control: Vec<bool> = stream[12..19].to_vec();
    assert_eq!(control, [false, false, false, false, false, false, true]);
    // What a receiver does: the checksum over the stream with its checksum is 0.
    let mut checksum = 0u32;
    for bit in &stream {
        let carry = u32::from(*bit) ^ (checksum >> 14 & 1);
        checksum = (checksum << 1 & 0x7FFF) ^ (carry * 0x4599);
    }
    assert_eq!(checksum, 0);
}

#[test]
fn no_frame_is_longer_than_the_bound_and_some_come_near_it() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for extended in [false, true] {
        for length in 0..=MOST_BYTES {
            let mut longest = 0;
            let mut bound = 0;
            // Climbs from several starts to frames with as many stuffed bits as it finds.
            for start in 0..12 {
                let greedy = greedy_frame(extended, length);
                let mut frame = if start < 6 { greedy } else { random_frame(&mut rng, extended, length) };
                for _ in 0..4_000 {
                    let other = mutated(&mut rng, &frame);
                    if on_the_wire(&other) >= on_the_wire(&frame) {
                        frame = other;
                    }
                    bound = most_frame_bits(other.id, length);
                    let is = on_the_wire(&other);
                    assert!(is <= bound, "{other:?}: {is} bits, bound {bound}");
                }
                longest = longest.max(on_the_wire(&frame));
            }
            println!("extended {extended}, {length} bytes: {longest} bits found, bound {bound}");
            // Bits that are all free reach the bound: after the first five, runs of four in turn.
            let stuffable = if extended { 54 } else { 34 } + 8 * length;
            let free: Vec<bool> = (0..stuffable).map(|n| n >= 5 && (n - 1) / 4 % 2 == 1).collect();
            assert_eq!(free.len() as u32 + stuffed(&free) + NEVER_STUFFED, bound);
            // The bits between identifier and data are fixed, and the checksum is no free choice either.
            assert!(longest + 5 >= bound, "extended {extended}, {length} bytes: {longest} of {bound}");
        }
    }
}

#[test]
fn the_bound_is_that_of_the_books() {
    // Standard frames of 0 and 8 bytes: 55 and 135 bits; extended ones: 80 and 160.
    let of = |id, bytes| most_frame_bits(id, bytes);
    assert_eq!([0, 8].map(|n| of(FrameId::Standard(1), n)), [55, 135]);
    assert_eq!([0, 8].map(|n| of(FrameId::Extended(1), n)), [80, 160]);
}

const DATABASE: &str = "BU_: A\n
BO_ 1 VALVES: 3 A\n SG_ Brake : 0|1@1+ (1,0) [0|1] \"\" A\n SG_ Bypass : 1|1@1+ (1,0) [0|1] \"\" A\n
BO_ 2 POSE: 5 A\n SG_ Angle : 0|32@1- (1,0) [0|0] \"\" A\n SG_ Kind : 32|8@1+ (1,0) [0|0] \"\" A\n
BO_ 3 REST: 8 A\n SG_ Rest : 0|8@1+ (1,0) [0|0] \"\" A\n
BO_ 4 SENSORS: 8 A\n SG_ A : 0|8@1+ (1,0) [0|0] \"\" A\n SG_ P1 : 8|8@1+ (1,0) [0|0] \"\" A\n SG_ P2 : 16|8@1+ (1,0) [0|0] \"\" A\n
BO_ 2147483653 SLOW: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] \"\" A\n
BO_ 6 STATUS: 0 A\n
BO_ 7 DIAGNOSIS: 8 A\n SG_ D : 0|8@1+ (1,0) [0|0] \"\" A\n
BO_ 8 OTHER: 2 A\n SG_ O : 0|8@1+ (1,0) [0|0] \"\" A\n
BO_ 9 LONG: 64 A\n SG_ L : 0|8@1+ (1,0) [0|0] \"\" A\n
BA_DEF_ BO_ \"GenMsgCycleTime\" FLOAT 0 65535;\n
BA_DEF_DEF_ \"GenMsgCycleTime\" 0;\n
BA_ \"GenMsgCycleTime\" BO_ 2 100;\nBA_ \"GenMsgCycleTime\" BO_ 3 100;\nBA_ \"GenMsgCycleTime\" BO_ 2147483653 5;\n
BA_ \"GenMsgCycleTime\" BO_ 6 10;\nBA_ \"GenMsgCycleTime\" BO_ 7 0.5;\n";

fn settings() -> Settings {
    toml::from_str(
        "[amplifier]
         protocol = \"vesc\"
         port = \"/dev/ttyACM0\"
         full_scale_v = 24.0
         [can]
         interface = \"can0\"
         bitrate = 500_000
         dbc = \"a.dbc\"
         heartbeat = [{ message = \"STATUS\", period_ms = 10.0 }]
         command = { brake_open = \"VALVES.Brake\", bypass_open = \"VALVES.Bypass\" }
         [can.sensors]
         angle_deg = { signal = \"SENSORS.A\" }
         pressure1_bar = { signal = \"SENSORS.P1\" }
         pressure2_bar = { signal = \"SENSORS.P2\" }
         torque_nm = { signal = \"SLOW.T\" }
         [can.fixture]
         kind = \"POSE.Kind\"
         angle_deg = \"POSE.Angle\"
         pressure1_bar = \"REST.Rest\"
         pressure2_bar = \"REST.Rest\"
         flow_ml_s = \"REST.Rest\"
         segment = \"REST.Rest\"
         run = \"REST.Rest\"
         vertical = \"REST.Rest\"
         fill_bar = \"REST.Rest\"",
    )
    .expect("the settings of this test")
}

#[test]
fn every_message_of_the_bus_counts_at_its_rate() {
    let database = Database::parse(DATABASE, "a.dbc").expect("the database of this test");
    let load = can_load(&database, &settings().can);
    let of = |name: &str| {
        let found: Vec<f64> = load.entries.iter().filter(|e| e.what.starts_with(name)).map(|e| e.bits).collect();
        assert_eq!(found.len(), 1, "{name}: {:?}", load.entries);
        found[0]
    };
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
    near(of("VALVES "), 85.0);
    // Every tick in spite of its cycle time: the angle may change every tick.
    near(of("POSE "), 105.0);
    near(of("REST "), 1.35);
    near(of("SENSORS "), 135.0);
    near(of("SLOW "), 160.0 / 5.0);
    near(of("STATUS "), 5.5);
    near(of("DIAGNOSIS "), 2.0 * 135.0);
    near(load.bits(), 85.0 + 105.0 + 1.35 + 135.0 + 32.0 + 5.5 + 270.0);
    near(load.share(), load.bits() / 500.0);
    near(load.busiest_bits, 85.0 + 105.0 + 135.0 + 135.0 + 160.0 + 55.0 + 270.0);
    assert_eq!(load.not_counted.len(), 2, "{:?}", load.not_counted);
    assert!(load.not_counted[0].starts_with("OTHER ") && load.not_counted[1].starts_with("LONG "));
    let refused = load.judge(0.8).expect_err("633.9 of 500 bits");
    assert!(refused.contains("633.9 of 500.0 bits a tick = 126.8 %") && refused.contains("80.0 %"), "{refused}");
    let roomy = can_load(&database, &CanSettings { bitrate: 1_000_000, ..settings().can });
    // A busy tick alone is no reason to refuse a bus.
    assert!(roomy.judge(0.8).is_ok() && roomy.judge(0.6).is_err());
}

#[test]
fn serial_sums_are_those_of_what_the_protocols_really_write() {
    for protocol_name in crate::amplifier::PROTOCOLS.iter().map(|kind| kind.name) {
        let amplifier = AmplifierSettings {
            protocol: protocol_name.to_owned(),
            baud: 115_200,
            telemetry_every_ticks: 4,
            ..settings().amplifier
        };
        let mut client = (protocol(protocol_name).expect("listed").client)(&amplifier).expect("sound");
        let mut out = Outbox::new();
        // Forty ticks as the port's thread writes them.
        for tick in 0..40 {
            client.command(12.0, &mut out);
            if tick % 4 == 0 {
                client.request(&mut out);
            }
            if tick == 0 {
                let [load, _] = serial_load(&amplifier).expect("sound");
                assert_eq!(load.busiest_bits, 10.0 * out.bytes().len() as f64, "{protocol_name}");
            }
            if tick < 39 && tick % 4 == 3 {
                // Four ticks at a time: the box is small.
                let [load, _] = serial_load(&amplifier).expect("sound");
                assert!((load.bits() - 10.0 * out.bytes().len() as f64 / 4.0).abs() < 1e-9, "{protocol_name}");
                out.clear();
            }
        }
        let [to, from] = serial_load(&amplifier).expect("sound");
        assert!((to.carries_bits - 115.2).abs() < 1e-9);
        let back = client.traffic();
        let expected = 10.0 * (back.command.back as f64 + back.request.back as f64 / 4.0);
        assert!((from.bits() - expected).abs() < 1e-9, "{protocol_name}");
    }
}

#[test]
fn commands_may_not_pile_up_on_the_port() {
    let slow = AmplifierSettings { baud: 100_000, telemetry_every_ticks: 100, ..settings().amplifier };
    let [mut to, from] = serial_load(&slow).expect("sound");
    // A mean that fits does not help the tick in which the request comes too.
    to.busiest_bits = 100.1;
    to.carries_bits = 100.0;
    let refused = to.judge(1.5).expect_err("100.1 bits in one tick");
    assert!(refused.contains("100.1 bits in a tick"), "{refused}");
    assert!(!from.busiest_must_fit);
    let unknown = AmplifierSettings { protocol: "vesk".to_owned(), ..slow };
    assert!(serial_load(&unknown).is_err());
}
