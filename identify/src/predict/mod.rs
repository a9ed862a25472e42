//! What a model of the REC rig says about a stretch: free run from its initial state, with the recorded inputs.

mod blocks;
mod imposed;
mod past;

use blocks::{Means, stops};
use imposed::{CLOSE, STEPS, Secant, impose_sensitivity};
use model::effects::EffectSet;
use model::integrate::{Integrator, Seeds, Sensitivity, SimulationError, Trail, have_room};
use model::port::PortKind;
use model::rec::{self, Input, Lever, STATES, state};
use model::scalar::{Scalar, Tangent};
use past::remember_sensitivity;

use crate::guide::Pull;
use crate::layout::Layout;
use crate::prepare::{Channel, Stand, Stretch};

/// Corrections of a stretch's initial values; on the REC rig angle (rad), pressures (bar).
pub type Initial = Vec<f64>;

/// Predictions at a stretch's targets with their derivatives.
pub struct Linear {
    /// One a target.
    pub predicted: Vec<f64>,
    /// Row-major, one row a target: a column for each entry of the parameter vector, then one for each initial value.
    pub slope: Vec<f64>,
}

const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// Longest step where the lever moves freely, s.
const STEP_FREE_S: f64 = 1e-3;
/// The same where it slides on: from stop to stop of a block that is settled.
const STEP_GLIDING_S: f64 = 5e-3;
/// Longest step where it is led, s.
const STEP_LED_S: f64 = 1e-2;
/// Longest step where it is clamped, or where the pressures are known as well, s, unless something there is faster than a step where it is led.
const STEP_CLAMPED_S: f64 = 1e-1;

/// One simulation of a stretch: the state, and what the sensors' effects shift the inputs by.
struct Run<'a> {
    stretch: &'a Stretch,
    k: &'a [f64],
    effects: &'a EffectSet<f64>,
    integrator: Integrator,
    trail: Trail,
    x: Vec<f64>,
    scratch: Vec<f64>,
    /// Shown minus true angle, rad.
    shift_rad: f64,
    /// The lever is led, and the angle that is known is what a sensor with errors shows.
    carried: bool,
}

impl<'a> Run<'a> {
    fn start(stretch: &'a Stretch, k: &'a [f64], effects: &'a EffectSet<f64>, initial: &[f64]) -> Self {
        let states = STATES + effects.states;
        let mut x = vec![0.0; states];
        let mut scratch = vec![0.0; states];
        let input = stretch.input_before();
        let shown = [0, 1, 2].map(|j| stretch.initial[j] + initial[j]);
        x[state::ANGLE] = shown[0];
        x[state::PRESSURE1] = shown[1];
        x[state::PRESSURE2] = shown[2];
        rec::rest_states_after(stretch.before(), &input, k, effects, &mut x);
        let mut shift_rad = 0.0;
        if effects.touches(PortKind::Sensor) {
            let mut ways = [Secant::default(); 3];
            for _ in 0..STEPS {
                let seen = rec::shown(effects, stretch.time_s[0], &x, &mut scratch);
                let off = [seen[0] / DEGREES - shown[0], seen[1] - shown[1], seen[2] - shown[2]];
                for (n, i) in [state::ANGLE, state::PRESSURE1, state::PRESSURE2].into_iter().enumerate() {
                    x[i] = ways[n].next(x[i], off[n]);
                }
                rec::rest_states_after(stretch.before(), &input, k, effects, &mut x);
                if off.iter().all(|v| v.abs() < CLOSE) {
                    break;
                }
            }
            shift_rad = shown[0] - x[state::ANGLE];
        }
        let driven = stands(stretch, &stretch.input(0, 1.0));
        let within = |longest_s: f64| Integrator::for_plant(longest_s, k, effects, &driven, &x);
        let integrator = match stretch.stand {
            Stand::Free => within(STEP_FREE_S).resolving_creep().gliding_up_to(STEP_GLIDING_S, k, effects, &driven, &x),
            Stand::Led | Stand::Drained if within(STEP_LED_S).longest_s() >= STEP_LED_S => within(STEP_CLAMPED_S),
            _ => within(STEP_LED_S),
        };
        let trail = Trail::new(k);
        let led = !stretch.angle_rad.is_empty() && stretch.stand != Stand::Bench;
        let carried = led && effects.touches(PortKind::Sensor);
        let mut run = Run { stretch, k, effects, integrator, trail, x, scratch, shift_rad, carried };
        run.remember();
        run
    }

