//! The state as JSON, for scripts. What is not known is `null`; units stand in the names.

use super::state::{Phase, State};
use crate::exchange::content::severity;
use rt_core::{Input, Sample, flags};
use serde_json::{Map, Value, json};
use std::time::Instant;

/// Version of the document; fields may be added without another number.
const FORMAT: u32 = 1;
/// Happenings that are told.
const HAPPENINGS: usize = 20;

/// Names of a sample's flags, by their bits.
pub const FLAGS: [(u32, &str); 10] = [
    (flags::BRAKE_OPEN, "brake_open"),
    (flags::BYPASS_OPEN, "bypass_open"),
    (flags::TRIPPED, "tripped"),
    (flags::LAST, "last"),
    (flags::FAULT, "fault"),
    (flags::OVERRUN, "overrun"),
    (flags::STOPPED, "stopped"),
    (flags::SLEW_LIMITED, "slew_limited"),
    (flags::WAITING, "waiting"),
    (flags::CONFIRMED, "confirmed"),
];

/// The document.
pub fn document(state: &State, now: Instant) -> Value {
    let phase = state.phase(now);
    let why = match &phase {
        Phase::Tripped(why) | Phase::Ended(_, why) => Some(why.clone()),
        _ => None,
    };
    let silent_s = state.silent(now).map(|silent| silent.as_secs_f64());
    let happenings: Vec<Value> = state
        .latest(HAPPENINGS)
        .iter()
        .map(|h| json!({ "run": h.run, "time_s": h.time_s, "severity": severity(h.severity), "text": h.text }))
        .collect();
    let mut document = json!({
        "format": FORMAT,
        "instance": state.instance,
        "state": phase.word(),
        "why": why,
        "silent_s": silent_s,
        "timing": state.timing.summary(),
        "events": happenings,
    });
    let run = state.run.as_ref().map(|run| {
        let told = run.description.as_ref();
        json!({
            "number": run.newest.run,
            "name": told.map(|d| d.name.clone()),
            "protocol": told.map(|d| d.protocol.as_str()),
            "role": told.map(|d| d.role.as_str()),
            "plane": told.map(|d| d.plane.as_str()),
            "step": run.newest.step,
            "step_text": told.and_then(|d| d.step(run.newest.step)),
            "samples_received": run.received,
            "samples_missed": run.missed,
        })
    });
    document["run"] = run.unwrap_or(Value::Null);
    document["sample"] = state.run.as_ref().map_or(Value::Null, |run| sample(&run.newest));
    document
}

fn sample(s: &Sample) -> Value {
    let measured = s.measurement();
    let mut inputs = Map::new();
    for input in Input::ALL {
        let (value, name) = (measured.value(input), input.column());
        inputs.insert(
            name.to_owned(),
            json!({
                "value": finite(value),
                "age_ms": value.is_finite().then(|| f64::from(s.age_ns[input as usize]) * 1e-6),
                "valid": s.quality & input.bit() != 0,
            }),
        );
    }
    let target =
        s.target().map(|(kind, value)| json!({ "of": kind.name(), "unit": kind.unit(), "value": finite(value) }));
    let set: Vec<&str> = FLAGS.iter().filter(|(bit, _)| s.flags & bit != 0).map(|(_, name)| *name).collect();
    json!({
        "tick": s.tick,
        "time_s": s.time_s(),
        "segment": s.segment,
        "voltage_v": s.voltage_v,
        "target": target,
        "inputs": inputs,
        "brake_open": s.brake_open(),
        "bypass_open": s.bypass_open(),
        "flags": set,
        "trip": s.trip,
        "heartbeat_age_ms": f64::from(s.heartbeat_age_ns) * 1e-6,
        "lateness_us": s.lateness_ns as f64 * 1e-3,
        "skipped": s.skipped,
    })
}

/// JSON has no NaN.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_has_one_name() {
        for (at, (bit, name)) in FLAGS.iter().enumerate() {
            assert_eq!(*bit, 1 << at, "{name}");
        }
    }

    #[test]
    fn the_newest_sample_is_told_with_ages_and_what_is_missing_is_null() {
        let mut state = State::new("rig");
        let now = Instant::now();
        assert_eq!(document(&state, now)["sample"], Value::Null);
        let sample = Sample {
            run: 7,
            voltage_v: -3.5,
            angle_deg: 12.25,
            age_ns: [1_500_000, 0, 0, 0, 0],
            quality: Input::Angle.bit(),
            flags: flags::BRAKE_OPEN | flags::WAITING,
            target: 12.5,
            target_of: 6,
            ..Sample::BLANK
        };
        state.take(&[sample], now);
        let told = document(&state, now);
        assert_eq!(told["state"], "waits-for-people");
        assert_eq!(told["sample"]["inputs"]["angle_deg"], json!({ "value": 12.25, "age_ms": 1.5, "valid": true }));
        assert_eq!(told["sample"]["inputs"]["torque_nm"], json!({ "value": null, "age_ms": null, "valid": false }));
        assert_eq!(told["sample"]["target"], json!({ "of": "angle", "unit": "deg", "value": 12.5 }));
        assert_eq!(told["sample"]["flags"], json!(["brake_open", "waiting"]));
        assert_eq!((&told["run"]["number"], &told["run"]["name"]), (&json!(7), &Value::Null));
        assert_eq!(told["events"][0]["text"], "run 7 begins");
    }
}
