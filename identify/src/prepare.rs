//! From recordings to stretches: pieces that are simulated from one initial state, with their inputs and targets.

use model::rec::{Circuit, Input, Lever};
use recordings::{Plane, Protocol, Recording};

use crate::noise::{mean, white_std};

/// What is compared with the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Channel {
    /// Encoder, degrees.
    Angle,
    /// bar absolute
    Pressure1,
    /// bar absolute
    Pressure2,
    /// Torque that the clamp holds, Nm.
    Torque,
    /// Measuring cylinder, ml.
    Volume,
}

impl Channel {
    /// All.
    pub const ALL: [Channel; 5] =
        [Channel::Angle, Channel::Pressure1, Channel::Pressure2, Channel::Torque, Channel::Volume];
    /// Column of the campaign contract.
    pub fn column(self) -> &'static str {
        ["angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml"][self as usize]
    }
    /// This channel of a recording.
    pub fn of(self, r: &Recording) -> &[f64] {
        match self {
            Channel::Angle => &r.angle_deg,
            Channel::Pressure1 => &r.pressure1_bar,
            Channel::Pressure2 => &r.pressure2_bar,
            Channel::Torque => &r.torque_nm,
            Channel::Volume => &r.volume_ml,
        }
    }
}

/// How the plant stands in a stretch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stand {
    /// The lever is free.
    Free,
    /// The angle is an input; pump and valves work.
    Led,
    /// The angle is an input; the chambers are shut off.
    LedShutOff,
    /// Angle and pressures are inputs; the chambers are shut off and chamber 1 is drained.
    Drained,
    /// Pump alone; the pressures are inputs.
    Bench,
}

/// The mean of the valid samples of one channel over some rows.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Channel.
    pub channel: Channel,
    /// Mean of the measured values.
    pub measured: f64,
    /// Number of samples in the mean.
    pub samples: usize,
    /// Position in the stretch of the row that stands for the whole, where the sensitivities are taken.
    pub middle: usize,
    /// Time of that row, s since the run's start.
    pub time_s: f64,
}

/// A piece of a run that is simulated from one initial state.
#[derive(Clone, Debug)]
pub struct Stretch {
    /// Position of the run in the campaign.
    pub run: usize,
    /// Its protocol.
    pub protocol: Protocol,
    /// How the plant stands.
    pub stand: Stand,
    /// Gravity acts.
    pub vertical: bool,
    /// Times of the rows, s since the run's start.
    pub time_s: Vec<f64>,
    /// Voltage, V.
    pub voltage_v: Vec<f64>,
    /// Brake valve.
    pub brake_open: Vec<bool>,
    /// Bypass valve.
    pub bypass_open: Vec<bool>,
    /// Angle as an input, rad; empty where it is not one.
    pub angle_rad: Vec<f64>,
    /// Pressures as inputs, bar absolute; empty where they are not.
    pub pressure_bar: [Vec<f64>; 2],
    /// Initial angle (rad) and pressures (bar absolute) as the sensors show them.
    pub initial: [f64; 3],
    /// Standard errors of the initial values; 0 = taken as exact.
    pub initial_std: [f64; 3],
    /// Measured values by channel, one a row; `NaN` = none. Channels that are not targets are empty.
    pub measured: [Vec<f64>; 5],
    /// First rows of the blocks over which targets are averaged, and the number of rows at the end.
    pub blocks: Vec<usize>,
    /// What is compared, in the order of the blocks, then of the channels.
    pub targets: Vec<Target>,
}

