//! Bytes on their way to the port.

/// Bytes of room: several of the longest frames of any protocol.
const ROOM: usize = 1024;

/// Bytes that are to be written to the port: whole frames, in order. Fixed room, no allocation.
#[derive(Clone, Debug)]
pub struct Outbox {
    bytes: [u8; ROOM],
    length: usize,
    dropped: u64,
}

impl Default for Outbox {
    fn default() -> Self {
        Outbox { bytes: [0; ROOM], length: 0, dropped: 0 }
    }
}

impl Outbox {
    /// An empty one.
    pub fn new() -> Outbox {
        Outbox::default()
    }

    /// What is to be written.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    /// Whether there is nothing to write.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }

    /// Forgets all bytes.
    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// Forgets the first bytes: those that the port took. More than there are is all.
    pub fn written(&mut self, bytes: usize) {
        let bytes = bytes.min(self.length);
        self.bytes.copy_within(bytes..self.length, 0);
        self.length -= bytes;
    }

    /// Appends a frame. A frame for which there is no room is dropped whole and counted; then `false`.
    pub fn push(&mut self, frame: &[u8]) -> bool {
        let Some(room) = self.bytes[self.length..].get_mut(..frame.len()) else {
            self.dropped += 1;
            return false;
        };
        room.copy_from_slice(frame);
        self.length += frame.len();
        true
    }

    /// Frames that found no room, since it was made.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_stay_whole_and_in_order() {
        let mut out = Outbox::new();
        assert!(out.push(&[1, 2, 3]) && out.push(&[4]));
        out.written(2);
        assert!(out.push(&[5]));
        assert_eq!(out.bytes(), [3, 4, 5]);
        assert!(!out.push(&[0; ROOM - 2]) && out.push(&[9; ROOM - 3]));
        assert_eq!((out.bytes().len(), out.dropped()), (ROOM, 1));
        out.written(ROOM + 1);
        assert!(out.is_empty());
    }
}
