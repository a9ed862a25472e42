//! What people at the rig are asked for, where the rig does not do it itself.

use crate::error::ScriptError;
use crate::script::{Context, End, FixtureChange, Hold, OperatorPart, Protocol, Script};
use rt_core::{Amount, Fixture, Waiting};

/// Who does the operator's part: clamps, leads, fills, releases, reads the cylinder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hands {
    /// The rig itself: an emulated one, or one with an automatic fixture. Nothing is asked.
    #[default]
    Rig,
    /// People: the run asks, and waits until they confirm.
    People,
}

impl Hands {
    /// As written in a recording.
    pub fn as_str(self) -> &'static str {
        match self {
            Hands::Rig => "rig",
            Hands::People => "people",
        }
    }
}

/// What people are asked for at a step.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// The step at which it is asked, as in the samples: counted through the unrolled loops from 0.
    pub step: u32,
    /// Line of the step in the script.
    pub line: usize,
    /// What is to be done, in plain words.
    pub text: String,
    /// The number that the confirmation must bring.
    pub amount: Option<Amount>,
}

/// How people take part in a hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Part {
    pub before: Option<Before>,
    pub during: Option<During>,
}

/// Asked before the hold begins, at 0 V.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Before {
    pub waiting: Waiting,
    pub when: When,
}

/// Which fixture before makes it necessary to ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum When {
    /// One that has to be changed for this hold. The wait is a segment of its own, where the hold begins one.
    Changed,
    /// A filling, whose amount is asked. The wait is in the hold's own segment, so that the reading is.
    Filled,
}

/// The hold itself is what people do: it goes on until they confirm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct During {
    pub waiting: Waiting,
    pub ends: Ends,
}

/// What ends a hold of people's, beside its conditions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ends {
    /// Their confirmation alone; at 0 V.
    Confirmed,
    /// Their confirmation, and its own time or conditions; at 0 V.
    ConfirmedAndOver,
    /// Their confirmation, in a step in the script's own words; at the script's own target.
    Asked,
    /// The same, or its time.
    AskedUntilOver,
}

impl Ends {
    /// The pump rests meanwhile, whatever the script has in force.
    pub fn at_rest(self) -> bool {
        matches!(self, Ends::Confirmed | Ends::ConfirmedAndOver)
    }
}

/// Whether people have to do something to come from one fixture to the next.
pub(crate) fn needs_hands(from: &Fixture, change: &FixtureChange) -> bool {
    match *change {
        FixtureChange::To(Fixture::Clamped { angle_deg: at }) => match *from {
            // Held there already, and what was open was shut when its step was confirmed.
            Fixture::Clamped { angle_deg }
            | Fixture::Filled { angle_deg, .. }
            | Fixture::Released { angle_deg, .. } => angle_deg != at,
            _ => true,
        },
        // Each is a release of its own.
        FixtureChange::To(Fixture::Released { flow_ml_s, .. }) if flow_ml_s > 0.0 => true,
        FixtureChange::To(to) => *from != to,
        FixtureChange::Ramp { to_deg, .. } => match *from {
            Fixture::Clamped { angle_deg } | Fixture::Driven { angle_deg } => angle_deg != to_deg,
            _ => true,
        },
    }
}

/// Collects the requests of a script while it is compiled.
pub(crate) struct Requests<'a> {
    script: &'a Script,
    people: bool,
    requests: Vec<Request>,
}

impl<'a> Requests<'a> {
    pub fn new(script: &'a Script, hands: Hands) -> Self {
        Requests { script, people: hands == Hands::People, requests: Vec::new() }
    }

