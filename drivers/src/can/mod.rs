//! Frames on a CAN bus, and the thread that owns the bus.

mod frame;

pub use frame::{Frame, FrameId, MOST_BYTES, TimedFrame};