impl Stretch {
    /// The input that acts from row `i` on for `dt` seconds.
    pub fn input(&self, i: usize, dt: f64) -> Input {
        let velocity = |series: &[f64]| if i + 1 < series.len() { (series[i + 1] - series[i]) / dt } else { 0.0 };
        let lever = match self.stand {
            Stand::Free => Lever::Free,
            Stand::Bench => Lever::Led { velocity_rad_s: 0.0 },
            _ => Lever::Led { velocity_rad_s: velocity(&self.angle_rad) },
        };
        let circuit = match self.stand {
            Stand::Free | Stand::Led => Circuit::Pump,
            Stand::LedShutOff => Circuit::ShutOff { release_ml_s: 0.0 },
            Stand::Drained => Circuit::Measured {
                rate1_bar_s: velocity(&self.pressure_bar[0]),
                rate2_bar_s: velocity(&self.pressure_bar[1]),
            },
            Stand::Bench => Circuit::Bench,
        };
        Input {
            voltage_v: self.voltage_v[i],
            brake_open: self.brake_open[i],
            bypass_open: self.bypass_open[i],
            vertical: self.vertical,
            lever,
            circuit,
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.time_s.len()
    }

    /// The same from its start on for `length_s`, where the lever is free and the stretch is longer.
    pub fn shortened(&self, length_s: f64) -> Self {
        let mut s = self.clone();
        let end = self.time_s.partition_point(|t| *t < self.time_s[0] + length_s);
        let blocks = self.blocks.partition_point(|b| *b <= end);
        if self.stand != Stand::Free || end >= self.rows() || blocks < 2 {
            return s;
        }
        s.blocks.truncate(blocks);
        let rows = s.blocks[blocks - 1];
        s.time_s.truncate(rows);
        s.voltage_v.truncate(rows);
        s.brake_open.truncate(rows);
        s.bypass_open.truncate(rows);
        s.measured.iter_mut().for_each(|m| m.truncate(rows));
        s.targets.retain(|t| t.middle < rows);
        s
    }

    fn finish(mut self) -> Self {
        let end = self.rows();
        if self.blocks.last() != Some(&end) {
            self.blocks.push(end);
        }
        for b in self.blocks.windows(2) {
            for channel in Channel::ALL {
                let values = &self.measured[channel as usize];
                if values.is_empty() {
                    continue;
                }
                let (measured, samples) = mean(values[b[0]..b[1]].iter().copied());
                if samples > 0 {
                    let valid: Vec<usize> = (b[0]..b[1]).filter(|&i| values[i].is_finite()).collect();
                    let middle = valid[valid.len() / 2];
                    self.targets.push(Target { channel, measured, samples, middle, time_s: self.time_s[middle] });
                }
            }
        }
        self
    }
}

/// A run that is too short or too empty to be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}: {why}")]
pub struct Unusable {
    /// The run's file.
    pub file: String,
    /// Expected and got.
    pub why: String,
}

/// Cuts a run into stretches.
pub fn stretches(
    run: usize,
    file: &str,
    protocol: Protocol,
    plane: Plane,
    recording: &Recording,
) -> Result<Vec<Stretch>, Unusable> {
    let unusable = |why: String| Unusable { file: file.to_string(), why };
    let r = if slow(protocol) { thinned(recording, 0.01) } else { recording.clone() };
    if r.len() < 20 {
        return Err(unusable(format!("expected at least 20 rows, got {}", r.len())));
    }
    let cut = |first: usize, end: usize, stand: Stand| Stretch {
        run,
        protocol,
        stand,
        vertical: plane == Plane::Vertical,
        time_s: r.time_s[first..end].to_vec(),
        voltage_v: r.voltage_v[first..end].to_vec(),
        brake_open: r.brake_open[first..end].to_vec(),
        bypass_open: r.bypass_open[first..end].to_vec(),
        angle_rad: Vec::new(),
        pressure_bar: [Vec::new(), Vec::new()],
        initial: [0.0; 3],
        initial_std: [0.0; 3],
        measured: Default::default(),
        blocks: Vec::new(),
        targets: Vec::new(),
    };
    let segments = segments(&r);
    let mut out = Vec::new();
    match protocol {
        Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps => {
            let mut s = cut(0, r.len(), Stand::Free);
            let rest = rest_rows(&r).ok_or_else(|| {
                unusable(
                    "expected some 1 s of rest at u = 0 at the start, from which the initial state is taken".into(),
                )
            })?;
            for (j, channel) in [Channel::Angle, Channel::Pressure1, Channel::Pressure2].into_iter().enumerate() {
                let values = &channel.of(&r)[..rest];
                let (m, n) = mean(values.iter().copied());
                if n < 5 {
                    return Err(unusable(format!(
                        "{}: expected values during the initial rest, got {n} of {rest} rows",
                        channel.column()
                    )));
                }
                let std = white_std(channel.of(&r)).unwrap_or(0.0).max(1e-9) / (n as f64).sqrt();
                let unit = if j == 0 { std::f64::consts::PI / 180.0 } else { 1.0 };
                s.initial[j] = m * unit;
                s.initial_std[j] = 2.0 * std * unit;
                s.measured[channel as usize] = channel.of(&r).to_vec();
            }
            s.blocks = block_starts(&s.time_s, 0.01);
            out.push(s.finish());
        }
        Protocol::TorqueMap => {
            // a stretch per clamped angle: how the lever gets from one to the next is not known well enough
            for (first, end) in dwells(&r, &segments) {
                let mut s = cut(first, end, Stand::Led);
                let (angle, _) = mean(r.angle_deg[first..end].iter().copied());
                s.angle_rad = vec![angle.to_radians(); end - first];
                initial_from_rows(&mut s, &r, first, 0.05, 0.05);
                for channel in [Channel::Pressure1, Channel::Pressure2, Channel::Torque] {
                    s.measured[channel as usize] = channel.of(&r)[first..end].to_vec();
                }
                s.blocks = block_starts(&s.time_s, 0.1);
                out.push(s.finish());
            }
        }
        Protocol::VolumeMap => {
            for &(first, end) in &segments {
                // a segment without a reading is not a sweep of a known amount: the filling before it, say
                let (_, readings) = mean(r.volume_ml[first..end].iter().copied());
                if end - first < 20 || readings == 0 {
                    continue;
                }
                let mut s = cut(first, end, Stand::LedShutOff);
                s.angle_rad = filled(&r.angle_deg[first..end]).iter().map(|a| a.to_radians()).collect();
                initial_from_rows(&mut s, &r, first, 0.03, 0.1);
                s.initial[0] = s.angle_rad[0];
                for channel in [Channel::Pressure1, Channel::Pressure2] {
                    s.measured[channel as usize] = channel.of(&r)[first..end].to_vec();
                }
                s.blocks = block_starts(&s.time_s, 0.1);
                out.push(s.finish());
            }
        }
        Protocol::ClampSteps => {
            for (first, end) in fillings(&r, &segments) {
                let inside: Vec<(usize, usize)> =
                    segments.iter().copied().filter(|s| s.0 >= first && s.1 <= end).collect();
                // what follows the last reading belongs to the next filling
                let read = |s: &(usize, usize)| r.volume_ml[s.0..s.1].iter().any(|v| v.is_finite());
                let last = inside.iter().rposition(read).map_or(0, |n| n + 1);
                let inside = &inside[..last];
                let Some(end) = inside.last().map(|s| s.1) else { continue };
                if inside.len() < 3 {
                    continue;
                }
                let mut s = cut(first, end, Stand::Drained);
                let (angle, _) = mean(r.angle_deg[first..end].iter().copied());
                s.angle_rad = vec![angle.to_radians(); end - first];
                s.pressure_bar =
                    [Channel::Pressure1, Channel::Pressure2].map(|c| drained_pressure(&r, c.of(&r), first, end));
                s.initial = [s.angle_rad[0], s.pressure_bar[0][0], s.pressure_bar[1][0]];
                let mut volume = vec![f64::NAN; end - first];
                for (n, &(a, b)) in inside.iter().enumerate() {
                    // a segment's readings are one reading of the cylinder; the first defines its zero
                    let (reading, count) = mean(r.volume_ml[a..b].iter().copied());
                    if n > 0 && count > 0 {
                        volume[(a + b) / 2 - first] = reading;
                    }
                    s.blocks.push(a - first);
                }
                s.measured[Channel::Volume as usize] = volume;
                s.measured[Channel::Torque as usize] = r.torque_nm[first..end].to_vec();
                out.push(s.finish());
            }
        }
        Protocol::PumpMap => {
            for &(first, end) in &segments {
                let (_, readings) = mean(r.volume_ml[first..end].iter().copied());
                if readings < 3 {
                    continue;
                }
                let mut s = cut(first, end, Stand::Bench);
                s.angle_rad = vec![0.0; end - first];
                s.pressure_bar = [Channel::Pressure1, Channel::Pressure2]
                    .map(|c| smoothed(&filled(&c.of(&r)[first..end]), &s.time_s, 0.5));
                s.initial = [0.0, s.pressure_bar[0][0], s.pressure_bar[1][0]];
                let mut volume = r.volume_ml[first..end].to_vec();
                volume[0] = f64::NAN; // 0 by definition
                s.measured[Channel::Volume as usize] = volume;
                s.blocks = block_starts(&s.time_s, 0.2);
                out.push(s.finish());
            }
        }
    }
    if out.is_empty() {
        return Err(unusable(format!("no usable segment of the protocol {protocol} in {} rows", r.len())));
    }
    Ok(out)
}

/// Protocols whose quantities change over seconds.
fn slow(protocol: Protocol) -> bool {
    matches!(protocol, Protocol::TorqueMap | Protocol::VolumeMap | Protocol::PumpMap | Protocol::ClampSteps)
}

/// Every row `spacing_s` apart, and those where an input or the segment changes or a sparse reading stands.
fn thinned(r: &Recording, spacing_s: f64) -> Recording {
    let sparse = r.volume_ml.iter().filter(|v| v.is_finite()).count() * 5 < r.len();
    let mut keep = Vec::new();
    let mut last = f64::NEG_INFINITY;
    for i in 0..r.len() {
        let changed = i > 0
            && (r.segment[i] != r.segment[i - 1]
                || r.voltage_v[i] != r.voltage_v[i - 1]
                || r.brake_open[i] != r.brake_open[i - 1]
                || r.bypass_open[i] != r.bypass_open[i - 1]);
        if changed || r.time_s[i] - last > spacing_s - 1e-6 || (sparse && r.volume_ml[i].is_finite()) {
            keep.push(i);
            last = r.time_s[i];
        }
    }
    if keep.len() == r.len() {
        return r.clone();
    }
    let pick = |v: &[f64]| keep.iter().map(|&i| v[i]).collect();
    Recording {
        time_s: pick(&r.time_s),
        voltage_v: pick(&r.voltage_v),
        angle_deg: pick(&r.angle_deg),
        pressure1_bar: pick(&r.pressure1_bar),
        pressure2_bar: pick(&r.pressure2_bar),
        torque_nm: pick(&r.torque_nm),
        volume_ml: pick(&r.volume_ml),
        brake_open: keep.iter().map(|&i| r.brake_open[i]).collect(),
        bypass_open: keep.iter().map(|&i| r.bypass_open[i]).collect(),
        segment: keep.iter().map(|&i| r.segment[i]).collect(),
    }
}

/// Rows `[first, end)` of each segment, in order.
pub fn segments(r: &Recording) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut first = 0;
    for i in 1..=r.len() {
        if i == r.len() || r.segment[i] != r.segment[first] {
            out.push((first, i));
            first = i;
        }
    }
    out
}

