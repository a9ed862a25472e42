//! How much of a campaign is done and how long the rest takes.

use std::time::{Duration, Instant};

/// Of a campaign under way.
pub struct Outlook {
    /// Longest time of each run, s.
    at_most_s: Vec<f64>,
    there: Vec<bool>,
    /// Runs of this call: what they took, and the longest that they could have taken, s.
    took: Duration,
    could_have_taken_s: f64,
    began: Instant,
}

impl Outlook {
    /// Before the first run of a call.
    pub fn new(at_most_s: Vec<f64>, there: Vec<bool>) -> Self {
        Outlook { at_most_s, there, took: Duration::ZERO, could_have_taken_s: 0.0, began: Instant::now() }
    }

    /// The line that announces run number `run`, from 0.
    pub fn announce(&mut self, run: usize, name: &str) -> String {
        self.began = Instant::now();
        let (done, all) = (self.there.iter().filter(|there| **there).count(), self.there.len());
        format!("run {} of {all}: {name}; {done} done, {}", run + 1, self.remaining())
    }

    /// A run came to its end.
    pub fn done(&mut self, run: usize) {
        self.took += self.began.elapsed();
        self.could_have_taken_s += self.at_most_s[run];
        self.there[run] = true;
    }

    fn remaining(&self) -> String {
        let left = self.at_most_s.iter().zip(&self.there).filter(|(_, there)| !**there).map(|(s, _)| s);
        estimate(left.sum(), self.took.as_secs_f64(), self.could_have_taken_s)
    }
}

/// What is left, in words. Runs end before their longest time, and virtual time runs faster: those that are done tell by how much.
fn estimate(left_s: f64, took_s: f64, could_have_taken_s: f64) -> String {
    if could_have_taken_s > 0.0 {
        format!("about {} to go", span(left_s * took_s / could_have_taken_s))
    } else {
        format!("at most {} of the rig's time to go", span(left_s))
    }
}

/// A time as people say it.
pub fn span(seconds: f64) -> String {
    let whole = seconds.max(0.0).ceil() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s} s"),
        (h, m, _) => format!("{h} h {m} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_done_tells_how_long_the_rest_takes() {
        assert_eq!(estimate(600.0, 0.0, 0.0), "at most 10 min 0 s of the rig's time to go");
        assert_eq!(estimate(600.0, 50.0, 100.0), "about 5 min 0 s to go");
        let mut outlook = Outlook::new(vec![10.0, 3600.0, 20.0], vec![true, false, false]);
        assert_eq!(
            outlook.announce(1, "pump_map"),
            "run 2 of 3: pump_map; 1 done, at most 1 h 0 min of the rig's time to go"
        );
        outlook.done(1);
        assert!(outlook.announce(2, "square").starts_with("run 3 of 3: square; 2 done, about "));
    }

    #[test]
    fn spans_are_rounded_up() {
        assert_eq!([0.0, 59.2, 61.0, 7260.0].map(span), ["0 s", "1 min 0 s", "1 min 1 s", "2 h 1 min"]);
    }
}
