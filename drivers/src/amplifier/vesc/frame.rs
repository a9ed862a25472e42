//! Frames: `02 length payload crc_high crc_low 03`; from 256 bytes of payload on `03 length_high length_low payload crc_high crc_low 03`.
//! The CRC is CRC-16/XMODEM (polynomial 0x1021, start 0) over the payload.

use crate::amplifier::{Garbled, Outbox};

/// Longest payload, bytes: `PACKET_MAX_PL_LEN` of the firmware.
pub const LONGEST_PAYLOAD: usize = 512;

/// Start byte of a frame with a length of one byte.
const SHORT: u8 = 2;
/// Start byte of a frame with a length of two bytes.
const LONG: u8 = 3;
/// Last byte of every frame.
const STOP: u8 = 3;
/// CRC and stop byte.
const TAIL: usize = 3;
const LONGEST_FRAME: usize = 3 + LONGEST_PAYLOAD + TAIL;
/// Room for the bytes that may belong to a frame, and as much again, so that they are moved down seldom.
const ROOM: usize = 2 * LONGEST_FRAME;

const CRC_TABLE: [u16; 256] = {
    let mut table = [0; 256];
    let mut byte = 0;
    while byte < 256 {
        let mut crc = (byte as u16) << 8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x8000 != 0 { (crc << 1) ^ 0x1021 } else { crc << 1 };
            bit += 1;
        }
        table[byte] = crc;
        byte += 1;
    }
    table
};

/// CRC-16/XMODEM.
pub(super) fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, byte| (crc << 8) ^ CRC_TABLE[usize::from((crc >> 8) as u8 ^ byte)])
}

/// Appends `payload` (1 to [`LONGEST_PAYLOAD`] bytes) as a frame; `false` where it is no payload or finds no room.
pub fn encode(payload: &[u8], out: &mut Outbox) -> bool {
    let mut frame = [0; LONGEST_FRAME];
    let Some(length) = write(payload, &mut frame) else { return false };
    out.push(&frame[..length])
}

/// Writes the frame, says how long it is.
fn write(payload: &[u8], frame: &mut [u8; LONGEST_FRAME]) -> Option<usize> {
    let head = match payload.len() {
        1..=255 => {
            frame[..2].copy_from_slice(&[SHORT, payload.len() as u8]);
            2
        }
        256..=LONGEST_PAYLOAD => {
            frame[..3].copy_from_slice(&[LONG, (payload.len() >> 8) as u8, payload.len() as u8]);
            3
        }
        _ => return None,
    };
    let end = head + payload.len();
    frame[head..end].copy_from_slice(payload);
    let [high, low] = crc(payload).to_be_bytes();
    frame[end..end + TAIL].copy_from_slice(&[high, low, STOP]);
    Some(end + TAIL)
}

/// Finds frames in bytes that come in any pieces.
///
/// Whenever a stop byte comes, every start byte before it whose length fits is tried, the oldest first. So a false start in garbage
/// never holds back a sound frame that begins later, whatever length it claims. Each start is tried once, when its end comes, so the
/// work is bounded: a CRC over at most [`LONGEST_PAYLOAD`] bytes for each byte that came, and a look at no more than a longest frame's
/// bytes for each stop byte. Bytes before the oldest start whose end may still come are forgotten.
#[derive(Clone, Debug)]
pub struct Deframer {
    bytes: [u8; ROOM],
    /// First byte that may still begin a frame.
    from: usize,
    to: usize,
    /// Value of `to` at which the frame that begins at `from` is looked at again: more of its length is known, or its end has come.
    look_at: usize,
    counts: Garbled,
}

impl Default for Deframer {
    fn default() -> Self {
        Deframer { bytes: [0; ROOM], from: 0, to: 0, look_at: 1, counts: Garbled::default() }
    }
}

impl Deframer {
    /// Takes bytes; calls `found` with the payload (1 to [`LONGEST_PAYLOAD`] bytes) of each sound frame.
    pub fn hear(&mut self, bytes: &[u8], mut found: impl FnMut(&[u8])) {
        for &byte in bytes {
            if self.to == ROOM {
                self.bytes.copy_within(self.from..self.to, 0);
                self.look_at -= self.from;
                (self.from, self.to) = (0, self.to - self.from);
            }
            self.bytes[self.to] = byte;
            self.to += 1;
            if byte == STOP && self.frame_ends(&mut found) {
                (self.from, self.to, self.look_at) = (0, 0, 1);
            } else if self.to >= self.look_at {
                self.forget();
            }
        }
    }

    /// Forgets the bytes before the oldest start whose end may still come.
    fn forget(&mut self) {
        loop {
            if let Some(length) = known_length(&self.bytes[self.from..self.to]) {
                self.look_at = self.from + length;
                return;
            }
            self.from += 1;
            self.counts.skipped_bytes += 1;
        }
    }