    /// The input that leads from row `i` to a later one.
    fn input(&self, i: usize, to: usize) -> Input {
        let input = self.stretch.input_to(i, to);
        if self.carried { Input { lever: Lever::Carried, ..input } } else { input }
    }

    /// From one row to a later one, s.
    fn length(&self, i: usize, to: usize) -> f64 {
        self.stretch.time_s[to] - self.stretch.time_s[i]
    }

    /// Advances from row `i` to row `to`, between which nothing but the state changes.
    fn advance(&mut self, i: usize, to: usize) -> Result<(), SimulationError> {
        let dt = self.length(i, to);
        let (input, t) = (self.input(i, to), self.stretch.time_s[i]);
        self.integrator.advance_along(&mut self.trail, &input, self.k, self.effects, t, dt, &mut self.x)
    }

    /// The same; `piece(input, middle's time, length, state in the middle)` for each smooth piece.
    #[inline(always)]
    fn advance_with(
        &mut self,
        i: usize,
        to: usize,
        mut piece: impl FnMut(&Input, f64, f64, &[f64]),
    ) -> Result<(), SimulationError> {
        let dt = self.length(i, to);
        let input = self.input(i, to);
        let t = self.stretch.time_s[i];
        let (k, effects) = (self.k, self.effects);
        self.integrator.advance_by_pieces(&input, k, effects, t, dt, &mut self.x, |t, dt, x| piece(&input, t, dt, x))
    }

    /// Angle (deg), pressures (bar), torque (Nm), volume (ml) as the sensors would show them at row `i`.
    fn outputs(&mut self, i: usize) -> [f64; 5] {
        let s = self.stretch;
        let seen = if self.effects.touches(PortKind::Sensor) {
            rec::shown(self.effects, s.time_s[i], &self.x, &mut self.scratch)
        } else {
            [self.x[state::ANGLE] * DEGREES, self.x[state::PRESSURE1], self.x[state::PRESSURE2]]
        };
        let torque = if s.measured[Channel::Torque.index()].is_empty() {
            f64::NAN
        } else {
            let input = self.standing_input(i);
            rec::derivative(&input, self.k, self.effects, s.time_s[i], &self.x, &mut self.scratch).torque_nm
        };
        [seen[0], seen[1], seen[2], torque, self.x[state::VOLUME]]
    }

    /// What is drawn towards what was measured at row `i`; nothing where the simulation runs free.
    fn pulls(&self, i: usize) -> impl Iterator<Item = Pull> + use<'a> {
        let (stretch, dt) = (self.stretch, self.length(i, i + 1));
        let all = stretch.guide.into_iter().flat_map(move |guide| guide.pulls(dt));
        all.filter(move |pull| stretch.measured[pull.channel.index()][i].is_finite())
    }

    /// Draws a guided state towards what was measured at row `i`, where `y` was predicted.
    fn follow(&mut self, i: usize, y: &[f64; 5]) {
        for Pull { channel, state, gain } in self.pulls(i) {
            self.x[state] += gain * (self.stretch.measured[channel.index()][i] - y[channel.index()]);
        }
    }

    fn standing_input(&self, i: usize) -> Input {
        let i = i.min(self.stretch.rows() - 2);
        self.input(i, i + 1)
    }
}

/// The input as it is, and with each other stand of the valves that occurs in the stretch.
fn stands(stretch: &Stretch, input: &Input) -> Vec<Input> {
    let mut out = vec![*input];
    for (&brake_open, &bypass_open) in stretch.brake_open.iter().zip(&stretch.bypass_open) {
        if !out.iter().any(|i| i.brake_open == brake_open && i.bypass_open == bypass_open) {
            out.push(Input { brake_open, bypass_open, ..*input });
        }
    }
    out
}

