//! The measuring cylinder and the operator's hand on it.

use super::settings::Settings;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rt_core::{Command, Fixture};

/// On the bench the cylinder is read this often, and for the first time after half of it, in ticks.
const BENCH_EVERY_TICKS: u64 = 200;

pub(super) struct Cylinder {
    readings: ChaCha8Rng,
    hand: ChaCha8Rng,
    noise_ml: f64,
    spread: f64,
    /// What the hand makes of the rate that it was told, for the present release.
    share: f64,
    /// Oil in chamber 1, ml, while it is known.
    oil_ml: Option<f64>,
    /// The reading of a cylinder at rest, ml.
    reading_ml: Option<f64>,
    /// First tick of the present segment.
    since: u64,
}

impl Cylinder {
    pub fn new(readings: ChaCha8Rng, hand: ChaCha8Rng, settings: &Settings) -> Self {
        Cylinder {
            readings,
            hand,
            noise_ml: settings.noise.volume_ml,
            spread: settings.release_spread,
            share: 1.0,
            oil_ml: None,
            reading_ml: None,
            since: 0,
        }
    }

    /// The rate that really flows where this one was asked for, ml/s.
    pub fn by_hand(&self, flow_ml_s: f64) -> f64 {
        self.share * flow_ml_s
    }

    /// Chamber 1 was filled with this amount, ml.
    pub fn filled(&mut self, oil_ml: f64) {
        self.oil_ml = Some(oil_ml);
        self.reading_ml = None;
    }

    /// A new command. Returns whether the count of oil begins anew.
    pub fn told(&mut self, before: &Command, now: &Command, tick: u64) -> bool {
        let releases = |command: &Command| match command.fixture {
            Fixture::Released { flow_ml_s, .. } => flow_ml_s > 0.0,
            _ => false,
        };
        if releases(now) {
            self.oil_ml = None;
            self.reading_ml = None;
            if !releases(before) {
                let deviation: f64 = self.hand.sample(StandardNormal);
                self.share = 1.0 + self.spread * deviation.clamp(-3.0, 3.0);
            }
        }
        // Through an open valve, or on a lever let go, oil moves that nobody measures.
        if now.brake_open || now.bypass_open || now.fixture == Fixture::Free {
            self.oil_ml = None;
            self.reading_ml = None;
        }
        if now.segment != before.segment {
            self.since = tick;
        }
        let on_bench = |command: &Command| matches!(command.fixture, Fixture::PumpBench { .. });
        let filling = matches!(now.fixture, Fixture::Filled { .. });
        (on_bench(now) && (now.segment != before.segment || !on_bench(before)))
            || (filling && before.fixture != now.fixture)
    }

    /// What is read at this tick under the command in force, ml; NaN = nothing. `counted_ml`: oil counted since the last
    /// filling, or on the bench since the segment began.
    pub fn read(&mut self, command: &Command, shut_off: bool, tick: u64, counted_ml: f64) -> f64 {
        match command.fixture {
            Fixture::Driven { .. } if shut_off => match self.oil_ml {
                Some(oil_ml) => self.at_rest(oil_ml),
                None => f64::NAN,
            },
            // An empty cylinder is seen to be empty.
            Fixture::Released { flow_ml_s: 0.0, .. } if counted_ml == 0.0 => 0.0,
            Fixture::Released { flow_ml_s: 0.0, .. } => self.at_rest(counted_ml),
            Fixture::PumpBench { .. } if command.voltage_v != 0.0 => {
                let phase = (tick - self.since) % BENCH_EVERY_TICKS;
                if phase == BENCH_EVERY_TICKS / 2 { counted_ml + self.error_ml() } else { f64::NAN }
            }
            _ => f64::NAN,
        }
    }

    fn at_rest(&mut self, amount_ml: f64) -> f64 {
        match self.reading_ml {
            Some(reading_ml) => reading_ml,
            None => {
                let reading_ml = amount_ml + self.error_ml();
                self.reading_ml = Some(reading_ml);
                reading_ml
            }
        }
    }

    fn error_ml(&mut self) -> f64 {
        let deviation: f64 = self.readings.sample(StandardNormal);
        self.noise_ml * deviation
    }
}
