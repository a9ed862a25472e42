//! What a stretch's past has left in the states of the effects: at the chambers where the lever is led, in motor and line on the pump's bench.

use model::effects::EffectSet;
use model::integrate::{Seeds, Sensitivity};
use model::port::PortKind;
use model::rec::{self, state};

use super::imposed::impose_sensitivity;
use super::{Run, start_sensitivity};
use crate::prepare::{Stand, Stretch};

impl Run<'_> {
    /// Puts the states of the effects where the stretch's past has left them; where that is not known, or the model can't follow it, they stay at rest.
    pub(super) fn remember(&mut self) {
        let (effects, k) = (self.effects, self.k);
        let Some(past) = known(self.stretch, effects) else { return };
        let mut before = Run::start(past, k, effects, &[0.0; 3]);
        let mut on = |i: usize| {
            before.settle_sensors(i);
            before.impose(i, Some(i + 1));
            before.advance(i, i + 1)
        };
        if (0..past.rows() - 1).try_for_each(&mut on).is_ok() {
            for own in remembering(past, effects) {
                self.x[own] = before.x[own];
            }
        }
    }

    /// On the pump's bench pressures jump from point to point, and sensors that are slow are taken to show the new one at once: what motor and line have kept
    /// is all that a past is asked for there.
    fn settle_sensors(&mut self, i: usize) {
        if self.stretch.stand != Stand::Bench || self.effects.in_sensors(true).next().is_none() {
            return;
        }
        let mut settled = self.x.clone();
        settled[state::PRESSURE1] = self.stretch.pressure_bar[0][i];
        settled[state::PRESSURE2] = self.stretch.pressure_bar[1][i];
        rec::rest_states(&self.stretch.input_before(), self.k, self.effects, &mut settled);
        for own in self.effects.in_sensors(true) {
            self.x[own.clone()].copy_from_slice(&settled[own]);
        }
    }
}

/// Derivatives of what [`Run::remember`] put into the state.
pub(super) fn remember_sensitivity(run: &Run, seeds: &Seeds, s: &mut Sensitivity, columns: usize) {
    let Some(past) = known(run.stretch, run.effects) else { return };
    let mut before = Run::start(past, run.k, run.effects, &[0.0; 3]);
    let mut told = Sensitivity::new(before.x.len(), s.row(0).len());
    start_sensitivity(past, &before, seeds, &mut told, columns);
    let shifted = run.effects.touches(PortKind::Sensor);
    for i in 0..past.rows() - 1 {
        before.settle_sensors(i);
        before.impose(i, Some(i + 1));
        if shifted {
            impose_sensitivity(past, &before, seeds, &mut told, i, Some(i + 1));
        }
        if before.advance_with(i, i + 1, |input, t, dt, middle| told.advance(seeds, input, t, dt, middle)).is_err() {
            return;
        }
    }
    for i in remembering(past, run.effects) {
        for column in 0..told.row(i).len() {
            // the stretch's own initial values come after its past
            s.set(i, column, if column < columns { told.get(i, column) } else { 0.0 });
        }
    }
}

/// The past of a stretch, where it is known and something remembers it.
fn known<'a>(stretch: &'a Stretch, effects: &EffectSet<f64>) -> Option<&'a Stretch> {
    stretch.past.as_deref().filter(|past| past.rows() > 1 && !remembering(past, effects).is_empty())
}

/// Places of the states that a past says something of.
fn remembering(past: &Stretch, effects: &EffectSet<f64>) -> Vec<usize> {
    match past.stand {
        Stand::Bench => effects.in_sensors(false).flatten().collect(),
        _ => effects.at_chambers().flatten().collect(),
    }
}
