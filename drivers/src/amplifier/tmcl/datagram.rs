//! Datagrams: address, instruction, type, motor, value (four bytes, high byte first), checksum; and replies: reply address, module
//! address, status, instruction, value, checksum. The checksum is the sum of the eight bytes before it, modulo 256.

use crate::amplifier::Garbled;

/// Bytes of every datagram.
pub const LENGTH: usize = 9;

/// Sum modulo 256.
pub fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

/// To a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// Address of the module.
    pub address: u8,
    /// Instruction number.
    pub instruction: u8,
    /// Type: a parameter's number, for most.
    pub kind: u8,
    /// Axis, or bank.
    pub motor: u8,
    /// Value.
    pub value: i32,
}

impl Request {
    /// As it goes over the wire.
    pub fn encode(&self) -> [u8; LENGTH] {
        closed([self.address, self.instruction, self.kind, self.motor], self.value)
    }

    /// Out of a datagram whose checksum is right.
    pub fn decode(datagram: &[u8; LENGTH]) -> Request {
        let &[address, instruction, kind, motor, a, b, c, d, _] = datagram;
        Request { address, instruction, kind, motor, value: i32::from_be_bytes([a, b, c, d]) }
    }
}

/// From a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reply {
    /// Address of the host.
    pub reply_address: u8,
    /// Address of the module.
    pub module_address: u8,
    /// 100 = done.
    pub status: u8,
    /// Instruction that it answers.
    pub instruction: u8,
    /// Value.
    pub value: i32,
}

impl Reply {
    /// As it goes over the wire.
    pub fn encode(&self) -> [u8; LENGTH] {
        closed([self.reply_address, self.module_address, self.status, self.instruction], self.value)
    }

    /// Out of a datagram whose checksum is right.
    pub fn decode(datagram: &[u8; LENGTH]) -> Reply {
        let &[reply_address, module_address, status, instruction, a, b, c, d, _] = datagram;
        Reply { reply_address, module_address, status, instruction, value: i32::from_be_bytes([a, b, c, d]) }
    }
}

fn closed(head: [u8; 4], value: i32) -> [u8; LENGTH] {
    let ([h0, h1, h2, h3], [v0, v1, v2, v3]) = (head, value.to_be_bytes());
    let mut datagram = [h0, h1, h2, h3, v0, v1, v2, v3, 0];
    datagram[LENGTH - 1] = checksum(&datagram[..LENGTH - 1]);
    datagram
}

/// Finds datagrams in bytes that come in any pieces.
///
/// A datagram has no mark of its start, and one byte of checksum refuses only 255 of 256 accidents. So the last nine bytes count as one
/// where the checksum is right *and* the head (addresses, status, instruction) is one that may come; else one byte is dropped and the
/// next nine are looked at. In a sound stream no byte is ever dropped; after garbage or a lost byte the first whole datagram is found.
/// Work for each byte: nine bytes at most.
#[derive(Clone, Debug, Default)]
pub struct Reframer {
    window: [u8; LENGTH],
    filled: usize,
    counts: Garbled,
}

impl Reframer {
    /// Takes bytes; calls `found` with each sound datagram. `may_come` says whether a datagram may begin with these four bytes.
    pub fn hear(&mut self, bytes: &[u8], may_come: impl Fn(&[u8; 4]) -> bool, mut found: impl FnMut(&[u8; LENGTH])) {
        for &byte in bytes {
            self.window[self.filled] = byte;
            self.filled += 1;
            if self.filled < LENGTH {
                continue;
            }
            let [h0, h1, h2, h3, .., sum] = self.window;
            let expected = may_come(&[h0, h1, h2, h3]);
            let sound = checksum(&self.window[..LENGTH - 1]) == sum;
            if expected && sound {
                self.counts.sound += 1;
                self.filled = 0;
                found(&self.window);
            } else {
                self.counts.refused += u64::from(expected);
                self.counts.skipped_bytes += 1;
                self.window.copy_within(1.., 0);
                self.filled -= 1;
            }
        }
    }

    /// How sound what came was. Bytes of half a datagram are not counted as skipped before it is known that they belong to none.
    pub fn garbled(&self) -> Garbled {
        self.counts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Example of the manuals ("Get the actual position of motor 0": GAP 1, 0), and its reply with the value 711.
    const GET: [u8; LENGTH] = [0x01, 0x06, 0x01, 0x00, 0x00, 0x00, 0x00, 0x00, 0x08];
    const GOT: [u8; LENGTH] = [0x02, 0x01, 0x64, 0x06, 0x00, 0x00, 0x02, 0xc7, 0x36];

    #[test]
    fn vectors() {
        let get = Request { address: 1, instruction: 6, kind: 1, motor: 0, value: 0 };
        assert_eq!((get.encode(), Request::decode(&GET)), (GET, get));
        let got = Reply { reply_address: 2, module_address: 1, status: 100, instruction: 6, value: 711 };
        assert_eq!((got.encode(), Reply::decode(&GOT)), (GOT, got));
    }

    #[test]
    fn after_a_lost_byte_and_after_garbage_the_next_datagram_is_found() {
        let mut bytes = GOT[1..].to_vec();
        bytes.extend(GOT);
        bytes.extend([2, 1, 100, 6]);
        bytes.extend(GOT);
        let (mut reframer, mut found) = (Reframer::default(), 0);
        reframer.hear(
            &bytes,
            |head| head[..2] == [2, 1],
            |datagram| {
                assert_eq!(*datagram, GOT);
                found += 1;
            },
        );
        assert_eq!((found, reframer.garbled()), (2, Garbled { sound: 2, refused: 1, skipped_bytes: 12 }));
    }
}