    /// Who is asked what in this hold, which is unrolled step `step`.
    pub fn of(&mut self, hold: &Hold, step: usize, line: usize) -> Part {
        if !self.people {
            return Part::default();
        }
        if let Some(OperatorPart { text, amount }) = &hold.operator {
            let waiting = self.ask(step, line, text.clone(), *amount);
            let timed = matches!(&hold.end, End::Confirmed { timeout_s: Some(_), .. });
            let ends = if timed { Ends::AskedUntilOver } else { Ends::Asked };
            return Part { before: None, during: Some(During { waiting, ends }) };
        }
        let Some(change) = hold.change.fixture else { return Part::default() };
        let text = text_of(&change, &hold.end);
        match change {
            FixtureChange::To(Fixture::Released { flow_ml_s, .. }) => {
                let (amount, ends) = if flow_ml_s > 0.0 {
                    (None, Ends::Confirmed)
                } else {
                    (Some(Amount::VolumeMl), Ends::ConfirmedAndOver)
                };
                let waiting = self.ask(step, line, text, amount);
                Part { before: None, during: Some(During { waiting, ends }) }
            }
            FixtureChange::To(_) => {
                let waiting = self.ask(step, line, text, None);
                Part { before: Some(Before { waiting, when: When::Changed }), during: None }
            }
            FixtureChange::Ramp { .. } => {
                let before = (self.script.protocol == Protocol::VolumeMap).then(|| {
                    let text = "measure how much oil was filled into chamber 1".to_owned();
                    let waiting = self.ask(step, line, text, Some(Amount::VolumeMl));
                    Before { waiting, when: When::Filled }
                });
                let waiting = self.ask(step, line, text, None);
                Part { before, during: Some(During { waiting, ends: Ends::Confirmed }) }
            }
        }
    }

    fn ask(&mut self, step: usize, line: usize, text: String, amount: Option<Amount>) -> Waiting {
        let request = self.requests.len() as u32;
        self.requests.push(Request { step: step as u32, line, text, amount });
        Waiting { request, amount }
    }

    pub fn into_list(self) -> Vec<Request> {
        self.requests
    }
}

fn text_of(change: &FixtureChange, end: &End) -> String {
    match *change {
        FixtureChange::To(fixture) => match fixture {
            Fixture::Free => "let the lever go: it must turn freely".to_owned(),
            Fixture::Clamped { angle_deg } => format!("clamp the lever at {angle_deg} deg"),
            // No step has it as its target: `driven` is a ramp.
            Fixture::Driven { angle_deg } => format!("hold the lever at {angle_deg} deg"),
            Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar } => format!(
                "hold the lever at {angle_deg} deg, fill chamber 1 to {pressure1_bar} bar and chamber 2 to {pressure2_bar} bar, \
                 shut both off, empty the measuring cylinder"
            ),
            Fixture::Released { angle_deg, flow_ml_s } if flow_ml_s > 0.0 => match end {
                End::After { seconds } => format!(
                    "with the lever held at {angle_deg} deg, release about {:.2} ml from chamber 1 into the measuring cylinder",
                    flow_ml_s * seconds
                ),
                _ => format!(
                    "with the lever held at {angle_deg} deg, release oil from chamber 1 into the measuring cylinder, about \
                     {flow_ml_s} ml/s"
                ),
            },
            Fixture::Released { angle_deg, .. } => format!(
                "with the lever held at {angle_deg} deg, read the measuring cylinder: all that was released since the last \
                 filling"
            ),
            Fixture::PumpBench { pressure1_bar, pressure2_bar } => format!(
                "connect the pump alone: port 1 to a reservoir at {pressure1_bar} bar, port 2 to one at {pressure2_bar} bar"
            ),
        },
        FixtureChange::Ramp { to_deg, rate_deg_s } => {
            format!("lead the lever to {to_deg} deg at about {rate_deg_s} deg/s and hold it there")
        }
    }
}

impl Script {
    /// What people prepare before a run, in plain words: plane, fixture, filling, valves.
    pub fn preparation(&self) -> String {
        let start = self.start();
        let fixture = text_of(&FixtureChange::To(start.fixture), &End::After { seconds: 0.0 });
        let filled = match (self.fill_bar, start.fixture) {
            (
                Some(bar),
                Fixture::Free | Fixture::Clamped { .. } | Fixture::Driven { .. } | Fixture::Released { .. },
            ) => {
                format!(", both chambers filled to {bar} bar")
            }
            _ => String::new(),
        };
        let lever = match start.fixture {
            Fixture::PumpBench { .. } => String::new(),
            _ => format!("lever turns in the {} plane; ", self.plane.as_str()),
        };
        format!("prepare the rig for {}: {lever}{fixture}{filled}", self.name)
    }

    /// Everything that people are asked for in a run where the rig does not do it itself, in the script's order. Which of it is asked
    /// depends on the run: a lever that is clamped where it is wanted is not clamped again, and a loop may be left early.
    ///
    /// # Errors
    /// As [`Script::compile`].
    pub fn requests(&self, context: &Context) -> Result<Vec<Request>, ScriptError> {
        Ok(self.compile(context)?.requests().to_vec())
    }
}
