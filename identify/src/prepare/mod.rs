//! From recordings to stretches: pieces that are simulated from one initial state, with their inputs and targets.

mod inputs;
mod past;
mod ran;
mod rows;
mod stretch;
mod way;

use recordings::{Plane, Protocol, Recording};

use crate::noise::{error_of_mean, mean, spread_about_line, step, white_std};
use inputs::{BRIDGED_S, drained_pressure, filled, is_torn, led_angle, level, resting, smoothed};
use rows::{block_starts, dwells, fillings, is_long_enough, rest_rows, slow, thinned};

use past::past;
use ran::ran;
use way::{held, way_rad};

pub(crate) use rows::is_read;
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
        held: None,
        ran: ran(&r, first),
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
            for (first, end) in dwells(file, &r, &segments) {
                let mut s = cut(first, end, Stand::Led);
                s.angle_rad = vec![level(&r.angle_deg[first..end], angle_noise).to_radians(); end - first];
                s.way_rad = way_rad(&r, first, angle_noise, s.angle_rad[0]);
                s.held = held(&s, &r, first, end);
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
                if readings == 0 {
                    continue;
                }
                if !is_long_enough(&r, first, end) {
                    tracing::warn!(
                        file,
                        from_s = r.time_s[first],
                        "a sweep of too short a time, or of too few rows: it is passed over"
                    );
                    continue;
                }
                let mut s = cut(first, end, Stand::LedShutOff);
                let torn = is_torn((first..end).map(|i| (r.time_s[i], r.angle_deg[i])));
                let angle_deg = if torn { vec![f64::NAN; end - first] } else { filled(&r.angle_deg[first..end]) };
                s.angle_rad = angle_deg.iter().map(|a| a.to_radians()).collect();
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
            let resting = resting(&r);
            for (first, end) in fillings(&r, &segments) {
                let inside: Vec<(usize, usize)> =
                    segments.iter().copied().filter(|s| s.0 >= first && s.1 <= end).collect();
                // what follows the last reading belongs to the next filling
                let read = |s: &(usize, usize)| r.volume_ml[s.0..s.1].iter().any(|v| v.is_finite());
                let last = inside.iter().rposition(read).map_or(0, |n| n + 1);
                // nor is what came before a pressure known that was missing: a sensor saturates at the top of a filling
                let torn = |&(a, b): &(usize, usize)| {
                    let rest = || (a..b).filter(|&i| resting[i]);
                    PRESSURES.iter().any(|c| is_torn(rest().map(|i| (r.time_s[i], c.of(&r)[i]))))
                };
                let known = inside[..last].iter().rposition(torn).map_or(0, |n| n + 1);
                let inside = &inside[known..last];
                let Some((&(begin, begin_end), &(_, end))) = inside.first().zip(inside.last()) else { continue };
                // the first reading counts from rest: what was released from an unknown pressure is not known
                let first = if known == 0 { begin } else { (begin..begin_end).find(|&i| resting[i]).unwrap_or(begin) };
                if inside.len() < 3 {
                    continue;
                }
                let mut s = cut(first, end, Stand::Drained);
                s.angle_rad = vec![level(&r.angle_deg[first..end], angle_noise).to_radians(); end - first];
                s.way_rad = way_rad(&r, first, angle_noise, s.angle_rad[0]);
                s.held = held(&s, &r, first, end);
                s.pressure_bar = PRESSURES.map(|c| drained_pressure(&r, c.of(&r), &resting, (first, end)));
                s.initial = vec![s.angle_rad[0], s.pressure_bar[0][0], s.pressure_bar[1][0]];
                let mut volume = vec![f64::NAN; end - first];
                // a segment's readings are one reading of the cylinder; the filling's first defines its zero, which its prediction starts from
                let reading = |&(a, b): &(usize, usize)| mean(r.volume_ml[a..b].iter().copied());
                let zero_ml = if known == 0 { 0.0 } else { reading(&inside[0]).0 };
                for (n, segment) in inside.iter().enumerate() {
                    let &(a, b) = segment;
                    let rest: Vec<usize> = (a..b).filter(|&i| resting[i]).collect();
                    if n > 0 && !rest.is_empty() {
                        // the middle of the segment, or of its rest where the oil still leaves at that time
                        let middle = (a + b) / 2;
                        let at = if resting[middle] { middle } else { rest[rest.len() / 2] };
                        volume[at - first] = reading(segment).0 - zero_ml;
                    }
                    s.blocks.push(a.max(first) - first);
                }
                s.measured[Channel::Volume.index()] = volume;
                // while oil is released the pressures are not known well enough for the torque
                let torque = (first..end).map(|i| if resting[i] { r.torque_nm[i] } else { f64::NAN });
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
                let torn = |c: Channel| is_torn((first..end).map(|i| (r.time_s[i], c.of(&r)[i])));
                s.pressure_bar = PRESSURES.map(|c| {
                    if torn(c) {
                        vec![f64::NAN; end - first]
                    } else {
                        smoothed(&filled(&c.of(&r)[first..end]), &s.time_s, 0.5)
                    }
                });
                s.initial = vec![0.0, s.pressure_bar[0][0], s.pressure_bar[1][0]];
                s.past = past(&s, &r, first, angle_noise);
                let mut volume = r.volume_ml[first..end].to_vec();
                volume[0] = f64::NAN; // 0 by definition
                s.measured[Channel::Volume.index()] = volume;
                s.blocks = block_starts(&s.time_s, 0.2);
                out.push(s.finish());
            }
        }
    }
    // where a sensor was silent nobody knows what drove it
    out.retain(|s| {
        let known = s.has_inputs();
        if !known {
            tracing::warn!(
                file,
                from_s = s.time_s[0],
                "no angle or pressure there for a time: the stretch is passed over"
            );
        }
        known
    });
    if out.is_empty() {
        return Err(unusable(format!(
            "expected a segment of the protocol {protocol} whose angle, pressures and readings are there throughout, got none in {} rows; repair the sensor, or take the run out of campaign.toml",
            r.len()
        )));
    }
    Ok(out)
}

const PRESSURES: [Channel; 2] = [Channel::Pressure1, Channel::Pressure2];

/// Initial pressures from the first `over_s` seconds, to be refined within `std_bar`; not known where they are missing for longer than a gap that is bridged.
fn initial_from_rows(s: &mut Stretch, r: &Recording, first: usize, over_s: f64, std_bar: f64) {
    let rows = s.time_s.partition_point(|t| *t < s.time_s[0] + over_s).max(1);
    s.initial[0] = s.angle_rad[0];
    for (j, channel) in PRESSURES.into_iter().enumerate() {
        let (m, n) = mean(channel.of(r)[first..first + rows].iter().copied());
        let near = r.time_s.partition_point(|t| *t <= s.time_s[0] + BRIDGED_S).max(first);
        let (fallback, _) = mean(channel.of(r)[first..near].iter().copied());
        s.initial[j + 1] = if n > 0 { m } else { fallback };
        s.initial_std[j + 1] = std_bar;
    }
}
