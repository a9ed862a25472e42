//! Fixed-step integration with kinks located.
//!
//! The equations are piecewise smooth: losses at |w| = a, the pump's dead zone, |dp| in the torque. A Runge-Kutta step over
//! such a kink would lose its order, so a step that ends on another branch is split where the branch changes.

use crate::effects::EffectSet;
use crate::near::Near;
use crate::parameters::index::A;
use crate::rec::{Input, STATES, state};
use crate::scalar::Scalar;
use crate::step::{At, Plant, between};

pub use crate::seeds::Seeds;
pub use crate::sensitivity::Sensitivity;

/// Most states that plant and effects may have together.
pub const MOST_STATES: usize = 16;
/// States of the plant with an effect or two.
pub(crate) const FEW_STATES: usize = 8;

/// What an integration could not do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// A pressure fell to zero, where the model ends.
    #[error(
        "at {time_s:.3} s: pressure {chamber} fell to {pressure_bar:.3} bar absolute; the model holds for positive pressures only (fill the chambers more, or drive less)"
    )]
    Pressure {
        /// Since the run's start, s.
        time_s: f64,
        /// 1 or 2.
        chamber: u8,
        /// bar absolute
        pressure_bar: f64,
    },
    /// A state is not finite.
    #[error(
        "at {time_s:.3} s: the state is not finite any more: the parameters are outside of what the model can represent"
    )]
    NotFinite {
        /// Since the run's start, s.
        time_s: f64,
    },
    /// Plant and effects have more states than can be integrated.
    #[error(
        "expected at most {MOST_STATES} states of the plant and its effects together, got {states}; declare fewer effects, or a simpler form of one"
    )]
    States {
        /// How many there are.
        states: usize,
    },
    /// One of the others, in a run that has a name.
    #[error("{file}: {error}")]
    InRun {
        /// The run's file.
        file: String,
        /// What it could not do there.
        error: Box<SimulationError>,
    },
}

impl SimulationError {
    /// The same, with the run's file named where it has one.
    pub fn in_run(self, file: &str) -> Self {
        if file.is_empty() { self } else { SimulationError::InRun { file: file.to_owned(), error: Box::new(self) } }
    }
}

/// Whether so many states of plant and effects can be integrated.
///
/// # Errors
/// There are more than [`MOST_STATES`].
pub fn have_room(states: usize) -> Result<(), SimulationError> {
    if states <= MOST_STATES { Ok(()) } else { Err(SimulationError::States { states }) }
}

/// Integrates the plant for values.
pub struct Integrator {
    /// Longest inner step, s.
    longest_s: f64,
    /// The same where the lever creeps, s: see [`Integrator::resolving_creep`].
    creeping_s: f64,
    /// The same where it slides on, s: see [`Integrator::gliding_up_to`].
    gliding_s: f64,
}

/// What the integration of one plant remembers from one step to the next, so that a step that goes on where the last one
/// ended, under the same input, need not begin anew. It belongs to one set of parameters and effects.
pub struct Trail {
    near: Near,
    /// Input, time, state, derivative and branches of the last step's end.
    end: Option<(Input, At<MOST_STATES>)>,
}

impl Trail {
    /// Nothing yet, for a plant with parameters `k`.
    pub fn new(k: &[f64]) -> Self {
        Trail { near: Near::new(k), end: None }
    }
}

/// Step of a slope that is taken 1 away from a state.
const FAR_STEP: f64 = 1e-5;
/// Velocities beyond the losses' threshold (times that) at which time constants are looked for: of an elastic friction they fall with it.
const SLIDING: [f64; 3] = [2.0, 10.0, 100.0];
/// Most splits of one inner step at kinks; beyond, the step is taken as it is.
const MOST_SPLITS: usize = 6;

impl Integrator {
    /// Inner steps of at most `longest_s` seconds.
    pub fn new(longest_s: f64) -> Self {
        Integrator { longest_s, creeping_s: longest_s, gliding_s: longest_s }
    }

    /// Inner steps of at most `longest_s`, shorter where the plant near `x` is stiffer than such a step can follow:
    /// near zero velocity the losses have a time constant of 1..2 ms, and effects may add to that. `inputs`: one
    /// for each stand of the valves that will occur.
    pub fn for_plant(longest_s: f64, k: &[f64], effects: &EffectSet<f64>, inputs: &[Input], x: &[f64]) -> Self {
        // a Runge-Kutta step is stable up to 2.8 time constants and accurate to 1e-3 of a decay at 1
        let each = inputs.iter().map(|i| Self::within_time_constant(longest_s, 1.0, k, effects, i, x).longest_s);
        Integrator::new(each.fold(longest_s, f64::min))
    }

