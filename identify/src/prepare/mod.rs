//! From recordings to stretches: pieces that are simulated from one initial state, with their inputs and targets.

mod inputs;
mod past;
mod rows;
mod stretch;
mod way;

use recordings::{Plane, Protocol, Recording};

use crate::noise::{error_of_mean, mean, spread_about_line, step, white_std};
use inputs::{drained_pressure, filled, led_angle, level, rests, smoothed};
use rows::{block_starts, dwells, fillings, rest_rows, slow, thinned};

use past::past;
use way::way_rad;

pub use rows::segments;
pub use stretch::{Channel, Stand, Stretch, Target};

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
    let led = (protocol == Protocol::VolumeMap).then(|| led_angle(recording));
    let r = if slow(protocol) { thinned(led.as_ref().unwrap_or(recording), 0.01) } else { recording.clone() };
    if r.len() < 20 {
        return Err(unusable(format!("expected at least 20 rows, got {}", r.len())));
    }
    let cut = |first: usize, end: usize, stand: Stand| Stretch {
        run,
        file: file.to_string(),
        protocol: Some(protocol),
        stand,
        vertical: plane == Plane::Vertical,
        time_s: r.time_s[first..end].to_vec(),
        voltage_v: r.voltage_v[first..end].to_vec(),
        brake_open: r.brake_open[first..end].to_vec(),
        bypass_open: r.bypass_open[first..end].to_vec(),
        angle_rad: Vec::new(),
        way_rad: Vec::new(),
        past: None,
        pressure_bar: [Vec::new(), Vec::new()],
        inputs: Vec::new(),
        initial: vec![0.0; 3],
        initial_std: vec![0.0; 3],
        measured: vec![Vec::new(); Channel::ALL.len()],
        guide: None,
        blocks: Vec::new(),
        targets: Vec::new(),
    };
    let segments = segments(&r);
    let angle_noise = white_std(&recording.angle_deg).unwrap_or(0.0).max(step(&recording.angle_deg));
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
                let present: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
                let n = present.len();
                if n < 5 {
                    return Err(unusable(format!(
                        "{}: expected values during the initial rest, got {n} of {rest} rows",
                        channel.column()
                    )));
                }
                let noise = white_std(channel.of(&r)).unwrap_or(0.0).max(1e-9);
                let m = level(values, noise.max(step(channel.of(&r))).max(spread_about_line(&present)));
                let std = (noise / (n as f64).sqrt()).max(error_of_mean(&present));
                let unit = if j == 0 { std::f64::consts::PI / 180.0 } else { 1.0 };
                s.initial[j] = m * unit;
                s.initial_std[j] = 2.0 * std * unit;
                s.measured[channel.index()] = channel.of(&r).to_vec();
            }
            s.blocks = block_starts(&s.time_s, 0.01);
            out.push(s.finish());
        }
        Protocol::TorqueMap => {
            // a stretch per clamped angle: what the oil does while the lever is led to the next is not known well enough
            for (first, end) in dwells(&r, &segments) {
                let mut s = cut(first, end, Stand::Led);
                s.angle_rad = vec![level(&r.angle_deg[first..end], angle_noise).to_radians(); end - first];
                s.way_rad = way_rad(&r, first, angle_noise, s.angle_rad[0]);
                s.past = past(&s, &r, first, angle_noise);
                initial_from_rows(&mut s, &r, first, 0.05, 0.05);
                for channel in [Channel::Pressure1, Channel::Pressure2, Channel::Torque] {
                    s.measured[channel.index()] = channel.of(&r)[first..end].to_vec();
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
                    s.measured[channel.index()] = channel.of(&r)[first..end].to_vec();
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
                s.angle_rad = vec![level(&r.angle_deg[first..end], angle_noise).to_radians(); end - first];
                s.way_rad = way_rad(&r, first, angle_noise, s.angle_rad[0]);
                s.pressure_bar =
                    [Channel::Pressure1, Channel::Pressure2].map(|c| drained_pressure(&r, c.of(&r), first, end));
                s.initial = vec![s.angle_rad[0], s.pressure_bar[0][0], s.pressure_bar[1][0]];
                let mut volume = vec![f64::NAN; end - first];
                for (n, &(a, b)) in inside.iter().enumerate() {
                    // a segment's readings are one reading of the cylinder; the first defines its zero
                    let (reading, count) = mean(r.volume_ml[a..b].iter().copied());
                    if n > 0 && count > 0 {
                        volume[(a + b) / 2 - first] = reading;
                    }
                    s.blocks.push(a - first);
                }
                s.measured[Channel::Volume.index()] = volume;
                // while oil is released the pressures are not known well enough for the torque
                let torque = (first..end).map(|i| if rests(&r, i) { r.torque_nm[i] } else { f64::NAN });
                s.measured[Channel::Torque.index()] = torque.collect();
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
                s.initial = vec![0.0, s.pressure_bar[0][0], s.pressure_bar[1][0]];
                let mut volume = r.volume_ml[first..end].to_vec();
                volume[0] = f64::NAN; // 0 by definition
                s.measured[Channel::Volume.index()] = volume;
                s.blocks = block_starts(&s.time_s, 0.2);
                out.push(s.finish());
            }
        }
    }
    // where a sensor was silent for a whole stretch nobody knows what drove it
    out.retain(|s| {
        let known = s.has_inputs();
        if !known {
            tracing::warn!(file, from_s = s.time_s[0], "no angle or pressure there: the stretch is passed over");
        }
        known
    });
    if out.is_empty() {
        return Err(unusable(format!("no usable segment of the protocol {protocol} in {} rows", r.len())));
    }
    Ok(out)
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
