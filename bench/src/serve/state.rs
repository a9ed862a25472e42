//! The service's states and its queue. Pure: time is an argument, and what is to be done comes back as an [`Effect`].

use rt_core::ServiceState;
use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Longest time for which the service can be armed, s.
pub const ARMED_MOST_S: f64 = 86_400.0;
/// Profiles in the queue at most.
pub const QUEUE_MOST: usize = 100;

/// A profile that waits for its turn.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Queued {
    /// By which it is taken out again; never used twice.
    pub id: u64,
    /// Name of the profile.
    pub profile: String,
    /// Seed of its random steps.
    pub seed: u64,
}

/// How a run of the queue ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// As its script wanted, and every sample is recorded.
    Completed,
    /// The supervisor tripped.
    Tripped,
    /// Somebody asked for it.
    Stopped,
    /// A deadline was missed, or samples were lost.
    Aborted,
    /// It could not be begun, or its device failed, or its process did.
    Failed,
}

impl Outcome {
    /// As written in JSON.
    pub fn as_str(self) -> &'static str {
        match self {
            Outcome::Completed => "completed",
            Outcome::Tripped => "tripped",
            Outcome::Stopped => "stopped",
            Outcome::Aborted => "aborted",
            Outcome::Failed => "failed",
        }
    }
}

/// Why the service is held.
#[derive(Clone, Debug, PartialEq)]
pub struct Held {
    /// Number of the run that tripped; `None`: none was under way.
    pub run: Option<u32>,
    /// In words.
    pub reason: String,
}

/// What happens to the service.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// Start what is queued, for this long, s.
    Arm(f64),
    /// Start nothing more.
    Disarm,
    /// End the run orderly.
    Stop,
    /// Trip.
    EmergencyStop,
    /// The trip was seen.
    Acknowledge,
    /// A sample says that the supervisor has tripped.
    TripSeen(Held),
    /// The run of the queue has ended; what it said at its end.
    RunEnded(Outcome, String),
    /// Time has passed. `rig_free`: nobody else runs on this instance.
    Look {
        /// Whether a run may be started.
        rig_free: bool,
    },
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Start this; its end is to be told by [`Input::RunEnded`].
    Start(Queued),
    /// Ask the run, whosever it is, to stop.
    StopRun,
    /// Trip the run, whosever it is.
    TripRun,
}

/// Why something is not done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// What was expected and what is.
    pub error: String,
    /// What to do.
    pub remedy: String,
}

impl Refusal {
    /// With these words.
    pub fn new(error: impl Into<String>, remedy: impl Into<String>) -> Self {
        Refusal { error: error.into(), remedy: remedy.into() }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}; {}", self.error, self.remedy)
    }
}

#[derive(Clone, Debug, PartialEq)]
enum State {
    Idle,
    /// Until this time, s.
    Armed(f64),
    Running {
        number: u32,
        armed_until_s: Option<f64>,
        stopping: bool,
    },
    Tripped {
        held: Held,
        /// The run is still in its aftermath.
        run_alive: bool,
    },
}

/// Numbers of the runs that the service sees, its own and those of other processes, from 1.
#[derive(Debug, Default)]
pub struct RunNumbers(AtomicU32);

impl RunNumbers {
    /// The next one.
    pub fn next(&self) -> u32 {
        self.0.fetch_add(1, Ordering::Relaxed) + 1
    }
}

/// The service's desk: state and queue.
#[derive(Debug)]
pub struct Desk {
    state: State,
    queue: VecDeque<Queued>,
    next_id: u64,
    numbers: Arc<RunNumbers>,
}

impl Desk {
    /// Idle, with an empty queue.
    pub fn new(numbers: Arc<RunNumbers>) -> Self {
        Desk { state: State::Idle, queue: VecDeque::new(), next_id: 1, numbers }
    }

    /// How the service stands.
    pub fn state(&self) -> ServiceState {
        match self.state {
            State::Idle => ServiceState::Idle,
            State::Armed(_) => ServiceState::Armed,
            State::Running { .. } => ServiceState::Running,
            State::Tripped { .. } => ServiceState::Tripped,
        }
    }

    /// For how long it stays armed, s.
    pub fn armed_left_s(&self, now_s: f64) -> Option<f64> {
        match self.state {
            State::Armed(until_s) | State::Running { armed_until_s: Some(until_s), .. } => Some(until_s - now_s),
            _ => None,
        }
        .filter(|left_s| *left_s > 0.0)
    }

    /// Why it is held.
    pub fn held(&self) -> Option<&Held> {
        if let State::Tripped { held, .. } = &self.state { Some(held) } else { None }
    }

    /// What waits for its turn.
    pub fn queue(&self) -> impl ExactSizeIterator<Item = &Queued> {
        self.queue.iter()
    }

    /// Number of the run of the queue that is under way.
    pub fn own_run(&self) -> Option<u32> {
        match &self.state {
            State::Running { number, .. } => Some(*number),
            State::Tripped { held, run_alive: true } => held.run,
            _ => None,
        }
    }

    /// Appends to the queue; returns the id.
    ///
    /// # Errors
    /// The queue is full.
    pub fn enqueue(&mut self, profile: &str, seed: u64) -> Result<u64, Refusal> {
        if self.queue.len() >= QUEUE_MOST {
            let error = format!("the queue holds {QUEUE_MOST} profiles already");
            return Err(Refusal::new(error, "let it run, or take some out"));
        }
        let id = self.next_id;
        self.next_id += 1;
        self.queue.push_back(Queued { id, profile: profile.to_owned(), seed });
        Ok(id)
    }