/// Rows of the initial rest: voltage 0 from the start on, at most until it first differs.
fn rest_rows(r: &Recording) -> Option<usize> {
    let moved = r.voltage_v.iter().position(|u| *u != 0.0).unwrap_or(r.len());
    let rows = moved.min(r.time_s.partition_point(|t| *t < r.time_s[0] + 1.5));
    (rows >= 10 && r.time_s[rows - 1] - r.time_s[0] > 0.1).then_some(rows)
}

/// First rows of blocks that last `length_s`.
fn block_starts(time_s: &[f64], length_s: f64) -> Vec<usize> {
    let mut out = vec![0];
    let mut start = time_s[0];
    for (i, t) in time_s.iter().enumerate() {
        if *t - start > length_s - 1e-6 {
            out.push(i);
            start = *t;
        }
    }
    out
}

/// Initial pressures from the first `over_s` seconds, to be refined within `std_bar`.
fn initial_from_rows(s: &mut Stretch, r: &Recording, first: usize, over_s: f64, std_bar: f64) {
    let rows = s.time_s.partition_point(|t| *t < s.time_s[0] + over_s).max(1);
    s.initial[0] = s.angle_rad[0];
    for (j, channel) in [Channel::Pressure1, Channel::Pressure2].into_iter().enumerate() {
        let (m, n) = mean(channel.of(r)[first..first + rows].iter().copied());
        let (fallback, _) = mean(channel.of(r)[first..].iter().copied().take(200));
        s.initial[j + 1] = if n > 0 { m } else { fallback };
        s.initial_std[j + 1] = std_bar;
    }
}