/// Predicted values at the stretch's targets.
pub fn predict(
    stretch: &Stretch,
    layout: &Layout,
    theta: &[f64],
    initial: &[f64],
) -> Result<Vec<f64>, SimulationError> {
    let (k, effects) = layout.expand(theta);
    have_room(STATES + effects.states)?;
    let mut run = Run::start(stretch, &k, &effects, initial);
    let mut means = Means::new();
    let mut out = Vec::with_capacity(stretch.targets.len());
    let stops = stops(stretch, effects.touches(PortKind::Sensor));
    for (n, stop) in stops.iter().enumerate() {
        let (i, next) = (stop.row, stops.get(n + 1).map(|next| next.row));
        run.impose(i, next);
        let y = run.outputs(i);
        means.add(stretch, stop, &y, &mut out);
        if let Some(next) = next {
            run.follow(i, &y);
            run.advance(i, next)?;
        }
    }
    Ok(out)
}

/// Predicted values at every row: angle (deg), pressures (bar), torque (Nm), volume (ml).
pub fn predict_rows(
    stretch: &Stretch,
    layout: &Layout,
    theta: &[f64],
    initial: &[f64],
) -> Result<Vec<[f64; 5]>, SimulationError> {
    let (k, effects) = layout.expand(theta);
    have_room(STATES + effects.states)?;
    let mut run = Run::start(stretch, &k, &effects, initial);
    let mut out = Vec::with_capacity(stretch.rows());
    for i in 0..stretch.rows() {
        let next = Some(i + 1).filter(|next| *next < stretch.rows());
        run.impose(i, next);
        let y = run.outputs(i);
        out.push(y);
        if let Some(next) = next {
            run.follow(i, &y);
            run.advance(i, next)?;
        }
    }
    Ok(out)
}

/// Predictions with their derivatives. The derivative of a block's mean is taken at the block's middle row.
pub fn linearise(
    stretch: &Stretch,
    layout: &Layout,
    theta: &[f64],
    initial: &[f64],
) -> Result<Linear, SimulationError> {
    let (k, effects) = layout.expand(theta);
    let columns = layout.len();
    let all = columns + 3;
    let states = STATES + effects.states;
    have_room(states)?;
    let seeds = Seeds::new(states, columns, |lane| {
        let dual: Vec<Tangent> = theta
            .iter()
            .enumerate()
            .map(|(c, v)| lane(c).map_or(Tangent::constant(*v), |l| Tangent::variable(*v, l)))
            .collect();
        layout.expand(&dual)
    });
    let mut run = Run::start(stretch, &k, &effects, initial);
    let mut s = Sensitivity::new(states, all);
    start_sensitivity(stretch, &run, &seeds, &mut s, columns);
    remember_sensitivity(&run, &seeds, &mut s, columns);

    let mut means = Means::new();
    let mut predicted = Vec::with_capacity(stretch.targets.len());
    let mut slope = vec![0.0; stretch.targets.len() * all];
    let mut next_target = 0;
    let shifted = effects.touches(PortKind::Sensor);
    let stops = stops(stretch, shifted);
    for (n, stop) in stops.iter().enumerate() {
        let (i, next) = (stop.row, stops.get(n + 1).map(|next| next.row));
        run.impose(i, next);
        if shifted {
            impose_sensitivity(stretch, &run, &seeds, &mut s, i, next);
        }
        let y = run.outputs(i);
        means.add(stretch, stop, &y, &mut predicted);
        // targets are ordered by block; within a block their middle rows may differ
        let open = stretch.targets[next_target..].iter().take(5).enumerate();
        for (n, target) in open.filter(|(_, t)| t.middle == i).map(|(n, t)| (next_target + n, t)) {
            output_slope(stretch, &run, &seeds, &s, i, target.channel, &mut slope[n * all..(n + 1) * all]);
        }
        while next_target < predicted.len() {
            next_target += 1;
        }
        if let Some(next) = next {
            follow_sensitivity(stretch, &run, &seeds, &mut s, i);
            run.follow(i, &y);
            run.advance_with(i, next, |input, t, dt, middle| s.advance(&seeds, input, t, dt, middle))?;
        }
    }
    Ok(Linear { predicted, slope })
}