    /// Takes out of the queue.
    ///
    /// # Errors
    /// It is not there.
    pub fn unqueue(&mut self, id: u64) -> Result<Queued, Refusal> {
        let place = self.queue.iter().position(|queued| queued.id == id);
        place.and_then(|place| self.queue.remove(place)).ok_or_else(|| {
            let error = format!("expected the id of a queued profile, got {id}");
            Refusal::new(error, "look what is queued: it may have been started, or taken out")
        })
    }

    /// One step. `Err` where the state does not allow what is asked; nothing has changed then.
    ///
    /// # Errors
    /// What the state is, and what to do.
    pub fn step(&mut self, input: Input, now_s: f64) -> Result<Option<Effect>, Refusal> {
        let (next, effect) = match (self.state.clone(), input) {
            (state, Input::Arm(for_s)) => (armed(state, for_s, now_s)?, None),
            (State::Armed(_), Input::Disarm) => (State::Idle, None),
            (State::Running { number, stopping, .. }, Input::Disarm) => {
                (State::Running { number, armed_until_s: None, stopping }, None)
            }
            (state, Input::Disarm) => (state, None),

            (State::Running { number, .. }, Input::Stop) => {
                (State::Running { number, armed_until_s: None, stopping: true }, Some(Effect::StopRun))
            }
            (State::Armed(_), Input::Stop) => (State::Idle, Some(Effect::StopRun)),
            (state, Input::Stop) => (state, Some(Effect::StopRun)),

            (state @ State::Tripped { .. }, Input::EmergencyStop) => (state, Some(Effect::TripRun)),
            (state, Input::EmergencyStop) => {
                let run = running(&state);
                let reason = "emergency stop".to_owned();
                (State::Tripped { held: Held { run, reason }, run_alive: run.is_some() }, Some(Effect::TripRun))
            }

            (State::Tripped { run_alive: false, .. }, Input::Acknowledge) => (State::Idle, None),
            (State::Tripped { run_alive: true, .. }, Input::Acknowledge) => {
                let error = "the run that tripped has not ended yet";
                return Err(Refusal::new(error, "wait until its recording is closed, then acknowledge"));
            }
            (_, Input::Acknowledge) => {
                let error = format!("expected a trip to acknowledge, and the service is {}", self.state().as_str());
                return Err(Refusal::new(error, "there is nothing to do"));
            }

            (state @ State::Tripped { .. }, Input::TripSeen(_)) => (state, None),
            (state, Input::TripSeen(held)) => {
                let run_alive = running(&state).is_some_and(|run| held.run == Some(run));
                (State::Tripped { held, run_alive }, None)
            }

            (State::Tripped { held, .. }, Input::RunEnded(..)) => (State::Tripped { held, run_alive: false }, None),
            (State::Running { number, .. }, Input::RunEnded(Outcome::Tripped, reason)) => {
                (State::Tripped { held: Held { run: Some(number), reason }, run_alive: false }, None)
            }
            (
                State::Running { armed_until_s: Some(until_s), stopping: false, .. },
                Input::RunEnded(Outcome::Completed, _),
            ) if until_s > now_s => (State::Armed(until_s), None),
            (State::Running { .. }, Input::RunEnded(..)) => (State::Idle, None),
            // There was none: nothing follows.
            (state @ (State::Idle | State::Armed(_)), Input::RunEnded(..)) => (state, None),

            (State::Armed(until_s), Input::Look { .. }) if until_s <= now_s => (State::Idle, None),
            (State::Armed(until_s), Input::Look { rig_free: true }) => match self.queue.pop_front() {
                None => (State::Armed(until_s), None),
                Some(queued) => {
                    let number = self.numbers.next();
                    let running = State::Running { number, armed_until_s: Some(until_s), stopping: false };
                    (running, Some(Effect::Start(queued)))
                }
            },
            (State::Running { number, armed_until_s: Some(until_s), stopping }, Input::Look { .. })
                if until_s <= now_s =>
            {
                (State::Running { number, armed_until_s: None, stopping }, None)
            }
            (state, Input::Look { .. }) => (state, None),
        };
        self.state = next;
        Ok(effect)
    }
}

fn running(state: &State) -> Option<u32> {
    if let State::Running { number, .. } = state { Some(*number) } else { None }
}

fn armed(state: State, for_s: f64, now_s: f64) -> Result<State, Refusal> {
    // NaN is in no range.
    if !(1.0..=ARMED_MOST_S).contains(&for_s) {
        let error = format!("for_s: expected 1 to {ARMED_MOST_S} s, got {for_s}");
        return Err(Refusal::new(error, "arm for a time within that"));
    }
    let until_s = now_s + for_s;
    match state {
        State::Idle | State::Armed(_) => Ok(State::Armed(until_s)),
        State::Running { number, stopping: false, .. } => {
            Ok(State::Running { number, armed_until_s: Some(until_s), stopping: false })
        }
        State::Running { stopping: true, .. } => {
            Err(Refusal::new("the run is being stopped", "arm again when it has ended"))
        }
        State::Tripped { held, .. } => {
            let error = format!("the service is tripped: {}", held.reason);
            Err(Refusal::new(error, "look after the rig, acknowledge, then arm"))
        }
    }
}

#[cfg(test)]
mod tests;
