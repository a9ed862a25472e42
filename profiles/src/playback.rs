//! Plays a compiled script: one step a tick, decided by the tick and the measurement alone.

use crate::compile::ticks_at_least;
use crate::condition::Condition;
use crate::script::{FixtureChange, State};
use rt_core::{Fixture, Measurement, Reference, Step, Target, Tick};

/// One hold, ready to play. It is played at most once, so its conditions keep their state in place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Instruction {
    /// Looked at before it begins.
    pub jumps: Vec<Jump>,
    pub target: Option<Target>,
    pub brake_open: Option<bool>,
    pub bypass_open: Option<bool>,
    pub fixture: Option<FixtureChange>,
    /// Longest duration, in ticks.
    pub ticks: u64,
    /// Ends it earlier.
    pub any: Vec<Condition>,
    /// Ends when its ramp has arrived.
    pub on_arrival: bool,
    pub new_segment: bool,
    /// Beyond this angle no voltage drives outward: it changes sign.
    pub guard_deg: Option<f64>,
}

/// Where a loop is left.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Jump {
    pub when: Vec<Condition>,
    pub to: usize,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Ramp {
    from_deg: f64,
    to_deg: f64,
    rate_deg_s: f64,
}

impl Ramp {
    fn angle_deg(&self, seconds: f64) -> f64 {
        let way_deg = self.to_deg - self.from_deg;
        let done_deg = self.rate_deg_s * seconds;
        if done_deg >= way_deg.abs() { self.to_deg } else { self.from_deg + done_deg.copysign(way_deg) }
    }
}

/// A script bound to a rig and a seed. The same measurements at the same ticks give the same steps; a tick allocates nothing.
///
/// A run of fixed durations of together N ticks is ticks 0 ..= N-1, the last of them with `last` set. Where the last hold
/// waits for a condition, or a loop at the end is left early, one more tick repeats the last step with `last` set. After
/// that the last step is repeated for ever.
#[derive(Clone, Debug, PartialEq)]
pub struct Playback {
    instructions: Vec<Instruction>,
    state: State,
    position: Position,
    /// Segment of the current instruction; `None` before the first.
    segment: Option<u32>,
    ramp: Option<Ramp>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Position {
    Before,
    At { index: usize, since: u64, ticks: u64 },
    Finished,
}

impl Playback {
    pub(crate) fn new(start: State, instructions: Vec<Instruction>) -> Self {
        Playback { instructions, state: start, position: Position::Before, segment: None, ramp: None }
    }

    /// Ticks that the run lasts at most.
    pub fn ticks_bound(&self) -> u64 {
        self.instructions.iter().map(|instruction| instruction.ticks).sum()
    }

    /// The instruction that follows, with the loops that end here left behind.
    fn follow(&mut self, mut index: usize, measured: &Measurement) -> Option<usize> {
        // A jump goes forward only, so this ends.
        while let Some(instruction) = self.instructions.get_mut(index) {
            let mut jumps = instruction.jumps.iter_mut();
            match jumps.find_map(|jump| jump.when.iter_mut().any(|c| c.met(measured)).then_some(jump.to)) {
                Some(to) => index = to,
                None => return Some(index),
            }
        }
        None
    }

    fn enter(&mut self, index: usize, now: Tick, measured: &Measurement) {
        let instruction = &self.instructions[index];
        let state = &mut self.state;
        state.target = instruction.target.unwrap_or(state.target);
        state.brake_open = instruction.brake_open.unwrap_or(state.brake_open);
        state.bypass_open = instruction.bypass_open.unwrap_or(state.bypass_open);
        let mut ticks = instruction.ticks;
        self.ramp = None;
        match instruction.fixture {
            Some(FixtureChange::To(fixture)) => state.fixture = fixture,
            Some(FixtureChange::Ramp { to_deg, rate_deg_s }) => {
                let from_deg = commanded_deg(&state.fixture)
                    .or(Some(measured.angle_deg).filter(|angle| angle.is_finite()))
                    .unwrap_or(to_deg);
                let ramp = Ramp { from_deg, to_deg, rate_deg_s };
                self.ramp = Some(ramp);
                if instruction.on_arrival {
                    ticks = ticks.min(ticks_at_least((to_deg - from_deg).abs() / rate_deg_s) + 1);
                }
            }
            None => {}
        }
        self.segment = Some(match self.segment {
            None => 0,
            Some(segment) => segment + u32::from(instruction.new_segment),
        });
        self.position = Position::At { index, since: now.index, ticks };
    }

    /// Goes on where the current instruction is over.
    fn advance(&mut self, now: Tick, measured: &Measurement) {
        let next = match self.position {
            Position::Finished => return,
            Position::Before => 0,
            Position::At { index, since, ticks } => {
                // Every condition sees every tick: no short cut, their filters would miss it.
                let met = self.instructions[index].any.iter_mut().fold(false, |met, c| c.met(measured) | met);
                if !met && now.index - since < ticks {
                    return;
                }
                index + 1
            }
        };
        match self.follow(next, measured) {
            Some(index) => self.enter(index, now, measured),
            None => self.position = Position::Finished,
        }
    }

    /// Turns an outward voltage round; within a hold that is a new set point.
    fn guard(&mut self, guard_deg: f64, begins: bool, measured: &Measurement) {
        if let Target::VoltageV(voltage_v) = self.state.target
            && measured.angle_deg.abs() >= guard_deg
            && measured.angle_deg * voltage_v > 0.0
        {
            self.state.target = Target::VoltageV(-voltage_v);
            if !begins {
                self.segment = self.segment.map(|segment| segment + 1);
            }
        }
    }
}

impl Reference for Playback {
    fn step(&mut self, now: Tick, measured: &Measurement) -> Step {
        self.advance(now, measured);
        let mut last = true;
        if let Position::At { index, since, ticks } = self.position {
            let elapsed = now.index - since;
            if let Some(guard_deg) = self.instructions[index].guard_deg {
                self.guard(guard_deg, elapsed == 0, measured);
            }
            if let Some(ramp) = &self.ramp {
                let seconds = Tick::at(elapsed).seconds();
                self.state.fixture = Fixture::Driven { angle_deg: ramp.angle_deg(seconds) };
            }
            last =
                index + 1 == self.instructions.len() && self.instructions[index].any.is_empty() && elapsed + 1 >= ticks;
        }
        let State { target, brake_open, bypass_open, fixture } = self.state;
        let index = match self.position {
            Position::Before => 0,
            Position::At { index, .. } => index,
            Position::Finished => self.instructions.len().saturating_sub(1),
        };
        let segment = self.segment.unwrap_or(0);
        Step { target, brake_open, bypass_open, fixture, segment, index: index as u32, last }
    }
}

/// The angle at which the lever was told to be.
fn commanded_deg(fixture: &Fixture) -> Option<f64> {
    match *fixture {
        Fixture::Clamped { angle_deg }
        | Fixture::Driven { angle_deg }
        | Fixture::Filled { angle_deg, .. }
        | Fixture::Released { angle_deg, .. } => Some(angle_deg),
        Fixture::Free | Fixture::PumpBench { .. } => None,
    }
}
