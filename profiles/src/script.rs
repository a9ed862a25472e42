//! A checked script: what it is for, and its steps with loops unrolled.

use crate::ask::Hands;
use crate::builtin::LoadError;
use crate::compile;
use crate::condition::Condition;
use crate::controlled::Controlled;
use crate::envelope::Envelope;
use crate::error::{ScriptError, Source};
use crate::expand;
use crate::instruction::rests;
use crate::playback::Playback;
use crate::raw::RawScript;
use crate::signal::Signal;
use crate::table::Tables;
use crate::values::TICK_S;
use rt_core::{Amount, Command, Fault, Fixture, OverrunPolicy};
use serde::Deserialize;
use std::path::Path;
use std::sync::Arc;

/// Largest angle, degrees either way, that a script may ask for: the range of the actuator with a little to spare.
pub const ANGLE_LIMIT_DEG: f64 = 45.0;
/// Largest pressure, bar absolute, that a script may ask for.
pub const PRESSURE_LIMIT_BAR: f64 = 8.0;

/// How long a step is foreseen that drives the pump until people confirm and has no time of its own, s.
pub const FORESEEN_S: f64 = 60.0;

/// The campaign format's protocols.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[allow(missing_docs, reason = "the names are the campaign format's; `as_str` gives them as written there")]
pub enum Protocol {
    TorqueMap,
    VolumeMap,
    PumpMap,
    ClampSteps,
    ConstantFlow,
    SquareWave,
    RandomSteps,
}

impl Protocol {
    /// As written in a campaign file.
    pub fn as_str(self) -> &'static str {
        match self {
            Protocol::TorqueMap => "torque-map",
            Protocol::VolumeMap => "volume-map",
            Protocol::PumpMap => "pump-map",
            Protocol::ClampSteps => "clamp-steps",
            Protocol::ConstantFlow => "constant-flow",
            Protocol::SquareWave => "square-wave",
            Protocol::RandomSteps => "random-steps",
        }
    }
}

/// What the run may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// May be fitted.
    Identify,
    /// Only simulated and scored.
    Validate,
}

impl Role {
    /// As written in a campaign file.
    pub fn as_str(self) -> &'static str {
        match self {
            Role::Identify => "identify",
            Role::Validate => "validate",
        }
    }
}

/// The plane in which the lever turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Plane {
    /// No gravity torque.
    Horizontal,
    /// Gravity acts.
    Vertical,
}

impl Plane {
    /// As written in a campaign file.
    pub fn as_str(self) -> &'static str {
        match self {
            Plane::Horizontal => "horizontal",
            Plane::Vertical => "vertical",
        }
    }
}

/// What a script is bound to before it runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Context {
    /// Largest voltage of the rig's amplifier, V (> 0): `voltage_u_max` is a fraction of it, and none may exceed it.
    pub u_max_v: f64,
    /// Seed of the random steps. Each script mixes its name in, so that two scripts of a campaign differ.
    pub seed: u64,
    /// Who does the operator's part.
    pub hands: Hands,
}

/// A parsed and checked script.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    /// Name of the run, `[a-z0-9_]+`.
    pub name: String,
    /// The campaign format's protocol.
    pub protocol: Protocol,
    /// What the run may be used for.
    pub role: Role,
    /// The plane in which the lever turns.
    pub plane: Plane,
    /// Free text, may be empty.
    pub about: String,
    /// The operator's preparation: pressure of both chambers, bar absolute; `None` = as it is.
    pub fill_bar: Option<f64>,
    /// What follows a missed deadline.
    pub overrun: OverrunPolicy,
    /// Limits that are narrower than the rig's, for the supervisor of this script's runs.
    pub envelope: Envelope,
    /// What is made to go wrong in the run, for a device that injects it. A replay needs none of it.
    pub faults: Vec<Fault>,
    /// The script as text, with the tables that it was read with: parses to the same script wherever it is taken.
    pub text: String,
    pub(crate) file: String,
    pub(crate) start: State,
    pub(crate) items: Vec<Item>,
}

