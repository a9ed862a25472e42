//! The course of a channel for display, in bounded memory: lowest and highest value of each of some thousand stretches.

/// Stretches at most; where there would be more, each two become one.
const MOST: usize = 2048;

/// A stretch of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// Of its first sample, s.
    pub begin_s: f64,
    /// Of its lowest value, NaN where there was none.
    pub low: f64,
    /// Of its highest value, NaN where there was none.
    pub high: f64,
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Curve {
    stretches: Vec<Stretch>,
    /// Samples of a stretch.
    samples_each: u64,
    /// Samples of the last stretch.
    filled: u64,
}

impl Default for Curve {
    fn default() -> Self {
        Curve { stretches: Vec::new(), samples_each: 1, filled: 1 }
    }
}

impl Curve {
    /// Takes the next sample; NaN = missing.
    pub fn push(&mut self, time_s: f64, value: f64) {
        if self.filled == self.samples_each {
            if self.stretches.len() == MOST {
                let pairs = self.stretches.chunks(2);
                self.stretches = pairs.map(|pair| pair[1..].iter().fold(pair[0], |a, b| joined(a, *b))).collect();
                self.samples_each *= 2;
            }
            self.stretches.push(Stretch { begin_s: time_s, low: value, high: value });
            self.filled = 1;
            return;
        }
        self.filled += 1;
        if let Some(last) = self.stretches.last_mut() {
            *last = joined(*last, Stretch { begin_s: time_s, low: value, high: value });
        }
    }

    /// In order of time.
    pub fn stretches(&self) -> &[Stretch] {
        &self.stretches
    }
}

/// `f64::min` and `max` pass over a NaN.
fn joined(a: Stretch, b: Stretch) -> Stretch {
    Stretch { begin_s: a.begin_s, low: a.low.min(b.low), high: a.high.max(b.high) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extremes_stay_wherever_they_are_and_memory_does_not_grow() {
        for count in [1u32, 2, MOST as u32, MOST as u32 + 1, 100_003] {
            for at in [0, count / 3, count - 1] {
                let mut curve = Curve::default();
                (0..count).for_each(|i| curve.push(f64::from(i), if i == at { 9.0 } else { f64::from(i % 7) }));
                let stretches = curve.stretches();
                assert!(stretches.len() <= MOST && stretches.windows(2).all(|pair| pair[0].begin_s < pair[1].begin_s));
                assert_eq!(stretches.iter().filter(|stretch| stretch.high == 9.0).count(), 1, "{at} of {count}");
                let holds = stretches.iter().rfind(|stretch| stretch.begin_s <= f64::from(at));
                assert_eq!(holds.map(|stretch| stretch.high), Some(9.0));
            }
        }
    }

    #[test]
    fn missing_values_are_passed_over() {
        let mut curve = Curve::default();
        (0..10 * MOST).for_each(|i| curve.push(i as f64, if i % 2 == 0 { f64::NAN } else { 1.0 }));
        assert!(curve.stretches().iter().all(|stretch| (stretch.low, stretch.high) == (1.0, 1.0)));
    }
}
