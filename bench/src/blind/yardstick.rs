//! How strong an effect is: the largest free-run error of a validation channel, in noise floors, that it causes once the base model is
//! refitted without it. What the base parameters can do as well is thus no part of it.

use super::rig::{Truth, shape};
use super::runs::Recorded;
use identify::fit::{Effort, Fit, fit};
use identify::identification::IdentifyError;
use identify::layout::Layout;
use identify::predict::{predict, predict_rows};
use identify::prepare::Channel;
use identify::problem::{Point, Problem};
use identify::validate::{Prepared, prepare_validation, simulate};
use model::effects::Effect;
use model::integrate::SimulationError;
use rayon::prelude::*;
use recordings::Role;

/// Channels that are scored.
const CHANNELS: [Channel; 3] = [Channel::Angle, Channel::Pressure1, Channel::Pressure2];

/// A campaign to measure on. It may be one without the effects: then what they would have done is computed.
pub(super) struct Yardstick<'a> {
    recorded: &'a Recorded,
    problem: Problem,
    validation: Vec<Prepared>,
    /// By validation run and channel of [`CHANNELS`]: RMS of the sensor's errors.
    floors: Vec<[f64; 3]>,
}

impl<'a> Yardstick<'a> {
    /// `brief_s`: runs with a free lever are fitted for so long.
    pub fn new(recorded: &'a Recorded, brief_s: f64) -> Result<Self, IdentifyError> {
        let problem = recorded.loaded.problem(Role::Identify)?.shortened(brief_s);
        let validation = prepare_validation(&recorded.loaded)?;
        let floors = validation.iter().map(|p| floors(recorded, p)).collect();
        Ok(Yardstick { recorded, problem, validation, floors })
    }

    /// Strength of the effect of this number among those of `truth`, with the others in the model, had they acted in this campaign.
    ///
    /// # Errors
    /// The plant with these effects can't be simulated.
    pub fn would_cause(&self, truth: &Truth, number: usize) -> Result<f64, SimulationError> {
        let (all, values) = layout_of(truth, |_| true);
        let (rest, start) = layout_of(truth, |n| n != number);
        let mut problem = self.problem.clone();
        for s in &mut problem.stretches {
            let shown = predict(s, &all, &values, &[0.0; 3])?;
            s.targets.iter_mut().zip(shown).for_each(|(t, y)| t.measured = y);
        }
        let effort = Effort { iterations: 4, tolerance: 1e-2, ..Effort::default() };
        let refitted = fit(&problem, &rest, problem.point(start), effort)?;
        let mut largest = 0.0f64;
        for (p, floors) in self.validation.iter().zip(&self.floors) {
            for s in &p.stretches {
                let with = predict_rows(s, &all, &values, &[0.0; 3])?;
                let without = predict_rows(s, &refitted.layout, &refitted.point.theta, &[0.0; 3])?;
                for (c, floor) in CHANNELS.iter().zip(floors) {
                    let c = c.index();
                    let sum: f64 = with.iter().zip(&without).map(|(a, b)| (a[c] - b[c]).powi(2)).sum();
                    largest = largest.max((sum / with.len() as f64).sqrt() / floor);
                }
            }
        }
        Ok(largest)
    }

    /// The model with these of the truth's effects, fitted to what was recorded from the true values on: as good as such a model can
    /// be.
    ///
    /// # Errors
    /// It can't be simulated.
    pub fn best_fit(&self, truth: &Truth, with: impl Fn(usize) -> bool) -> Result<Fit, SimulationError> {
        let (layout, start) = layout_of(truth, with);
        let effort = Effort { iterations: 12, tolerance: 1e-4, ..Effort::default() };
        let point: Point = self.problem.point(start);
        fit(&self.problem, &layout, point, effort)
    }

    /// Errors of a model's free runs of the validation, by run and channel.
    ///
    /// # Errors
    /// It can't be simulated.
    pub fn errors(&self, fit: &Fit) -> Result<Vec<ChannelError>, SimulationError> {
        let runs: Vec<Vec<ChannelError>> = self
            .validation
            .par_iter()
            .zip(&self.floors)
            .map(|(p, floors)| {
                let simulated = simulate(p, fit)?;
                let (clean, rows) = (&self.recorded.clean[p.run], &simulated.rows[0]);
                Ok(CHANNELS
                    .into_iter()
                    .enumerate()
                    .map(|(n, channel)| {
                        let sum: f64 = clean.iter().zip(rows).map(|(c, y)| (c[n] - y[channel.index()]).powi(2)).sum();
                        let rmse = simulated.scores.iter().find(|s| s.channel == channel).map_or(f64::NAN, |s| s.rmse);
                        ChannelError { caused: (sum / rows.len() as f64).sqrt() / floors[n], rmse: rmse / floors[n] }
                    })
                    .collect())
            })
            .collect::<Result<_, SimulationError>>()?;
        Ok(runs.into_iter().flatten().collect())
    }
}

/// A free-run error of one channel of one run, in noise floors.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChannelError {
    /// Against what perfect sensors show.
    pub caused: f64,
    /// Against what was recorded.
    pub rmse: f64,
}

/// The largest error against perfect sensors.
pub(super) fn largest(errors: &[ChannelError]) -> f64 {
    errors.iter().map(|e| e.caused).fold(0.0, f64::max)
}