impl Script {
    /// Reads and checks a script. `file_name` is used in errors only. Tables of a wave are found in the text alone, under
    /// `[files]`.
    ///
    /// # Errors
    /// Anything that is not the language: file, line, what was expected and what came.
    pub fn parse(text: &str, file_name: &str) -> Result<Script, ScriptError> {
        Script::build(text, file_name, None)
    }

    /// Reads and checks a script with the tables beside it.
    ///
    /// # Errors
    /// An unreadable file; anything that is not the language: file, line, what was expected and what came.
    pub fn read(path: &Path) -> Result<Script, LoadError> {
        let text = std::fs::read_to_string(path).map_err(|source| LoadError::Read { path: path.to_owned(), source })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Ok(Script::build(&text, &path.display().to_string(), Some(folder))?)
    }

    fn build(text: &str, file_name: &str, folder: Option<&Path>) -> Result<Script, ScriptError> {
        let source = Source { file: file_name, text };
        let raw: RawScript = toml::from_str(text).map_err(|error| {
            let offset = error.span().map_or(text.len(), |span| span.start);
            source.error(offset, error.message())
        })?;
        let tables = Tables::new(raw.files.as_ref(), folder);
        let script = expand::script(&raw, &source, &tables)?;
        Ok(Script { text: tables.self_contained(text), ..script })
    }

    /// Binds the script to a rig and a seed. The same script and context play the same.
    ///
    /// # Errors
    /// A voltage above the rig's `u_max_v`, or a context that is no rig's.
    pub fn compile(&self, context: &Context) -> Result<Playback, ScriptError> {
        compile::playback(self, context)
    }

    /// As [`compile`](Self::compile), for a prediction of the run: nobody is asked, and what people do is done at once. But a step that drives the
    /// pump until people confirm is played until its own conditions or its `timeout_s` end it, and without one for [`FORESEEN_S`].
    ///
    /// # Errors
    /// As there.
    pub fn foreseen(&self, context: &Context) -> Result<Playback, ScriptError> {
        compile::foreseen(self, context)
    }

    /// The operator's preparation: what is in force before the first step, at 0 V.
    pub fn start(&self) -> Command {
        let State { brake_open, bypass_open, fixture, .. } = self.start;
        Command { voltage_v: 0.0, brake_open, bypass_open, fixture, segment: 0 }
    }

    /// Shortest time the script can take, s: whatever is waited for is there at once, every loop that may be left early is.
    pub fn duration_least_s(&self) -> f64 {
        let mut least_s = 0.0;
        let mut left_until = 0;
        for (place, item) in self.items.iter().enumerate() {
            let skip = item.skips.iter().map(|skip| skip.to).max();
            left_until = left_until.max(skip.unwrap_or(0));
            if place >= left_until {
                least_s += item.kind.least_s();
            }
        }
        least_s
    }

    /// Longest time the script can take, s, where the rig does the operator's part: every wait runs into its timeout and no loop is
    /// left early. People take as long as they take.
    pub fn duration_bound_s(&self) -> f64 {
        self.items.iter().map(|item| item.kind.bound_s()).sum()
    }
}

/// What is in force at a tick, beside the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct State {
    pub brake_open: bool,
    pub bypass_open: bool,
    pub fixture: Fixture,
}

/// What a step changes when it begins; `None` = stays as it was.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Change {
    pub drive: Option<Drive>,
    pub brake_open: Option<bool>,
    pub bypass_open: Option<bool>,
    pub fixture: Option<FixtureChange>,
}

/// What the controller is to reach; fractions of u_max are resolved when the rig is known.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Drive {
    pub quantity: Controlled,
    pub wave: Wave,
}

impl Drive {
    /// 0 V.
    pub const AT_REST: Drive = Drive { quantity: Controlled::VoltageV, wave: Wave::Fixed(Signal::Constant(0.0)) };

