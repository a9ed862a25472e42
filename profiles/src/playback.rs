//! Plays a compiled script: one step a tick, decided by the tick's number and the measurement alone.

use crate::ask::{Before, During, Ends, Request, When, needs_hands};
use crate::condition::Condition;
use crate::instruction::{Aim, Instruction};
use crate::ramp::{Ramp, commanded_deg};
use crate::script::{FixtureChange, State};
use crate::signal::Signal;
use crate::spread::SpreadWindow;
use crate::timeout::{Place, Timeout, Waited};
use rt_core::{Fixture, Measurement, Reference, Step, Target, Tick, Waiting};

/// The aim in force.
#[derive(Clone, Copy, Debug, PartialEq)]
struct InForce {
    /// The instruction that set it; `None`: 0 V, as the run starts.
    setter: Option<usize>,
    /// The tick at which it began.
    since: u64,
    /// Where a ramp without a start of its own sets out.
    begin: f64,
    /// The guard changed its sign.
    turned: bool,
}

/// A script bound to a rig and a seed. The same measurements at the same ticks give the same steps; a tick allocates nothing.
///
/// A run begins at tick 0. One of fixed durations of together N ticks is ticks 0 ..= N-1, the last of them with `last` set.
/// Where the last hold waits for a condition, or a loop at the end is left early, one more tick repeats the last step with
/// `last` set. After that the last step is repeated for ever.
///
/// Ticks may be left out. A hold whose time has passed meanwhile ended when it was due and its changes are applied, in order;
/// waves go by the tick's number. Conditions see the measurements of the ticks that are played, and their times.
///
/// Where people do the operator's part, it waits for them: before a hold, at 0 V, or within one that is theirs. The tick at which they
/// confirm is the last of the wait.
#[derive(Clone, Debug, PartialEq)]
pub struct Playback {
    instructions: Vec<Instruction>,
    /// Memory of the conditions of the hold under way, in their order.
    windows: Vec<SpreadWindow>,
    state: State,
    position: Position,
    /// Segment of the current instruction; `None` before the first.
    segment: Option<u32>,
    aim: InForce,
    ramp: Option<Ramp>,
    requests: Vec<Request>,
    /// The open request.
    asking: Option<Waiting>,
    /// When the last request of the current wait or hold was confirmed.
    confirmed_at: Option<u64>,
    /// The hold under way is people's.
    theirs: Option<Ends>,
    /// Of such a hold: its time is over, or a condition was met.
    over: bool,
    /// The wait before the hold began the hold's segment.
    segment_begun: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Position {
    Before,
    /// People are asked for something before this instruction begins.
    Asking {
        index: usize,
    },
    At {
        index: usize,
        since: u64,
        ticks: u64,
        /// A tick of it was played.
        played: bool,
    },
    Finished {
        /// The last instruction that was in force.
        index: usize,
        /// The last tick at which it was.
        at: u64,
    },
}

impl Playback {
    pub(crate) fn new(start: State, instructions: Vec<Instruction>, requests: Vec<Request>) -> Self {
        let aim = InForce { setter: None, since: 0, begin: 0.0, turned: false };
        let most = instructions.iter().map(|instruction| instruction.any.len()).max().unwrap_or(0);
        let ticks = |place: usize| {
            instructions.iter().filter_map(|i| i.any.get(place).map(Condition::window_ticks)).max().unwrap_or(0)
        };
        let windows = (0..most).map(|place| SpreadWindow::for_ticks(ticks(place))).collect();
        Playback {
            instructions,
            windows,
            state: start,
            position: Position::Before,
            segment: None,
            aim,
            ramp: None,
            requests,
            asking: None,
            confirmed_at: None,
            theirs: None,
            over: false,
            segment_begun: false,
        }
    }

    /// What people are asked for, by the number that the loop's [`Waiting`] carries. Empty where the rig does it itself.
    pub fn requests(&self) -> &[Request] {
        &self.requests
    }