/// Rows `[first, end)` of the torque map during which the lever is clamped at one angle: segments in a row whose torque is
/// read and whose mean angles agree.
fn dwells(r: &Recording, segments: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut out: Vec<(usize, usize)> = Vec::new();
    let mut last_angle = f64::NAN;
    for &(first, end) in segments {
        let (_, readings) = mean(r.torque_nm[first..end].iter().copied());
        let (angle, _) = mean(r.angle_deg[first..end].iter().copied());
        if readings * 2 > end - first {
            match out.last_mut() {
                Some(dwell) if dwell.1 == first && (angle - last_angle).abs() < 0.3 => dwell.1 = end,
                _ => out.push((first, end)),
            }
            last_angle = angle;
        }
    }
    out.retain(|(first, end)| end - first >= 20);
    out
}

/// Rows `[first, end)` of each filling of the clamp-steps protocol: the cylinder starts at 0 anew.
fn fillings(r: &Recording, segments: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut starts = Vec::new();
    let mut last = f64::INFINITY;
    let mut last_angle = f64::NAN;
    for &(first, end) in segments {
        let (reading, n) = mean(r.volume_ml[first..end].iter().copied());
        let (angle, _) = mean(r.angle_deg[first..end].iter().copied());
        if n > 0 && (reading < last - 0.5 || (angle - last_angle).abs() > 1.0) {
            starts.push(first);
        }
        if n > 0 {
            last = reading;
        }
        last_angle = angle;
    }
    starts.push(r.len());
    starts.windows(2).map(|w| (w[0], w[1])).collect()
}

