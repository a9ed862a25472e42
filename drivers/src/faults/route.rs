//! A way on which things can be lost or late, and whose far end takes the newest.

use rt_core::Tick;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Room for more than one command a tick: the safe state may follow at once.
const SPARE: usize = 8;

/// Something on its way.
struct OnItsWay<T> {
    arrives_tick: u64,
    sent: u64,
    what: T,
}

impl<T> PartialEq for OnItsWay<T> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl<T> Eq for OnItsWay<T> {}

impl<T> PartialOrd for OnItsWay<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> Ord for OnItsWay<T> {
    /// The greatest arrives first.
    fn cmp(&self, other: &Self) -> Ordering {
        (other.arrives_tick, other.sent).cmp(&(self.arrives_tick, self.sent))
    }
}

/// The way from one sender to one receiver. Takes no memory after it is made.
pub(super) struct Route<T> {
    on_its_way: BinaryHeap<OnItsWay<T>>,
    room: usize,
    /// Numbers what is sent.
    sent: u64,
    /// The newest that has arrived, by its number.
    newest: Option<(u64, T)>,
    /// When something arrived last.
    heard_tick: u64,
    /// The receiver gives up after so many ticks without anything.
    timeout_ticks: Option<u32>,
}

impl<T: Copy> Route<T> {
    /// A way on which something takes `delay_ticks` at most.
    pub fn new(delay_ticks: u32, timeout_ticks: Option<u32>) -> Self {
        let room = if delay_ticks > 0 { delay_ticks as usize + SPARE } else { 0 };
        let on_its_way = BinaryHeap::with_capacity(room);
        Route { on_its_way, room, sent: 0, newest: None, heard_tick: 0, timeout_ticks }
    }

    pub fn begin_run(&mut self) {
        self.on_its_way.clear();
        (self.sent, self.newest, self.heard_tick) = (0, None, 0);
    }

    /// Nothing passes, and what is on its way never arrives.
    pub fn cut(&mut self) {
        self.on_its_way.clear();
    }

    /// Something is sent that never arrives. Its number, should it come after all.
    pub fn skip(&mut self) -> u64 {
        self.sent += 1;
        self.sent
    }

    /// Something is sent and arrives at once.
    pub fn arrive(&mut self, now: Tick, what: T) {
        let number = self.skip();
        self.take(now, number, what);
    }

    /// Something that was sent before arrives now: nothing happens where a newer one is there.
    pub fn take(&mut self, now: Tick, number: u64, what: T) {
        self.heard_tick = now.index;
        if self.newest.is_none_or(|(newest, _)| newest < number) {
            self.newest = Some((number, what));
        }
    }

    /// Something is sent that arrives so many ticks later.
    pub fn send_late(&mut self, now: Tick, ticks: u64, what: T) {
        let sent = self.skip();
        if self.on_its_way.len() < self.room {
            self.on_its_way.push(OnItsWay { arrives_tick: now.index + ticks, sent, what });
        }
    }

    /// What was late arrives, if its time has come.
    pub fn deliver(&mut self, now: Tick) {
        while let Some((number, what)) = self.arrived(now) {
            self.take(now, number, what);
        }
    }

    /// The next that was late and whose time has come.
    pub fn arrived(&mut self, now: Tick) -> Option<(u64, T)> {
        if self.on_its_way.peek()?.arrives_tick > now.index {
            return None;
        }
        self.on_its_way.pop().map(|arrived| (arrived.sent, arrived.what))
    }

    /// The newest that has arrived.
    pub fn newest(&self) -> Option<T> {
        self.newest.map(|(_, what)| what)
    }

    /// The same in another shape: the receiver takes it for a fresh one.
    pub fn renew(&mut self, with: impl FnOnce(&mut T)) {
        if let Some((_, what)) = &mut self.newest {
            with(what);
        }
    }

    /// The newest that has arrived, unless the receiver has given up waiting.
    pub fn in_force(&self, now: Tick) -> Option<T> {
        let silent_ticks = now.index.saturating_sub(self.heard_tick);
        let timed_out = self.timeout_ticks.is_some_and(|timeout| silent_ticks >= u64::from(timeout.max(1)));
        self.newest().filter(|_| !timed_out)
    }
}