    /// Ticks that the run lasts at most, without those in which it waits for people, or leads a lever back that stands beyond
    /// [`ANGLE_LIMIT_DEG`](crate::ANGLE_LIMIT_DEG).
    pub fn ticks_bound(&self) -> u64 {
        self.instructions.iter().map(|instruction| instruction.ticks).sum()
    }

    /// The holds that ended by their `timeout_s`, in their order, once the run is over.
    pub fn timeouts(&self) -> Vec<Timeout> {
        let struck =
            self.instructions.iter().enumerate().filter_map(|(step, i)| i.struck_at.map(|tick| (step, i, tick)));
        let waited = |c: &Condition| Waited { what: c.to_string(), left: c.last() };
        let timeout = |(step, i, tick): (usize, &Instruction, u64)| Timeout {
            step: step as u32,
            place: i.place(),
            tick,
            ticks: i.ticks,
            waited: i.any.iter().map(waited).collect(),
        };
        struck.map(timeout).collect()
    }

    /// Whether this unrolled step drives the pump until people confirm, and has no time of its own.
    pub fn is_open_ended(&self, step: u32) -> bool {
        self.instructions.get(step as usize).is_some_and(|instruction| instruction.open_ended)
    }

    /// Where this unrolled step is written. `None`: there is no such step.
    pub fn place(&self, step: u32) -> Option<Place> {
        self.instructions.get(step as usize).map(Instruction::place)
    }

    /// Brings the position up to this tick.
    fn advance(&mut self, now: Tick, measured: &Measurement) {
        // Each pass goes on by an instruction of at least one tick, so there are no more than ticks were left out.
        loop {
            let (next, begins) = match self.position {
                Position::Finished { .. } => return,
                Position::Before => (0, 0),
                Position::Asking { index } => match self.confirmed_at {
                    Some(at) if now.index > at => {
                        self.enter(index, at + 1, measured);
                        if at + 1 >= now.index {
                            return;
                        }
                        continue;
                    }
                    _ => return,
                },
                Position::At { index, since, ticks, .. } => {
                    // Every condition sees every tick: no short cut, their filters would miss it.
                    let instruction = &mut self.instructions[index];
                    let conditions = instruction.any.iter_mut().zip(&mut self.windows);
                    let met = conditions.fold(false, |met, (c, window)| c.met(now, measured, window) | met);
                    if let Some(ends) = self.theirs {
                        match self.their_end(ends, now, since + ticks, met) {
                            Some(begins) => (index + 1, begins),
                            None => return,
                        }
                    } else if now.index >= since + ticks {
                        if !(met || instruction.any.is_empty() || instruction.on_arrival) {
                            instruction.struck_at = Some(since + ticks);
                        }
                        (index + 1, since + ticks)
                    } else if met {
                        (index + 1, now.index)
                    } else {
                        return;
                    }
                }
            };
            self.leave(begins);
            match self.follow(next, now, measured) {
                Some(index) if self.asks_before(index) => {
                    self.ask(index);
                    return;
                }
                Some(index) => self.enter(index, begins, measured),
                None => {
                    let index = if let Position::At { index, .. } = self.position { index } else { 0 };
                    self.asking = None;
                    self.position = Position::Finished { index, at: begins.saturating_sub(1) };
                }
            }
            // A hold lasts a tick at least: it does not end at the one at which it begins.
            if begins >= now.index {
                return;
            }
        }
    }

    /// The current instruction is over before tick `ends`: its ramp stays where it was by then.
    fn leave(&mut self, ends: u64) {
        if let (Some(ramp), Position::At { since, .. }) = (self.ramp.take(), self.position) {
            self.state.fixture = ramp.fixture(ends.saturating_sub(since + 1));
        }
    }

