//! What happened before a stretch that does not begin at rest. With a led lever walls that creep, and oil that takes up air, remember it for many seconds; on
//! the pump's bench a motor that is late, and the oil in a line, still run as they did at the point before.

use recordings::Recording;

use super::inputs::{filled, smoothed};
use super::ran::ran;
use super::rows::is_switched;
use super::way::way_rad;
use super::{Stand, Stretch};

/// So much of what was before is looked at, s: several time constants of any wall that settles within a dwell.
const REACH_S: f64 = 60.0;
/// The same on the pump's bench, where nothing but motor and line remember, s.
const REACH_ON_BENCH_S: f64 = 5.0;
/// A pause of the recording after which nothing is known, s.
const GAP_S: f64 = 1.0;
/// Distance of the rows, s: what forgets faster does not remember a stretch's past either, but for the pump's last change of voltage, which is a row too.
const SPACING_S: f64 = 0.1;

/// The rows before row `first` of a recording, in which pressures, and angle if there is a lever, are inputs; the last one is `first` itself. `None` where
/// the recording begins there, or does not know. `stretch`: what begins there; `noise_deg`: of one sample.
pub(super) fn past(stretch: &Stretch, r: &Recording, first: usize, noise_deg: f64) -> Option<Box<Stretch>> {
    let on_bench = stretch.stand == Stand::Bench;
    let reach_s = if on_bench { REACH_ON_BENCH_S } else { REACH_S };
    let near = |i: &usize| r.time_s[first] - r.time_s[*i] <= reach_s && r.time_s[i + 1] - r.time_s[*i] <= GAP_S;
    let start = (0..first).rev().take_while(near).last()?;
    let time = &r.time_s[start..=first];
    let series = |values: &[f64]| smoothed(&filled(&values[start..=first]), time, SPACING_S / 2.0);
    let pressure = [series(&r.pressure1_bar), series(&r.pressure2_bar)];
    let angle_deg = if on_bench { vec![0.0; time.len()] } else { series(&r.angle_deg) };
    let switched = |i: usize| on_bench && is_switched(r, start + i);
    let mut rows = vec![0];
    for (i, t) in time.iter().enumerate().skip(1) {
        if t - time[rows[rows.len() - 1]] > SPACING_S - 1e-6 || switched(i) {
            rows.push(i);
        }
    }
    let last = time.len() - 1;
    if rows[rows.len() - 1] != last {
        rows.push(last);
    }
    let pick = |values: &[f64]| -> Vec<f64> { rows.iter().map(|&i| values[i]).collect() };
    let open = |values: &[bool]| -> Vec<bool> { rows.iter().map(|&i| values[start + i]).collect() };
    let angle_rad: Vec<f64> = pick(&angle_deg).iter().map(|a| a.to_radians()).collect();
    let pressure_bar = pressure.map(|p| pick(&p));
    let past = Stretch {
        stand: if on_bench { Stand::Bench } else { Stand::Drained },
        time_s: pick(time),
        voltage_v: pick(&r.voltage_v[start..=first]),
        brake_open: open(&r.brake_open),
        bypass_open: open(&r.bypass_open),
        way_rad: if on_bench { Vec::new() } else { way_rad(r, start, noise_deg, angle_rad[0]) },
        held: None,
        ran: ran(r, start),
        initial: vec![angle_rad[0], pressure_bar[0][0], pressure_bar[1][0]],
        initial_std: vec![0.0; 3],
        angle_rad,
        pressure_bar,
        measured: vec![Vec::new(); stretch.measured.len()],
        blocks: Vec::new(),
        targets: Vec::new(),
        past: None,
        ..stretch.clone()
    };
    past.has_inputs().then(|| Box::new(past))
}
