//! What decides the loop's outputs besides script and measurements: limits, safe state, seed, largest voltage, model. It stands in
//! every recording, so that the run can be replayed from its recording alone.

use crate::controller::{PumpController, Settings as LoopSettings};
use crate::failure::{Failure, Kind};
use crate::rig_file::{RawLimits, RawSafeState};
use model::ModelFile;
use profiles::{Hands, Plane};
use recordings::RunMetadata;
use rt_core::{Controller, Limits, SafeState};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the note that holds the setup, as TOML.
const SETUP_NOTE: &str = "setup";
/// Name of the file that holds the controller's model. In the first recordings it was a note.
const MODEL_FILE: &str = "model.toml";
/// Name of that note.
const MODEL_NOTE: &str = "model";

/// What the controller knows of the rig, which decides the targets that it can serve.
#[derive(Clone, Debug, PartialEq)]
pub enum Knowledge {
    /// Voltages only.
    Nothing,
    /// Flows too: of this model only the pump is measured.
    Pump(ModelFile),
    /// Pressures and angles too.
    Model(ModelFile, LoopSettings),
}

impl Knowledge {
    fn model(&self) -> Option<&ModelFile> {
        match self {
            Knowledge::Nothing => None,
            Knowledge::Pump(model) | Knowledge::Model(model, _) => Some(model),
        }
    }

    /// The controller of a run in this plane.
    ///
    /// # Errors
    /// Settings out of range, a model that can't be inverted (2).
    pub fn controller(&self, plane: Plane) -> Result<Box<dyn Controller + Send>, Failure> {
        let controller = match self {
            Knowledge::Nothing => PumpController::open_loop(),
            Knowledge::Pump(model) => PumpController::with_pump(model.parameters.pump),
            Knowledge::Model(model, settings) => {
                let settings = LoopSettings { vertical: plane == Plane::Vertical, ..*settings };
                PumpController::with_effects(model, settings).map_err(|e| Failure::of(Kind::Input, &e))?
            }
        };
        Ok(Box::new(controller))
    }
}

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Seed of the script's random steps.
    pub seed: u64,
    /// Largest voltage of the rig, V.
    pub u_max_v: f64,
    /// What the supervisor enforced.
    pub limits: Limits,
    /// What the controller knew.
    pub knowledge: Knowledge,
    /// Who did the operator's part.
    pub hands: Hands,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    // As text: TOML's integers have a sign.
    seed: String,
    u_max_v: f64,
    /// `people`; left out where the rig did the operator's part itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    operator: Option<String>,
    limits: RawLimits,
    safe_state: RawSafeState,
    /// Left out where the model's pump alone is known.
    controller: Option<LoopSettings>,
}

impl Setup {
    /// The setup of a run.
    pub fn of(seed: u64, u_max_v: f64, limits: &Limits, knowledge: &Knowledge) -> Self {
        Setup { seed, u_max_v, limits: *limits, knowledge: knowledge.clone(), hands: Hands::Rig }
    }

    /// The same with these hands.
    pub fn by(self, hands: Hands) -> Self {
        Setup { hands, ..self }
    }

    /// The note that holds it, but for its model. Numbers are written so that they read back as the same bits.
    pub fn notes(&self) -> BTreeMap<String, String> {
        let written = Written {
            seed: self.seed.to_string(),
            u_max_v: self.u_max_v,
            limits: RawLimits::of(&self.limits),
            safe_state: RawSafeState::of(self.limits.safe_state),
            operator: (self.hands == Hands::People).then(|| self.hands.as_str().to_owned()),
            controller: match self.knowledge {
                Knowledge::Model(_, settings) => Some(settings),
                Knowledge::Pump(_) | Knowledge::Nothing => None,
            },
        };
        let text = toml::to_string(&written).expect("plain numbers and words always have a TOML form");
        BTreeMap::from([(SETUP_NOTE.to_owned(), text)])
    }

