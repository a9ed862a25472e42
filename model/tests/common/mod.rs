//! Runs of the reference model that several tests need.
#![allow(dead_code, reason = "each test binary takes what it needs")]

use model::effects::EffectSet;
use model::integrate::Integrator;
use model::rec::{Circuit, Input, Lever, STATES};

/// Half of the emulated rig's longest inner step, s.
pub const RIG_STEP_S: f64 = 0.25e-3;
/// Degrees in a radian.
pub const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// Rest in the middle of the range.
pub const MIDDLE: [f64; STATES] = [0.0, 0.0, 3.5, 3.5, 0.0];

/// Free lever in the horizontal plane on the pump, brake open.
pub fn input(voltage_v: f64) -> Input {
    Input {
        voltage_v,
        brake_open: true,
        bypass_open: false,
        vertical: false,
        lever: Lever::Free,
        circuit: Circuit::Pump,
    }
}

/// Square wave of 0.9 u_max with half periods of 6 s, the first one half as long: the lever swings about its middle.
pub fn square_wave(t: f64) -> f64 {
    if ((t + 3.0) / 6.0 + 1e-9).floor() as i64 % 2 == 0 { 21.6 } else { -21.6 }
}

/// States at every millisecond of `seconds`, the first one included.
pub fn run(
    step_s: f64,
    seconds: f64,
    k: &[f64],
    effects: &EffectSet<f64>,
    start: [f64; STATES],
    of: impl Fn(f64) -> Input,
) -> Vec<[f64; STATES]> {
    let integrator = Integrator::new(step_s);
    let mut x = start;
    let mut all = vec![x];
    for i in 0..(seconds * 1e3).round() as usize {
        let t = i as f64 * 1e-3;
        integrator.advance(&of(t), k, effects, t, 1e-3, &mut x).expect("the run stays in the model's range");
        all.push(x);
    }
    all
}

/// Half periods of 0.5 s, the brake closed for a moment in the second, the bypass open in the fourth, the pump at rest in the fifth.
pub fn wave(t: f64) -> Input {
    let half = (t / 0.5 + 1e-9) as usize;
    let voltage_v = match half {
        4 => 0.0,
        _ if half.is_multiple_of(2) => 21.6,
        _ => -21.6,
    };
    Input {
        brake_open: !(0.8..0.9).contains(&t),
        bypass_open: (1.6..1.7).contains(&t),
        vertical: true,
        ..input(voltage_v)
    }
}