/// Derivatives of the initial state: of what the sensors' effects shift, of the initial values, of the effects' states.
fn start_sensitivity(stretch: &Stretch, run: &Run, seeds: &Seeds, s: &mut Sensitivity, columns: usize) {
    let states = run.x.len();
    for (j, i) in [state::ANGLE, state::PRESSURE1, state::PRESSURE2].into_iter().enumerate() {
        s.set(i, columns + j, 1.0);
    }
    let input = stretch.input_before();
    seeds.each_pass(|k, effects, first, count| {
        let mut x: Vec<Tangent> = run.x.iter().enumerate().map(|(i, v)| Tangent::variable(*v, i)).collect();
        if effects.touches(PortKind::Sensor) {
            // the effects' own states follow the plant at rest, so a slow sensor shifts nothing
            rec::rest_states_after(stretch.before(), &input, k, effects, &mut x);
            let mut scratch = vec![Tangent::zero(); states];
            let mut seen = rec::shown(effects, stretch.time_s[0], &x, &mut scratch);
            seen[0] = seen[0] / DEGREES;
            for (j, i) in [state::ANGLE, state::PRESSURE1, state::PRESSURE2].into_iter().enumerate() {
                let by_true = seen[j].slope[i];
                s.set(i, columns + j, 1.0 / by_true);
                (0..count).for_each(|c| s.set(i, first + c, -seen[j].slope[states + c] / by_true));
            }
        }
    });
    seeds.each_pass(|k, effects, first, count| {
        if effects.states == 0 {
            return;
        }
        let mut x: Vec<Tangent> = run.x.iter().enumerate().map(|(i, v)| Tangent::variable(*v, i)).collect();
        rec::rest_states_after(stretch.before(), &input, k, effects, &mut x);
        for i in STATES..states {
            for c in 0..count {
                s.set(i, first + c, x[i].slope[states + c]);
            }
            let through: Vec<f64> =
                (0..s.row(0).len()).map(|c| (0..STATES).map(|j| x[i].slope[j] * s.get(j, c)).sum()).collect();
            for (c, value) in through.iter().enumerate() {
                let seeded = (first..first + count).contains(&c);
                if seeded || (first == 0 && c >= columns) {
                    s.set(i, c, if seeded { s.get(i, c) } else { 0.0 } + value);
                }
            }
        }
    });
}

/// Derivatives of a guided state behind row `i`.
fn follow_sensitivity(stretch: &Stretch, run: &Run, seeds: &Seeds, s: &mut Sensitivity, i: usize) {
    let slopes: Vec<(Pull, Vec<f64>)> = run
        .pulls(i)
        .map(|pull| {
            let mut slope = vec![0.0; s.row(0).len()];
            output_slope(stretch, run, seeds, s, i, pull.channel, &mut slope);
            (pull, slope)
        })
        .collect();
    for (Pull { state, gain, .. }, slope) in slopes {
        for (column, slope) in slope.iter().enumerate() {
            s.set(state, column, s.get(state, column) - gain * slope);
        }
    }
}

/// Derivative of one output at row `i`.
fn output_slope(
    stretch: &Stretch,
    run: &Run,
    seeds: &Seeds,
    s: &Sensitivity,
    i: usize,
    channel: Channel,
    out: &mut [f64],
) {
    let plain = |row: usize, factor: f64, out: &mut [f64]| {
        for (o, v) in out.iter_mut().zip(s.row(row)) {
            *o = v * factor;
        }
    };
    let sensed = run.effects.touches(PortKind::Sensor);
    match channel {
        Channel::Volume => plain(state::VOLUME, 1.0, out),
        Channel::Angle if !sensed => plain(state::ANGLE, DEGREES, out),
        Channel::Pressure1 if !sensed => plain(state::PRESSURE1, 1.0, out),
        Channel::Pressure2 if !sensed => plain(state::PRESSURE2, 1.0, out),
        _ => {
            let states = run.x.len();
            let input = run.standing_input(i);
            let mut through = vec![0.0; states];
            seeds.each_pass(|k, effects, first, count| {
                let x: Vec<Tangent> = run.x.iter().enumerate().map(|(j, v)| Tangent::variable(*v, j)).collect();
                let mut scratch = vec![Tangent::zero(); states];
                let y = if channel == Channel::Torque {
                    rec::derivative(&input, k, effects, stretch.time_s[i], &x, &mut scratch).torque_nm
                } else {
                    rec::shown(effects, stretch.time_s[i], &x, &mut scratch)[channel.index()]
                };
                through.copy_from_slice(&y.slope[..states]);
                out[first..first + count].copy_from_slice(&y.slope[states..states + count]);
            });
            for (j, f) in through.iter().enumerate() {
                if *f != 0.0 {
                    for (o, v) in out.iter_mut().zip(s.row(j)) {
                        *o += f * v;
                    }
                }
            }
        }
    }
}
