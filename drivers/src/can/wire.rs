//! Frames as the kernel has them: `struct can_frame` (linux/can.h), 16 bytes, its identifier in the machine's byte order.

use super::frame::MOST_BYTES;
use super::{ErrorFrame, Frame, FrameId};
use socketcan::{CanErrorFrame, CanFrame, EmbeddedFrame, Id};

/// Size of `struct can_frame`.
pub(super) const SIZE: usize = 16;
/// Where its data begins.
const DATA: usize = 8;

/// What a `struct can_frame` may hold.
pub(super) enum Content {
    Data(Frame),
    Error(ErrorFrame),
    /// A request for data, which nothing here uses.
    Remote,
}

/// The identifier with its flags.
pub(super) fn raw_id(id: FrameId) -> u32 {
    match id {
        FrameId::Standard(id) => u32::from(id) & libc::CAN_SFF_MASK,
        FrameId::Extended(id) => id & libc::CAN_EFF_MASK | libc::CAN_EFF_FLAG,
    }
}

pub(super) fn to_bytes(frame: &Frame) -> [u8; SIZE] {
    let mut bytes = [0; SIZE];
    bytes[..4].copy_from_slice(&raw_id(frame.id).to_ne_bytes());
    let data = frame.data();
    // At most 8, by the frame's construction.
    bytes[4] = data.len() as u8;
    bytes[DATA..DATA + data.len()].copy_from_slice(data);
    bytes
}

/// `None` for a length above 8.
pub(super) fn from_bytes(bytes: &[u8; SIZE]) -> Option<Content> {
    let [a, b, c, d, length, ..] = *bytes;
    let raw = u32::from_ne_bytes([a, b, c, d]);
    let length = usize::from(length);
    if length > MOST_BYTES {
        return None;
    }
    if raw & libc::CAN_ERR_FLAG != 0 {
        let error = CanErrorFrame::new_error(raw & libc::CAN_ERR_MASK, &bytes[DATA..]).ok()?;
        return Some(Content::Error(ErrorFrame::new(error)));
    }
    if raw & libc::CAN_RTR_FLAG != 0 {
        return Some(Content::Remote);
    }
    let id = match raw & libc::CAN_EFF_FLAG != 0 {
        true => FrameId::Extended(raw & libc::CAN_EFF_MASK),
        // 11 bits remain.
        false => FrameId::Standard((raw & libc::CAN_SFF_MASK) as u16),
    };
    Frame::new(id, &bytes[DATA..DATA + length]).map(Content::Data)
}

/// What a socket gave; `None` never comes for classic frames.
pub(super) fn from_socket(frame: CanFrame) -> Option<Content> {
    match frame {
        CanFrame::Data(data) => {
            let id = match data.id() {
                Id::Standard(id) => FrameId::Standard(id.as_raw()),
                Id::Extended(id) => FrameId::Extended(id.as_raw()),
            };
            Frame::new(id, data.data()).map(Content::Data)
        }
        CanFrame::Remote(_) => Some(Content::Remote),
        CanFrame::Error(error) => Some(Content::Error(ErrorFrame::new(error))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use socketcan::{CanDataFrame, ExtendedId, StandardId};

    proptest! {
        /// Independent encoder: the crate `socketcan`.
        #[test]
        fn a_frame_is_laid_out_as_the_kernel_has_it(raw in any::<u32>(), extended: bool, data in prop::collection::vec(any::<u8>(), 0..=8)) {
            let (id, theirs) = if extended {
                let raw = raw & 0x1FFF_FFFF;
                (FrameId::Extended(raw), CanDataFrame::new(ExtendedId::new(raw).expect("29 bits"), &data))
            } else {
                let raw = (raw & 0x7FF) as u16;
                (FrameId::Standard(raw), CanDataFrame::new(StandardId::new(raw).expect("11 bits"), &data))
            };
            let frame = Frame::new(id, &data).expect("at most 8 bytes");
            let bytes = to_bytes(&frame);
            let theirs = theirs.expect("a frame");
            let raw: &libc::can_frame = theirs.as_ref();
            prop_assert_eq!(&bytes[..5], &[&raw.can_id.to_ne_bytes()[..], &[raw.can_dlc]].concat()[..]);
            prop_assert_eq!(&bytes[5..], &[&[0; 3], &raw.data[..]].concat()[..]);
            prop_assert!(matches!(from_socket(CanFrame::Data(theirs)), Some(Content::Data(same)) if same == frame));
            let back = from_bytes(&bytes);
            prop_assert!(matches!(back, Some(Content::Data(back)) if back == frame));
        }
    }

    #[test]
    fn other_content_is_told_apart() {
        let mut bytes = to_bytes(&Frame::new(FrameId::Standard(5), &[1]).expect("a frame"));
        bytes[..4].copy_from_slice(&(5 | libc::CAN_RTR_FLAG).to_ne_bytes());
        assert!(matches!(from_bytes(&bytes), Some(Content::Remote)));
        bytes[..4].copy_from_slice(&(libc::CAN_ERR_BUSOFF | libc::CAN_ERR_FLAG).to_ne_bytes());
        assert!(matches!(from_bytes(&bytes), Some(Content::Error(error)) if error.cause.is_bus_off()));
        bytes[4] = 9;
        assert!(from_bytes(&bytes).is_none());
    }
}
