//! Largest less smallest value of a channel over the last ticks, in memory of a fixed size: it is looked at in the loop.

/// The values of an unbroken stretch that can still become the largest or the smallest of a window.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SpreadWindow {
    /// Values rise towards the back: the front is the smallest of the window.
    least: Candidates,
    /// Values fall towards the back: the front is the largest of the window. Kept with their signs turned, so that these rise too.
    most: Candidates,
    /// First tick of the stretch.
    since: Option<u64>,
}

impl SpreadWindow {
    /// For conditions that need none.
    pub fn none() -> Self {
        let empty = || Candidates { ring: Box::new([]), first: 0, length: 0 };
        SpreadWindow { least: empty(), most: empty(), since: None }
    }

    /// For windows of up to so many ticks.
    pub fn for_ticks(ticks: u64) -> Self {
        SpreadWindow { least: Candidates::for_ticks(ticks), most: Candidates::for_ticks(ticks), since: None }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        (self.least.length, self.most.length) = (0, 0);
        self.since = None;
    }

    /// Adds the value of a tick, later than those before and no NaN; the spread from `ticks` before it until now, once values reach so
    /// far back. `ticks` is at least 1, at most what the window was made for, and the same since it was empty.
    pub fn push(&mut self, now: u64, value: f64, ticks: u64) -> Option<f64> {
        let since = *self.since.get_or_insert(now);
        let from = now.saturating_sub(ticks);
        self.least.push(now, value, from);
        self.most.push(now, -value, from);
        (since + ticks <= now).then(|| -self.most.front() - self.least.front())
    }
}

/// A ring of values that rise strictly, oldest first. A value is followed by none that is smaller: it could not be the smallest any more.
#[derive(Clone, Debug, PartialEq)]
struct Candidates {
    ring: Box<[(u64, f64)]>,
    first: usize,
    length: usize,
}

impl Candidates {
    fn for_ticks(ticks: u64) -> Self {
        Candidates { ring: vec![(0, 0.0); ticks as usize + 1].into(), first: 0, length: 0 }
    }

    fn place(&self, index: usize) -> usize {
        let place = self.first + index;
        if place < self.ring.len() { place } else { place - self.ring.len() }
    }

    /// The first place, counted from the front, of which `beyond` holds; it holds for all behind. By bisection: a value that takes the
    /// place of a whole window costs the tick no more than any other.
    fn partition(&self, beyond: impl Fn((u64, f64)) -> bool) -> usize {
        let (mut low, mut high) = (0, self.length);
        while low < high {
            let middle = low + (high - low) / 2;
            if beyond(self.ring[self.place(middle)]) { high = middle } else { low = middle + 1 }
        }
        low
    }

    fn push(&mut self, tick: u64, value: f64, from: u64) {
        let gone = self.partition(|(then, _)| then >= from);
        self.first = self.place(gone);
        self.length -= gone;
        self.length = self.partition(|(_, other)| other >= value);
        // One value a tick of a window of ring.len() ticks: there is a free place.
        let place = self.place(self.length);
        self.ring[place] = (tick, value);
        self.length += 1;
    }

    /// The smallest value; there is one since the last push.
    fn front(&self) -> f64 {
        self.ring[self.first].1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_spread_is_that_of_the_values_of_the_window(
            ticks in 1_u64..40,
            steps in prop::collection::vec((1_u64..5, -20_i32..20), 1..300),
            clear_at in 0_usize..300,
        ) {
            let mut window = SpreadWindow::for_ticks(ticks);
            let mut seen: Vec<(u64, f64)> = Vec::new();
            let mut now = 0;
            for (number, (passed, value)) in steps.into_iter().enumerate() {
                if number == clear_at {
                    window.clear();
                    seen.clear();
                }
                now += passed;
                seen.push((now, f64::from(value)));
                let inside = || seen.iter().filter(|(tick, _)| tick + ticks >= now).map(|(_, value)| *value);
                let expected = (seen[0].0 + ticks <= now)
                    .then(|| inside().fold(f64::MIN, f64::max) - inside().fold(f64::MAX, f64::min));
                prop_assert_eq!(window.push(now, f64::from(value), ticks), expected);
            }
        }
    }
}