    /// The files that it needs besides: the controller's model, where there is one.
    pub fn files(&self) -> BTreeMap<String, String> {
        self.knowledge.model().map(|model| (MODEL_FILE.to_owned(), model.to_toml())).into_iter().collect()
    }

    /// The setup that a recording holds; `file` is for messages.
    ///
    /// # Errors
    /// No setup, or none of this program (2).
    pub fn of_recorded(run: &RunMetadata, file: &str) -> Result<Self, Failure> {
        let RunMetadata { notes, files, .. } = run;
        let input = |what: String| Failure::new(Kind::Input, format!("{file}: note {SETUP_NOTE:?}: {what}"));
        let text = notes.get(SETUP_NOTE).ok_or_else(|| {
            input("expected the setup of the run, got none; only recordings of `bench run` and of campaigns can be replayed".to_owned())
        })?;
        let written: Written = toml::from_str(text).map_err(|e| input(e.message().to_owned()))?;
        let seed =
            written.seed.parse().map_err(|_| input(format!("expected a whole number, got {:?}", written.seed)))?;
        let hands = match written.operator.as_deref() {
            None => Hands::Rig,
            Some(word) if word == Hands::People.as_str() => Hands::People,
            Some(word) => return Err(input(format!("operator: expected \"people\" or nothing, got {word:?}"))),
        };
        let limits = written.limits.over(Limits::default());
        let limits = Limits { safe_state: written.safe_state.over(SafeState::default()), ..limits };
        let model = files.get(MODEL_FILE).or_else(|| notes.get(MODEL_NOTE));
        let model = model.map(|text| ModelFile::parse(text, &format!("{file}: {MODEL_FILE}")));
        let knowledge = match (model.transpose().map_err(|e| Failure::of(Kind::Input, &e))?, written.controller) {
            (Some(model), Some(settings)) => Knowledge::Model(model, settings),
            (Some(model), None) => Knowledge::Pump(model),
            (None, None) => Knowledge::Nothing,
            (None, Some(_)) => return Err(input(format!("expected the file {MODEL_FILE:?} too, got none"))),
        };
        Ok(Setup { seed, u_max_v: written.u_max_v, limits, knowledge, hands })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Parameters;
    use recordings::{Plane, Protocol, Role};

    fn unknown() -> RunMetadata {
        RunMetadata::new("a", Protocol::SquareWave, Role::Validate, Plane::Horizontal)
    }

    #[test]
    fn what_a_recording_notes_is_read_back_bit_for_bit() {
        let limits = Limits {
            velocity_max_deg_s: 1000.0 / 3.0,
            safe_state: SafeState { brake_open: true, bypass_open: false },
            ..Limits::default()
        };
        let model = ModelFile::plain(Parameters::example());
        let loops = LoopSettings { angle_bandwidth_hz: 1.0 / 3.0, ..LoopSettings::default() };
        for knowledge in [Knowledge::Nothing, Knowledge::Pump(model.clone()), Knowledge::Model(model, loops)] {
            let setup = Setup::of(u64::MAX, 24.0 / 7.0, &limits, &knowledge);
            let (notes, files) = (setup.notes(), setup.files());
            let run = RunMetadata { notes: notes.clone(), files: files.clone(), ..unknown() };
            assert_eq!(Setup::of_recorded(&run, "a.mcap").as_ref(), Ok(&setup));
            let note = files.get(MODEL_FILE).map(|model| (MODEL_NOTE.to_owned(), model.clone()));
            let first = RunMetadata { notes: notes.into_iter().chain(note).collect(), ..unknown() };
            assert_eq!(Setup::of_recorded(&first, "a.mcap"), Ok(setup), "as the first recordings held it");
        }
    }

    #[test]
    fn a_recording_without_setup_says_so() {
        let failure = Setup::of_recorded(&unknown(), "a.mcap").expect_err("nothing is noted");
        assert_eq!(failure.exit_code(), 2);
        assert!(failure.message.contains("a.mcap"), "{failure}");
    }
}
