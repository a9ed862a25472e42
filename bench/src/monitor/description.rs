//! What the service says of its run before its first sample: name, steps in words, limits.

use crate::setup::Setup;
use profiles::{Context, OutlineRow, Playback, Script};
use recordings::{Plane, Protocol, Role, RunMetadata};
use rt_core::{Limits, OverrunPolicy};

/// What a run is. Parts that can't be had are left out: a monitor shows what there is.
pub struct Description {
    /// Name of the run.
    pub name: String,
    /// Which experiment it is.
    pub protocol: Protocol,
    /// What it is recorded for.
    pub role: Role,
    /// The plane in which the lever moves.
    pub plane: Plane,
    /// What the supervisor enforces.
    pub limits: Option<Limits>,
    /// What follows a missed deadline.
    pub overrun: Option<OverrunPolicy>,
    steps: Option<(Box<Playback>, Vec<OutlineRow>)>,
}

impl Description {
    /// Of what was announced.
    pub fn of(run: &RunMetadata) -> Description {
        let setup = Setup::of_recorded(run, &run.name).ok();
        let script = Script::parse(&run.profile, &run.name).ok();
        let compiled = setup.as_ref().zip(script.as_ref()).and_then(|(setup, script)| {
            let context = Context { u_max_v: setup.u_max_v, seed: setup.seed, hands: setup.hands };
            Some((Box::new(script.compile(&context).ok()?), script.outline()))
        });
        Description {
            name: run.name.clone(),
            protocol: run.protocol,
            role: run.role,
            plane: run.plane,
            limits: setup.map(|setup| setup.limits),
            overrun: script.map(|script| script.overrun),
            steps: compiled,
        }
    }

    /// What the profile does in this unrolled step, in words.
    pub fn step(&self, step: u32) -> Option<String> {
        let (playback, outline) = self.steps.as_ref()?;
        let place = playback.place(step)?;
        let row = outline.iter().find(|row| row.line == place.line)?;
        let mut text = row.what.clone();
        for part in [&row.ends, &row.operator, &place.with] {
            if !part.is_empty() {
                text.push_str(", ");
                text.push_str(part);
            }
        }
        Some(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::Knowledge;

    const PROFILE: &str = "name = \"short\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\noverrun = \"abort\"\n\
        [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
        [[step]]\nrepeat = 2\n[[step.step]]\nvoltage_v = 6.0\nfor_s = 0.5\n[[step.step]]\nvoltage_v = -6.0\nfor_s = 0.5\n";

    fn announced(profile: &str) -> RunMetadata {
        let limits = Limits { pressure_max_bar: 6.5, ..Limits::default() };
        let setup = Setup::of(1, 24.0, &limits, &Knowledge::Nothing);
        RunMetadata {
            profile: profile.to_owned(),
            notes: setup.notes(),
            ..RunMetadata::new("short", Protocol::SquareWave, Role::Validate, Plane::Horizontal)
        }
    }

    #[test]
    fn steps_are_told_in_words_with_their_pass_and_the_limits_are_those_in_force() {
        let description = Description::of(&announced(PROFILE));
        let third = description.step(2).expect("two passes of two steps");
        assert!(third.contains('6') && third.contains("0.5") && third.contains("pass 2 of 2"), "{third}");
        assert!(description.step(3).expect("the last").contains("-6"));
        assert_eq!(description.step(4), None);
        assert_eq!(description.limits.map(|limits| limits.pressure_max_bar), Some(6.5));
        assert_eq!(description.overrun, Some(OverrunPolicy::Abort));
    }

    #[test]
    fn what_can_not_be_read_is_left_out() {
        let mut run = announced("no profile at all");
        run.notes.clear();
        let description = Description::of(&run);
        assert_eq!((description.name.as_str(), description.limits, description.step(0)), ("short", None, None));
    }
}