/// A pressure of the clamp-steps protocol as an input: smoothed at rest, straight during a release (where the volume is
/// empty): the oil that leaves depends on where the pressure ends, not on the way.
fn drained_pressure(r: &Recording, values: &[f64], first: usize, end: usize) -> Vec<f64> {
    let time = &r.time_s[first..end];
    let mut out = filled(&values[first..end]);
    let resting: Vec<bool> = (first..end).map(|i| r.volume_ml[i].is_finite()).collect();
    let n = out.len();
    let mut i = 0;
    while i < n {
        let j = (i..n).find(|&j| resting[j] != resting[i]).unwrap_or(n);
        if resting[i] {
            let smooth = smoothed(&out[i..j], &time[i..j], 0.25);
            out[i..j].copy_from_slice(&smooth);
        }
        i = j;
    }
    let mut i = 0;
    while i < n {
        let j = (i..n).find(|&j| resting[j] != resting[i]).unwrap_or(n);
        if !resting[i] && i > 0 && j < n {
            let (a, b) = (out[i - 1], out[j]);
            for l in i..j {
                out[l] = a + (b - a) * (l + 1 - i) as f64 / (j + 1 - i) as f64;
            }
        }
        i = j;
    }
    out
}

/// Missing values replaced by the neighbours' straight line.
fn filled(values: &[f64]) -> Vec<f64> {
    let mut out = values.to_vec();
    let known: Vec<usize> = (0..values.len()).filter(|&i| values[i].is_finite()).collect();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else { return out };
    out[..first].fill(values[first]);
    out[last..].fill(values[last]);
    for w in known.windows(2) {
        for i in w[0] + 1..w[1] {
            let f = (i - w[0]) as f64 / (w[1] - w[0]) as f64;
            out[i] = values[w[0]] + f * (values[w[1]] - values[w[0]]);
        }
    }
    out
}

/// Mean over a window of +- `half_s`.
fn smoothed(values: &[f64], time_s: &[f64], half_s: f64) -> Vec<f64> {
    let mut sums = vec![0.0];
    for v in values {
        sums.push(sums[sums.len() - 1] + v);
    }
    let (mut a, mut b) = (0, 0);
    (0..values.len())
        .map(|i| {
            // symmetric, so that a slope stays where it is
            while time_s[a] < time_s[i] - half_s {
                a += 1;
            }
            while b < values.len() && time_s[b] <= time_s[i] + half_s {
                b += 1;
            }
            let reach = (i - a).min(b - 1 - i);
            (sums[i + reach + 1] - sums[i - reach]) / (2 * reach + 1) as f64
        })
        .collect()
}