    /// Inner steps of at most `longest_s` and of at most `share` of the shortest time constant near `x`, but of a tenth of
    /// `longest_s` at least: the work of a step is bounded.
    pub fn within_time_constant(
        longest_s: f64,
        share: f64,
        k: &[f64],
        effects: &EffectSet<f64>,
        input: &Input,
        x: &[f64],
    ) -> Self {
        let rate = fastest_rate(k, effects, input, x, 0.0);
        let h = if rate > 0.0 { longest_s.min(share / rate) } else { longest_s };
        Integrator::new(h.max(longest_s / 10.0))
    }

    /// With a quarter of the step while the lever moves slower than the losses' threshold, unless its velocity stays as it is: there a step of 1 ms is
    /// half of the losses' time constant, and nearly all of the error comes from what dies out.
    pub fn resolving_creep(self) -> Self {
        Integrator { creeping_s: 0.25 * self.longest_s, ..self }
    }

    /// With steps of up to `longest_s` while the lever slides on as it does: faster than the losses' threshold their time constant is ten times longer, and where
    /// the velocity hardly changes nothing else dies out either. Of at most the shortest time constant that there is at any such velocity near `x`.
    pub fn gliding_up_to(
        self,
        longest_s: f64,
        k: &[f64],
        effects: &EffectSet<f64>,
        inputs: &[Input],
        x: &[f64],
    ) -> Self {
        let each = inputs.iter().flat_map(|input| {
            SLIDING.iter().flat_map(|v| [*v, -v]).map(|v| fastest_rate(k, effects, input, x, v * k[A]))
        });
        let rate = each.fold(0.0, f64::max);
        let gliding_s = if rate > 0.0 { longest_s.min(1.0 / rate) } else { longest_s };
        Integrator { gliding_s: gliding_s.max(self.longest_s), ..self }
    }

    /// Length of the longest inner step, s.
    pub fn longest_s(&self) -> f64 {
        self.longest_s
    }

    /// Advances `x` from `t` by `dt` (s) under a constant input.
    pub fn advance(
        &self,
        input: &Input,
        k: &[f64],
        effects: &EffectSet<f64>,
        t: f64,
        dt: f64,
        x: &mut [f64],
    ) -> Result<(), SimulationError> {
        self.advance_by_pieces(input, k, effects, t, dt, x, |_, _, _| ())
    }

    /// As [`Self::advance`], and says `piece(middle's time, length, state in the middle)` (s) for each smooth piece, from
    /// kink to kink: what [`Sensitivity::advance`] needs.
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "the arguments of advance and a visitor")]
    pub fn advance_by_pieces(
        &self,
        input: &Input,
        k: &[f64],
        effects: &EffectSet<f64>,
        t: f64,
        dt: f64,
        x: &mut [f64],
        piece: impl FnMut(f64, f64, &[f64]),
    ) -> Result<(), SimulationError> {
        let near = &mut Near::new(k);
        // few lanes for the plants that one meets, enough for all
        if x.len() <= FEW_STATES {
            let mut plant = Plant::<FEW_STATES>::new(near, input, k, effects, x.len());
            let start = plant.at(t, Plant::lanes(x));
            self.pieces(&mut plant, start, dt, x, piece).map(|_| ())
        } else {
            let mut plant = Plant::<MOST_STATES>::new(near, input, k, effects, x.len());
            let start = plant.at(t, Plant::lanes(x));
            self.pieces(&mut plant, start, dt, x, piece).map(|_| ())
        }
    }

    /// As [`Self::advance`], from where `trail` ends if that is `x` at `t`.
    #[allow(clippy::too_many_arguments, reason = "the arguments of advance and the trail")]
    pub fn advance_along(
        &self,
        trail: &mut Trail,
        input: &Input,
        k: &[f64],
        effects: &EffectSet<f64>,
        t: f64,
        dt: f64,
        x: &mut [f64],
    ) -> Result<(), SimulationError> {
        if x.len() <= FEW_STATES {
            self.along::<FEW_STATES>(trail, input, k, effects, t, dt, x)
        } else {
            self.along::<MOST_STATES>(trail, input, k, effects, t, dt, x)
        }
    }

    #[allow(clippy::too_many_arguments, reason = "the arguments of advance and the trail")]
    fn along<const N: usize>(
        &self,
        trail: &mut Trail,
        input: &Input,
        k: &[f64],
        effects: &EffectSet<f64>,
        t: f64,
        dt: f64,
        x: &mut [f64],
    ) -> Result<(), SimulationError> {
        let states = x.len();
        let mut plant = Plant::<N>::new(&mut trail.near, input, k, effects, states);
        let start = match &trail.end {
            Some((of, end)) if of == input && end.x[..states] == *x && (end.t - t).abs() < 1e-9 => {
                At { t, x: Plant::lanes(x), dx: Plant::lanes(&end.dx[..states]), branches: end.branches }
            }
            _ => plant.at(t, Plant::lanes(x)),
        };
        trail.end = None;
        let At { t, x, dx, branches } = self.pieces(&mut plant, start, dt, x, |_, _, _| ())?;
        trail.end = Some((*input, At { t, x: Plant::lanes(&x), dx: Plant::lanes(&dx), branches }));
        Ok(())
    }

    /// From `now` on; says where it ended, which is also put into `x`.
    #[inline(always)]
    fn pieces<const N: usize>(
        &self,
        plant: &mut Plant<'_, N>,
        mut now: At<N>,
        dt: f64,
        x: &mut [f64],
        mut piece: impl FnMut(f64, f64, &[f64]),
    ) -> Result<At<N>, SimulationError> {
        let t = now.t;
        let steps = (dt / self.longest_s - 1e-9).ceil().max(1.0);
        let h = dt / steps;
        let (steps, at_once) = (steps as usize, (self.gliding_s / h + 1e-9) as usize);
        let mut i = 0;
        while i < steps {
            now.t = t + i as f64 * h;
            let ahead = at_once.min(steps - i);
            if ahead > 1 {
                let length = ahead as f64 * h;
                if let Some(next) = plant.glide(&now, length) {
                    piece(now.t + 0.5 * length, length, &between(&now, &next, length, 0.5)[..x.len()]);
                    now = next;
                    i += ahead;
                    continue;
                }
            }
            let mut left = h;
            let mut splits = 0;
            loop {
                let reach = if plant.creeps(&now, left) { left.min(self.creeping_s) } else { left };
                let (length, next) = if splits < MOST_SPLITS {
                    plant.smooth_piece(&now, reach)
                } else {
                    (reach, plant.step(&now, reach))
                };
                splits += usize::from(length < reach);
                // the slope of a piece's end may be that beyond a kink, by a hair
                piece(now.t + 0.5 * length, length, &between(&now, &next, length, 0.5)[..x.len()]);
                now = next;
                left -= length;
                if left < 1e-9 * h {
                    break;
                }
            }
            i += 1;
        }
        x.copy_from_slice(&now.x[..x.len()]);
        check(t + dt, x)?;
        Ok(now)
    }
}

