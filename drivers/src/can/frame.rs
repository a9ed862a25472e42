//! A classic CAN frame (ISO 11898-1): 11 or 29 bits of identifier, 0..=8 bytes of data.

use std::fmt;

/// Most data bytes of a classic frame.
pub const MOST_BYTES: usize = 8;

/// Identifier of a frame; the two kinds are two name spaces.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FrameId {
    /// 11 bits, 0..=0x7FF.
    Standard(u16),
    /// 29 bits, 0..=0x1FFF_FFFF.
    Extended(u32),
}

impl FrameId {
    /// The identifier, where it has no more than 11 bits.
    pub const fn standard(id: u16) -> Option<FrameId> {
        if id <= 0x7FF { Some(FrameId::Standard(id)) } else { None }
    }

    /// The identifier, where it has no more than 29 bits.
    pub const fn extended(id: u32) -> Option<FrameId> {
        if id <= 0x1FFF_FFFF { Some(FrameId::Extended(id)) } else { None }
    }
}

/// As tools of the field print it: three digits for 11 bits, eight for 29.
impl fmt::Display for FrameId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FrameId::Standard(id) => write!(f, "{id:03X}"),
            FrameId::Extended(id) => write!(f, "{id:08X}"),
        }
    }
}

/// A data frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Its identifier.
    pub id: FrameId,
    /// 0..=8, by construction.
    length: u8,
    /// Beyond the length all 0.
    bytes: [u8; MOST_BYTES],
}

impl Frame {
    /// A frame with this data; `None` for more than 8 bytes.
    pub fn new(id: FrameId, data: &[u8]) -> Option<Frame> {
        let mut bytes = [0; MOST_BYTES];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        // At most 8, as the line above has found room.
        Some(Frame { id, length: data.len() as u8, bytes })
    }

    /// Its data.
    pub fn data(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    /// Its data, to be filled in.
    pub fn data_mut(&mut self) -> &mut [u8] {
        &mut self.bytes[..usize::from(self.length)]
    }
}

/// A frame that came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedFrame {
    /// What came.
    pub frame: Frame,
    /// When, `CLOCK_MONOTONIC`, ns; the kernel's time where it says one.
    pub received_ns: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_holds_its_data_and_no_more_than_eight_bytes() {
        let id = FrameId::Standard(0x123);
        for length in 0..=MOST_BYTES {
            let data: Vec<u8> = (1..=length as u8).collect();
            assert_eq!(Frame::new(id, &data).expect("fits").data(), data);
        }
        assert_eq!(Frame::new(id, &[0; 9]), None);
        assert_eq!((FrameId::standard(0x7FF), FrameId::standard(0x800)), (Some(FrameId::Standard(0x7FF)), None));
        assert_eq!(FrameId::extended(0x2000_0000), None);
        assert_eq!(format!("{} {}", id, FrameId::Extended(0xABC)), "123 00000ABC");
    }
}