    /// 0 V, for as long as it is in force.
    pub fn rests(&self) -> bool {
        matches!(&self.wave, Wave::Fixed(signal) if rests(self.quantity, signal))
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Wave {
    /// Needs nothing else.
    Fixed(Signal),
    /// Drawn when the seed is known.
    Random(RandomWave),
}

impl Wave {
    /// Smallest and largest value.
    pub fn range(&self) -> (f64, f64) {
        match self {
            Wave::Fixed(signal) => signal.range(),
            Wave::Random(wave) => (wave.range[0], wave.range[1]),
        }
    }
}

/// Values drawn evenly from a range, each for a time drawn evenly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RandomWave {
    pub range: [f64; 2],
    pub length_s: [f64; 2],
    pub ticks: u64,
    /// Its random stream.
    pub stream: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FixtureChange {
    To(Fixture),
    /// The lever is led to this angle at this rate from where it was last told to be (or is measured, where it was free).
    Ramp {
        to_deg: f64,
        rate_deg_s: f64,
    },
}

/// An unrolled step.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Item {
    pub line: usize,
    /// Variables and passes of the loops around it, in words; may be empty.
    pub with: Arc<str>,
    /// Looked at, in order, before the item begins: the first that is met goes on at another item, behind the loop whose
    /// pass begins here.
    pub skips: Vec<Skip>,
    pub kind: ItemKind,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Skip {
    pub when: Vec<Condition>,
    pub to: usize,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ItemKind {
    Hold(Hold),
    Random { stream: u64, steps: RandomSteps },
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Hold {
    pub change: Change,
    pub end: End,
    pub new_segment: bool,
    /// What people are asked for meanwhile, in the script's own words.
    pub operator: Option<OperatorPart>,
}

/// The operator's part of a hold, in the script's own words.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OperatorPart {
    pub text: String,
    /// The number that must be confirmed.
    pub amount: Option<Amount>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum End {
    After {
        seconds: f64,
    },
    Until {
        any: Vec<Condition>,
        timeout_s: f64,
    },
    /// When the ramp has arrived; `any` may end it earlier. That takes up to `bound_s` from where a script may lead a lever; one that stands
    /// beyond takes as long as its way does.
    Arrival {
        any: Vec<Condition>,
        bound_s: f64,
    },
    /// When the operator has confirmed; where the rig does the operator's part, after a tick. `any` and the timeout may end it
    /// earlier.
    Confirmed {
        any: Vec<Condition>,
        timeout_s: Option<f64>,
    },
}

/// A block of random voltage steps: each draws its length, size and sign evenly from the ranges; some are at 0 V, some with
/// the brake closed, some with the bypass open. Where the voltage drives the lever outward at `guard_deg` or beyond, it
/// changes sign for the rest of the step, in a segment of its own. Apart from the shares the brake is open and the bypass
/// closed; the last step's valves stay after the block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RandomSteps {
    /// Length of the whole block, s.
    pub total_s: f64,
    /// Shortest and longest step, s.
    pub length_s: [f64; 2],
    /// Smallest and largest size of the voltage, fraction of u_max.
    pub voltage_u_max: [f64; 2],
    /// Share of steps at 0 V.
    pub zero_share: f64,
    /// Share of steps with the brake closed.
    pub brake_closed_share: f64,
    /// Share of steps with the bypass open.
    pub bypass_open_share: f64,
    /// Angle beyond which no voltage drives outward, degrees.
    pub guard_deg: f64,
}

impl ItemKind {
    fn least_s(&self) -> f64 {
        match self {
            ItemKind::Hold(Hold { end: End::After { seconds }, .. }) => *seconds,
            ItemKind::Hold(_) => TICK_S,
            ItemKind::Random { steps, .. } => steps.total_s,
        }
    }

    fn bound_s(&self) -> f64 {
        match self {
            ItemKind::Hold(hold) => match hold.end {
                End::After { seconds } => seconds,
                End::Until { timeout_s, .. } => timeout_s,
                End::Arrival { bound_s, .. } => bound_s,
                End::Confirmed { .. } => TICK_S,
            },
            ItemKind::Random { steps, .. } => steps.total_s,
        }
    }
}
