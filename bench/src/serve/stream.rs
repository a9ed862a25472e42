//! The live buckets of one run as clients get them: a bounded history, from which each client takes what it has not had.

use super::buckets::{Bucket, encode};
use axum::body::Bytes;
use std::collections::VecDeque;

/// Of the history, s.
pub const HISTORY_S: usize = 60;
/// Buckets of the history.
const KEPT: usize = HISTORY_S * 100;
/// A client that is behind by more buckets than this goes on with the newest.
const BEHIND_MOST: u64 = 200;

/// What a client is told before a run's first buckets.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Begin {
    /// Number of the run; 0: none yet.
    pub run: u32,
    /// Its name; empty where it is not known.
    pub name: String,
    /// When its tick 0 was due, ms since 1970.
    pub origin_utc_ms: Option<f64>,
}

/// How far a client is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cursor {
    run: u32,
    /// Buckets of the run up to here it has had, or was passed over.
    next: u64,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Stream {
    begin: Begin,
    buckets: VecDeque<Bucket>,
    /// Place within the run of the first bucket that is kept.
    first: u64,
    /// Buckets that are sent to everybody, from this place on: encoded once.
    newest: (u64, Bytes),
}

/// What is to be sent to a client.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parcel {
    /// The run is a new one to it.
    pub begin: Option<Begin>,
    /// Buckets, encoded; empty where there are none.
    pub bytes: Bytes,
}

impl Stream {
    /// A new run: the old one is forgotten.
    pub fn begin(&mut self, begin: Begin) {
        *self = Stream { begin, ..Stream::default() };
    }

    /// What is known of the run by now.
    pub fn describe(&mut self, name: &str, origin_utc_ms: Option<f64>) {
        name.clone_into(&mut self.begin.name);
        self.begin.origin_utc_ms = origin_utc_ms;
    }

    /// Appends; to be followed by [`Stream::publish`] now and then.
    pub fn push(&mut self, bucket: Bucket) {
        if self.buckets.len() == KEPT {
            self.buckets.pop_front();
            self.first += 1;
        }
        self.buckets.push_back(bucket);
    }

    fn end(&self) -> u64 {
        self.first + self.buckets.len() as u64
    }

    fn encoded_end(&self) -> u64 {
        let (from, bytes) = &self.newest;
        // Their number stands in the third word.
        let count = bytes.get(8..12).and_then(|word| word.try_into().ok()).map_or(0, u32::from_le_bytes);
        from + u64::from(count)
    }

    /// Makes what was appended since the last call ready for clients; says whether there is anything.
    pub fn publish(&mut self) -> bool {
        let (from, to) = (self.encoded_end().max(self.first), self.end());
        if from == to {
            return false;
        }
        self.newest = (from, self.encoded(from));
        true
    }

    fn encoded(&self, from: u64) -> Bytes {
        let from = (from.saturating_sub(self.first)) as usize;
        Bytes::from(encode(self.begin.run, self.buckets.range(from.min(self.buckets.len())..)))
    }

    /// What a client has not had, up to what was published last.
    pub fn next(&self, cursor: &mut Cursor) -> Parcel {
        if self.begin.run == 0 || self.newest.1.is_empty() {
            return Parcel::default();
        }
        let new_run = cursor.run != self.begin.run;
        if new_run {
            *cursor = Cursor { run: self.begin.run, next: self.first };
        }
        let begin = new_run.then(|| self.begin.clone());
        let (newest, bytes) = &self.newest;
        let from = std::mem::replace(&mut cursor.next, self.encoded_end());
        let bytes = if from >= cursor.next {
            Bytes::new()
        } else if from == *newest || (!new_run && cursor.next - from > BEHIND_MOST) {
            bytes.clone()
        } else {
            // What was appended since is not published yet: it is sent now, and not again.
            cursor.next = self.end();
            self.encoded(from)
        };
        Parcel { begin, bytes }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::serve::buckets::{COUNT, Span};

    fn bucket(place: u64) -> Bucket {
        Bucket { begin_s: place as f64 * 0.01, spans: [Span { min: 0.0, max: 0.0, last: 0.0 }; COUNT] }
    }

    /// First time and number of the buckets.
    fn content(parcel: &Parcel) -> Option<(f64, u32)> {
        let bytes = &parcel.bytes;
        let count = u32::from_le_bytes(bytes.get(8..12)?.try_into().ok()?);
        Some((f64::from_le_bytes(bytes[16..24].try_into().ok()?), count))
    }

    fn grown(stream: &mut Stream, places: std::ops::Range<u64>) {
        places.for_each(|place| stream.push(bucket(place)));
        assert!(stream.publish());
    }

    #[test]
    fn a_client_gets_the_history_then_each_bucket_once() {
        let mut stream = Stream::default();
        let mut early = Cursor::default();
        assert_eq!(stream.next(&mut early), Parcel::default(), "no run yet");
        stream.begin(Begin { run: 3, name: "a".to_owned(), origin_utc_ms: None });
        assert!(!stream.publish(), "nothing to publish");
        grown(&mut stream, 0..4);
        let first = stream.next(&mut early);
        assert_eq!((first.begin.as_ref().map(|begin| begin.run), content(&first)), (Some(3), Some((0.0, 4))));
        grown(&mut stream, 4..8);
        let second = stream.next(&mut early);
        assert_eq!((second.begin.clone(), content(&second)), (None, Some((0.04, 4))));
        assert_eq!(stream.next(&mut early), Parcel::default(), "it has had everything");
        let mut late = Cursor::default();
        assert_eq!(content(&stream.next(&mut late)), Some((0.0, 8)));
        stream.push(bucket(8));
        assert_eq!(content(&stream.next(&mut Cursor::default())), Some((0.0, 9)));
        assert!(stream.publish());
        assert_eq!(content(&stream.next(&mut late)), Some((0.08, 1)));
    }

    #[test]
    fn a_client_that_is_a_little_behind_catches_up_and_one_far_behind_jumps() {
        let mut stream = Stream::default();
        stream.begin(Begin { run: 1, ..Begin::default() });
        grown(&mut stream, 0..4);
        let (mut slow, mut slower) = (Cursor::default(), Cursor::default());
        stream.next(&mut slow);
        stream.next(&mut slower);
        grown(&mut stream, 4..104);
        grown(&mut stream, 104..108);
        assert_eq!(content(&stream.next(&mut slow)), Some((0.04, 104)), "no gap yet");
        grown(&mut stream, 108..304);
        grown(&mut stream, 304..308);
        assert_eq!(content(&stream.next(&mut slower)), Some((3.04, 4)), "it jumps to the newest");
        assert_eq!(stream.next(&mut slower), Parcel::default());
    }

    #[test]
    fn the_history_is_bounded_and_a_new_run_begins_afresh() {
        let mut stream = Stream::default();
        stream.begin(Begin { run: 1, ..Begin::default() });
        for place in 0..(2 * KEPT as u64) {
            stream.push(bucket(place));
            if place % 4 == 3 {
                stream.publish();
            }
        }
        let mut cursor = Cursor::default();
        assert_eq!(content(&stream.next(&mut cursor)), Some((KEPT as f64 * 0.01, KEPT as u32)));
        stream.begin(Begin { run: 2, ..Begin::default() });
        assert_eq!(stream.next(&mut cursor), Parcel::default(), "it has nothing to show yet");
        grown(&mut stream, 0..1);
        let parcel = stream.next(&mut cursor);
        assert_eq!((parcel.begin.as_ref().map(|begin| begin.run), content(&parcel)), (Some(2), Some((0.0, 1))));
    }
}