    /// The instruction that follows, with the loops that end here left behind.
    fn follow(&mut self, mut index: usize, now: Tick, measured: &Measurement) -> Option<usize> {
        // A jump goes forward only, so this ends.
        while let Some(instruction) = self.instructions.get_mut(index) {
            let mut jumps = instruction.jumps.iter_mut();
            // None of them needs a window: they look at one tick.
            let mut none = SpreadWindow::none();
            match jumps
                .find_map(|jump| jump.when.iter_mut().any(|c| c.met(now, measured, &mut none)).then_some(jump.to))
            {
                Some(to) => index = to,
                None => return Some(index),
            }
        }
        None
    }

    /// The tick after a hold of people's, if it is over.
    fn their_end(&mut self, ends: Ends, now: Tick, due: u64, met: bool) -> Option<u64> {
        let time_over = now.index >= due;
        self.over |= met || time_over;
        let confirmed = self.confirmed_at.filter(|&at| now.index > at).map(|at| at + 1);
        match ends {
            Ends::ConfirmedAndOver => confirmed.filter(|_| self.over).map(|_| now.index),
            Ends::AskedUntilOver if time_over && !met && confirmed.is_none() => {
                if let Position::At { index, .. } = self.position {
                    self.instructions[index].struck_at = Some(due);
                }
                Some(due)
            }
            Ends::Confirmed | Ends::Asked | Ends::AskedUntilOver => confirmed.or(met.then_some(now.index)),
        }
    }

    /// Whether people must do something before this instruction can begin.
    fn asks_before(&self, index: usize) -> bool {
        let instruction = &self.instructions[index];
        match (instruction.part.before, &instruction.fixture) {
            (Some(Before { when: When::Changed, .. }), Some(change)) => needs_hands(&self.state.fixture, change),
            (Some(Before { when: When::Filled, .. }), _) => matches!(self.state.fixture, Fixture::Filled { .. }),
            _ => false,
        }
    }

    /// Begins to wait before an instruction: the valves as it wants them, and what held the lever goes on holding it.
    fn ask(&mut self, index: usize) {
        let instruction = &self.instructions[index];
        let state = &mut self.state;
        state.brake_open = instruction.brake_open.unwrap_or(state.brake_open);
        state.bypass_open = instruction.bypass_open.unwrap_or(state.bypass_open);
        state.fixture = state.fixture.at_rest();
        self.segment_begun = instruction.part.before.is_some_and(|before| before.when == When::Filled);
        self.segment = Some(self.segment.map_or(0, |segment| segment + u32::from(instruction.new_segment)));
        self.asking = instruction.part.before.map(|before| before.waiting);
        self.confirmed_at = None;
        self.theirs = None;
        self.position = Position::Asking { index };
    }

    fn enter(&mut self, index: usize, begins: u64, measured: &Measurement) {
        self.windows.iter_mut().for_each(SpreadWindow::clear);
        let in_force = self.target(begins);
        let instruction = &self.instructions[index];
        if let Some(Aim { quantity, gain, signal }) = &instruction.aim {
            let begin = match signal {
                // Where the start is not measured there is no way to go: it is at its end at once.
                Signal::Ramp { from: None, to, .. } => {
                    quantity.begin(in_force, measured).map_or(*to, |value| value / gain)
                }
                _ => 0.0,
            };
            self.aim = InForce { setter: Some(index), since: begins, begin, turned: false };
        }
        let theirs = instruction.part.during.filter(|during| {
            !during.ends.at_rest() || instruction.fixture.is_some_and(|to| needs_hands(&self.state.fixture, &to))
        });
        let state = &mut self.state;
        state.brake_open = instruction.brake_open.unwrap_or(state.brake_open);
        state.bypass_open = instruction.bypass_open.unwrap_or(state.bypass_open);
        let mut ticks = instruction.ticks;
        match instruction.fixture {
            Some(FixtureChange::To(fixture)) => state.fixture = fixture,
            Some(FixtureChange::Ramp { to_deg, rate_deg_s }) => {
                let from_deg = commanded_deg(&state.fixture)
                    .or(Some(measured.angle_deg).filter(|angle| angle.is_finite()))
                    .unwrap_or(to_deg);
                let ramp = Ramp { from_deg, to_deg, rate_deg_s };
                self.ramp = Some(ramp);
                if instruction.on_arrival {
                    ticks = ramp.ticks();
                }
            }
            None => {}
        }
        let begins_segment = instruction.new_segment && !std::mem::take(&mut self.segment_begun);
        self.segment = Some(match self.segment {
            None => 0,
            Some(segment) => segment + u32::from(begins_segment),
        });
        self.theirs = theirs.map(|During { ends, .. }| ends);
        self.asking = theirs.map(|During { waiting, .. }| waiting);
        self.confirmed_at = None;
        self.over = false;
        self.position = Position::At { index, since: begins, ticks, played: false };
    }