/// Parameters of a model with some of the truth's effects, and where they are in the vector of a fit.
fn layout_of(truth: &Truth, with: impl Fn(usize) -> bool) -> (Layout, Vec<f64>) {
    let mut layout = Layout::base(&truth.parameters);
    let mut values = layout.vector_of(&truth.parameters);
    for (_, (effect, own)) in truth.effects.iter().enumerate().filter(|(n, _)| with(*n)) {
        layout.effects.push(*effect);
        values.extend_from_slice(own);
    }
    (layout, values)
}

fn floors(recorded: &Recorded, prepared: &Prepared) -> [f64; 3] {
    let recording = &recorded.loaded.runs[prepared.run].recording;
    let clean = &recorded.clean[prepared.run];
    std::array::from_fn(|n| {
        let sum: f64 = CHANNELS[n].of(recording).iter().zip(clean).map(|(m, c)| (m - c[n]).powi(2)).sum();
        (sum / clean.len() as f64).sqrt()
    })
}

/// Values at which an effect, beside the others of `truth`, shows about `wanted` noise floors. Where no usual shape can, the one that
/// comes nearest.
pub(super) fn sized(
    yardstick: &Yardstick<'_>,
    truth: &Truth,
    effect: &'static dyn Effect,
    (seed, case, number): (u64, usize, usize),
    wanted: f64,
) -> Vec<f64> {
    let mut best: Option<(f64, Vec<f64>)> = None;
    for turn in 0..3 {
        let mut values = shape(seed, case, number, turn, effect);
        for _ in 0..4 {
            let mut with = truth.clone();
            with.effects.push((effect, values.clone()));
            let shown = yardstick.would_cause(&with, with.effects.len() - 1).unwrap_or(f64::INFINITY).max(1e-6);
            let off = (shown / wanted).ln().abs();
            if best.as_ref().is_none_or(|(least, _)| off < *least) {
                best = Some((off, values.clone()));
            }
            let next = resized(truth, effect, &values, (wanted / shown).clamp(0.1, 10.0));
            if off < 0.12 || next == values {
                break;
            }
            values = next;
        }
        if best.as_ref().is_some_and(|(off, _)| *off < 0.2) {
            break;
        }
    }
    best.map_or_else(|| shape(seed, case, number, 0, effect), |(_, values)| values)
}

/// The part of gravity's torque that acts in a plane called horizontal: it leans by 30 degrees at most.
const LEANS: f64 = 0.5;

/// An effect's values with its sizes times `factor`, as far as there can be such a rig: however little a tilt shows, it acts with a part of gravity.
pub(super) fn resized(truth: &Truth, effect: &dyn Effect, values: &[f64], factor: f64) -> Vec<f64> {
    let header = effect.header();
    let amplitude = values.iter().map(|v| v * v).sum::<f64>().sqrt();
    let most = if header.id == "tilt" { LEANS * truth.parameters.load.G / amplitude } else { f64::INFINITY };
    header.scaled(values, factor.min(most))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::rig::{Rig, draw};
    use crate::blind::runs::record;

    #[test]
    fn strength_grows_with_the_size_and_is_not_what_the_base_can_do_itself() {
        let rig = Rig { length: 0.0, free_every: 4, bench_every: 4, ..draw(5, 0, 0) };
        let plain = Truth { parameters: rig.parameters, effects: Vec::new() };
        let recorded = record(&plain, &rig, 5, 0).expect("a rig that runs");
        let yardstick = Yardstick::new(&recorded, 12.0).expect("a campaign");
        let with = |id: &str, values: &[f64]| {
            let effect = model::effects::find(id).expect("an effect of the library");
            let mut truth = plain.clone();
            truth.effects.push((effect, values.to_vec()));
            yardstick.would_cause(&truth, 0).expect("a model that can be simulated")
        };
        let (none, small, large) = (with("pump_lag", &[0.0]), with("pump_lag", &[0.01]), with("pump_lag", &[0.02]));
        assert!(none < 0.05, "{none}");
        assert!(small > 0.5 && (1.5..2.5).contains(&(large / small)), "{small} {large}");
        // friction that hardly changes with velocity is what the base's own losses are: it is fitted away
        let absorbed = with("stribeck_friction", &[0.1, 3.0, 0.02]);
        let visible = with("stribeck_friction", &[0.1, 0.1, 0.02]);
        assert!(absorbed < 0.7 * visible, "{absorbed} {visible}");
    }

    #[test]
    fn a_plane_called_horizontal_leans_by_a_part_of_gravity() {
        let truth = Truth { parameters: draw(5, 0, 0).parameters, effects: Vec::new() };
        let of = |id: &str, values: &[f64], factor: f64| {
            resized(&truth, model::effects::find(id).expect("an effect of the library"), values, factor)
        };
        assert_eq!(of("tilt", &[0.1, 0.0], 2.0), [0.2, 0.0]);
        let most = of("tilt", &[0.3, 0.4], 100.0);
        assert!((most[0].hypot(most[1]) - 0.5 * truth.parameters.load.G).abs() < 1e-9, "{most:?}");
        assert!((most[1] / most[0] - 4.0 / 3.0).abs() < 1e-9, "it leans the same way");
        assert_eq!(of("angle_offset", &[0.01], 2.0), [0.02], "no other effect is a part of gravity");
    }
}
