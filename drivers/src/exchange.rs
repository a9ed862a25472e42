//! Hand-over of values between the loop and an I/O thread over a `ringbuf` queue of one producer and one consumer: neither side waits,
//! neither allocates, and the newest value wins.

use ringbuf::traits::{Consumer, Producer, Split};
use ringbuf::{HeapCons, HeapProd, HeapRb};

/// Both ends of a queue for `capacity` (> 0) values. A consumer that is served once a tick needs a few; what a consumer that
/// has stopped no longer takes is refused, so values that can grow stale carry their time with them.
pub fn exchange<T: Copy>(capacity: usize) -> (Giver<T>, Taker<T>) {
    let (give, take) = HeapRb::new(capacity).split();
    (Giver { queue: give }, Taker { queue: take })
}

/// Gives values.
pub struct Giver<T> {
    queue: HeapProd<T>,
}

impl<T: Copy> Giver<T> {
    /// Hands a value over; `false` where the other side has not taken `capacity` of them.
    pub fn give(&mut self, value: T) -> bool {
        self.queue.try_push(value).is_ok()
    }
}

/// Takes values.
pub struct Taker<T> {
    queue: HeapCons<T>,
}

impl<T: Copy> Taker<T> {
    /// The value that was given last since the last call, if any; those before it are passed over.
    pub fn newest(&mut self) -> Option<T> {
        let mut newest = None;
        self.each(|value| newest = Some(value));
        newest
    }

    /// The oldest value that was not taken yet.
    pub fn oldest(&mut self) -> Option<T> {
        self.queue.try_pop()
    }

    /// Every value since the last call, oldest first.
    pub fn each(&mut self, mut with: impl FnMut(T)) {
        // No more than there are now: a fast producer must not keep the consumer here.
        for _ in 0..ringbuf::traits::Observer::occupied_len(&self.queue) {
            if let Some(value) = self.queue.try_pop() {
                with(value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_wins_and_none_is_taken_twice() {
        let (mut give, mut take) = exchange(4);
        assert_eq!(take.newest(), None);
        assert!((1..=3).all(|n| give.give(n)));
        assert_eq!(take.newest(), Some(3));
        assert_eq!(take.newest(), None);
    }

    #[test]
    fn a_full_queue_refuses_and_the_order_stays() {
        let (mut give, mut take) = exchange(4);
        assert_eq!((1..=6).map(|n| give.give(n)).collect::<Vec<_>>(), [true, true, true, true, false, false]);
        let mut taken = vec![];
        take.each(|n| taken.push(n));
        assert_eq!(taken, [1, 2, 3, 4]);
    }

    #[test]
    fn across_threads_values_arrive_in_order() {
        let (mut give, mut take) = exchange(8);
        let sender = std::thread::spawn(move || (1..=10_000u64).filter(|&n| give.give(n)).count());
        let mut last = 0;
        while !sender.is_finished() || last == 0 {
            if let Some(n) = take.newest() {
                assert!(n > last, "{n} after {last}");
                last = n;
            }
        }
        assert!(sender.join().is_ok_and(|accepted| accepted > 0));
    }
}