    /// Whether a frame ends with the newest byte, which is a stop byte.
    fn frame_ends(&mut self, found: &mut impl FnMut(&[u8])) -> bool {
        let candidates = &self.bytes[self.from..self.to];
        for start in 0..candidates.len().saturating_sub(TAIL + 2) {
            // A 3 is a start byte, too, but of frames that are rare: both are looked at in turn.
            let frame = &candidates[start..];
            let head = match frame[0] {
                SHORT if usize::from(frame[1]) + 2 + TAIL == frame.len() => 2,
                LONG if frame.len() > 3 + 255 + TAIL
                    && usize::from(u16::from_be_bytes([frame[1], frame[2]])) + 3 + TAIL == frame.len() =>
                {
                    3
                }
                _ => continue,
            };
            let (payload, tail) = frame[head..].split_at(frame.len() - head - TAIL);
            if tail[..2] == crc(payload).to_be_bytes() {
                self.counts.sound += 1;
                self.counts.skipped_bytes += start as u64;
                found(payload);
                return true;
            }
            self.counts.refused += 1;
        }
        false
    }

    /// How sound what came was. Bytes of half a frame are not counted as skipped before it is known that they belong to none.
    pub fn garbled(&self) -> Garbled {
        self.counts
    }
}

/// How many bytes a frame that begins with the first of these has at least, more than there are; `None` where there is no such frame.
fn known_length(bytes: &[u8]) -> Option<usize> {
    let length = match *bytes {
        [] => 1,
        [SHORT] => 2,
        [LONG] | [LONG, _] => 3,
        [SHORT, 0, ..] => return None,
        [SHORT, length, ..] => 2 + usize::from(length) + TAIL,
        [LONG, high, low, ..] => match usize::from(u16::from_be_bytes([high, low])) {
            length @ 256..=LONGEST_PAYLOAD => 3 + length + TAIL,
            _ => return None,
        },
        _ => return None,
    };
    (length > bytes.len()).then_some(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(payload: &[u8]) -> Vec<u8> {
        let mut out = Outbox::new();
        assert!(encode(payload, &mut out));
        out.bytes().to_vec()
    }

    fn heard(bytes: &[u8]) -> (Vec<Vec<u8>>, Garbled) {
        let mut deframer = Deframer::default();
        let mut found = vec![];
        deframer.hear(bytes, |payload| found.push(payload.to_vec()));
        (found, deframer.garbled())
    }

    #[test]
    fn vectors() {
        // The check value of CRC-16/XMODEM in the catalogue of parametrised CRC algorithms.
        assert_eq!(crc(b"123456789"), 0x31c3);
        assert_eq!(frame(&[4]), [0x02, 0x01, 0x04, 0x40, 0x84, 0x03]);
        assert_eq!(frame(&[5, 0, 0, 0x4e, 0x20]), [0x02, 0x05, 0x05, 0x00, 0x00, 0x4e, 0x20, 0x29, 0xf6, 0x03]);
    }

    #[test]
    fn every_length_there_and_back() {
        for length in 1..=LONGEST_PAYLOAD {
            let payload: Vec<u8> = (0..length).map(|i| (i * 7 + length) as u8).collect();
            let bytes = frame(&payload);
            assert_eq!(bytes[0], if length < 256 { SHORT } else { LONG });
            assert_eq!(heard(&bytes), (vec![payload], Garbled { sound: 1, ..Garbled::default() }), "{length}");
        }
        let mut out = Outbox::new();
        assert!(!encode(&[], &mut out) && !encode(&[0; LONGEST_PAYLOAD + 1], &mut out));
        assert!(out.is_empty());
    }

    #[test]
    fn a_false_start_that_claims_much_holds_nothing_back() {
        let mut bytes = vec![LONG, 0x02, 0x00, SHORT, 0xff];
        bytes.extend(frame(&[4]));
        assert_eq!(heard(&bytes), (vec![vec![4]], Garbled { sound: 1, refused: 0, skipped_bytes: 5 }));
    }

    #[test]
    fn a_wrong_crc_is_refused_and_counted() {
        let mut bytes = frame(&[30]);
        bytes[2] ^= 1;
        bytes.extend(frame(&[4]));
        assert_eq!(heard(&bytes), (vec![vec![4]], Garbled { sound: 1, refused: 1, skipped_bytes: 6 }));
    }

    #[test]
    fn endless_garbage_is_counted_and_the_next_frame_found() {
        let mut bytes = vec![STOP; 3 * ROOM + 17];
        bytes.extend(frame(&[4]));
        let (found, counts) = heard(&bytes);
        assert_eq!((found, counts.sound), (vec![vec![4]], 1));
        assert_eq!(counts.skipped_bytes, 3 * ROOM as u64 + 17);
        let (_, counts) = heard(&[0x02, 0x01, 0x64, 0x88, 0x00, 0x0c, 0x03, 0x09, 0x05]);
        assert_eq!(counts.skipped_bytes, 9, "a reply of another protocol is known as garbage at once");
    }
}