/// The largest rate at which a state near `x`, at this velocity (rad/s), goes back by itself, 1/s; 0 where none does.
fn fastest_rate(k: &[f64], effects: &EffectSet<f64>, input: &Input, x: &[f64], velocity: f64) -> f64 {
    let mut near = Near::new(k);
    let mut plant = Plant::<MOST_STATES>::new(&mut near, input, k, effects, x.len());
    let mut at = Plant::lanes(x);
    at[state::VELOCITY] = velocity;
    let mut derivative = |i: usize, x: &[f64; MOST_STATES], dx: &mut [f64; MOST_STATES]| {
        *dx = [0.0; MOST_STATES];
        plant.derivative(0.0, x, dx);
        dx[i]
    };
    let (mut base, mut slope) = ([0.0; MOST_STATES], [0.0; MOST_STATES]);
    derivative(0, &at, &mut base);
    let mut rate: f64 = 0.0;
    for i in 0..x.len() {
        let mut moved = at;
        let step = 1e-5 * (1.0 + at[i].abs());
        moved[i] += step;
        rate = rate.max(-(derivative(i, &moved, &mut slope) - base[i]) / step);
    }
    // a play that is not in contact near `x` will be elsewhere: the slopes of the effects' own states far to both sides
    for (i, side) in (STATES..x.len()).flat_map(|i| [(i, -1.0), (i, 1.0)]) {
        let mut far = at;
        far[i] += side;
        let there = derivative(i, &far, &mut slope);
        far[i] += FAR_STEP;
        rate = rate.max(-(derivative(i, &far, &mut slope) - there) / FAR_STEP);
    }
    rate
}

/// The state is one that the model can stand in.
fn check(time_s: f64, x: &[f64]) -> Result<(), SimulationError> {
    if x.iter().any(|v| !v.is_finite()) {
        return Err(SimulationError::NotFinite { time_s });
    }
    for (chamber, i) in [(1, state::PRESSURE1), (2, state::PRESSURE2)] {
        if x[i] <= LEAST_PRESSURE_BAR {
            return Err(SimulationError::Pressure { time_s, chamber, pressure_bar: x[i] });
        }
    }
    Ok(())
}

/// Below this absolute pressure (bar) oil cavitates and eq. (13) means nothing.
pub const LEAST_PRESSURE_BAR: f64 = 0.02;

/// Number of states of the plant with these effects.
pub fn states_with<S: Scalar>(effects: &EffectSet<S>) -> usize {
    STATES + effects.states
}