    /// The target in force at this tick.
    fn target(&self, tick: u64) -> Target {
        let InForce { setter, since, begin, turned } = self.aim;
        match setter.and_then(|index| self.instructions[index].aim.as_ref()) {
            Some(Aim { quantity, gain, signal }) => {
                let point = signal.at(tick.saturating_sub(since), begin);
                let gain = if turned { -gain } else { *gain };
                quantity.target(gain * point.value, gain * point.rate_per_s)
            }
            None => Target::VoltageV(0.0),
        }
    }

    /// Whether the target in force is 0 V for as long as it is in force.
    fn aim_rests(&self) -> bool {
        self.aim.setter.and_then(|index| self.instructions[index].aim.as_ref()).is_none_or(Aim::rests)
    }

    /// Turns an outward voltage round; where the hold was played before, that is a new set point.
    fn guard(&mut self, guard_deg: f64, now: Tick, played: bool, measured: &Measurement) {
        if let Target::VoltageV(voltage_v) = self.target(now.index)
            && measured.angle_deg.abs() >= guard_deg
            && measured.angle_deg * voltage_v > 0.0
        {
            self.aim.turned = !self.aim.turned;
            if played {
                self.segment = self.segment.map(|segment| segment + 1);
            }
        }
    }
}

impl Reference for Playback {
    fn fixture_at_start(&self) -> Fixture {
        self.state.fixture
    }

    fn confirmed(&mut self, now: Tick) {
        if self.asking.take().is_some() {
            self.confirmed_at = Some(now.index);
        }
    }

    fn step(&mut self, now: Tick, measured: &Measurement) -> Step {
        // What the device itself calls wrong decides nothing: it meets no condition, turns no voltage and begins no ramp.
        let measured = &measured.without_faulty();
        self.advance(now, measured);
        let (index, tick, last) = match self.position {
            Position::Before => (0, now.index, false),
            Position::Asking { index } => (index, now.index, false),
            Position::At { index, since, ticks, played } => {
                if let Some(guard_deg) = self.instructions[index].guard_deg {
                    self.guard(guard_deg, now, played, measured);
                }
                if let Some(ramp) = &self.ramp {
                    self.state.fixture = ramp.fixture(now.index.saturating_sub(since));
                }
                self.position = Position::At { index, since, ticks, played: true };
                let ends = index + 1 == self.instructions.len() && self.instructions[index].any.is_empty();
                let ends = ends && self.theirs.is_none();
                (index, now.index, ends && now.index + 1 >= since + ticks)
            }
            Position::Finished { index, at } => (index, at, true),
        };
        let at_rest = matches!(self.position, Position::Asking { .. }) || self.theirs.is_some_and(Ends::at_rest);
        let target = if at_rest { Target::VoltageV(0.0) } else { self.target(tick) };
        let State { brake_open, bypass_open, fixture } = self.state;
        let (segment, index, waiting) = (self.segment.unwrap_or(0), index as u32, self.asking);
        let hands_on = waiting.is_some() && (at_rest || self.aim_rests());
        Step { target, brake_open, bypass_open, fixture, segment, index, last, waiting, hands_on }
    }
}
