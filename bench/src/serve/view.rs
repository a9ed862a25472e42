//! What clients are told of service and run, as JSON: the object of `GET /api/v1/state`.

use super::state::Queued;
use rt_core::{Channel, Input, Limits, Sample, flags};
use serde::Serialize;
use std::collections::BTreeMap;

/// All of it.
#[derive(Clone, Debug, Serialize)]
pub struct State<'a> {
    /// The service itself.
    pub service: &'a Service,
    /// The run under way, or the last one.
    pub run: Option<&'a Run>,
    /// Signs of life of the device.
    pub link: Option<Link>,
    /// What waits for its turn.
    pub queue: &'a [Queued],
    /// The last run of the queue that ended.
    pub last: Option<&'a Last>,
}

/// The service.
#[derive(Clone, Debug, Serialize)]
pub struct Service {
    /// `idle`, `armed`, `running`, `tripped`.
    pub state: &'static str,
    /// Under which runs are published.
    pub instance: String,
    /// Program, version and commit.
    pub version: String,
    /// Name of the rig.
    pub rig: String,
    /// `emulated` or `wired`.
    pub device: &'static str,
    /// It takes commands.
    pub control: bool,
    /// Since when it is there.
    pub started_utc: String,
    /// For how long it stays armed, s.
    pub armed_left_s: Option<f64>,
    /// Why it is held.
    pub trip: Option<Trip>,
    /// What the supervisor enforces.
    pub limits: LimitsView,
}

/// Why the service is held.
#[derive(Clone, Debug, Serialize)]
pub struct Trip {
    /// The run that tripped.
    pub run: Option<u32>,
    /// In words.
    pub reason: String,
    /// When.
    pub utc: String,
}

/// The rig's limits.
#[derive(Clone, Debug, Serialize)]
pub struct LimitsView {
    pressure_bar: [f64; 2],
    angle_deg: [f64; 2],
    torque_nm: [f64; 2],
    velocity_deg_s: [f64; 2],
    voltage_v: f64,
}

impl From<&Limits> for LimitsView {
    fn from(limits: &Limits) -> Self {
        let either_side = |most: f64| [-most, most];
        LimitsView {
            pressure_bar: [limits.pressure_min_bar, limits.pressure_max_bar],
            angle_deg: either_side(limits.angle_max_deg),
            torque_nm: either_side(limits.torque_max_nm),
            velocity_deg_s: either_side(limits.velocity_max_deg_s),
            voltage_v: limits.voltage_max_v,
        }
    }
}

/// A run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Run {
    /// As the service counts.
    pub number: u32,
    /// Started by the service.
    pub own: bool,
    /// Over.
    pub ended: bool,
    /// Empty where it is not known.
    pub name: String,
    /// The campaign format's word.
    pub protocol: Option<String>,
    /// The campaign format's word.
    pub role: Option<String>,
    /// The campaign format's word.
    pub plane: Option<String>,
    /// Of its random steps.
    pub seed: Option<u64>,
    /// Newest tick.
    pub tick: u64,
    /// Of the newest tick, s.
    pub time_s: f64,
    /// At most, s.
    pub duration_s: Option<f64>,
    /// At most, s.
    pub remaining_s: Option<f64>,
    /// When tick 0 was due, ms since 1970.
    pub origin_utc_ms: Option<f64>,
    /// Where the script is.
    pub step: Option<Step>,
    /// Segment of the protocol.
    pub segment: u32,
    /// `ok`, `waiting`, `stopped`, `tripped`.
    pub supervisor: &'static str,
    /// Why it tripped.
    pub trip: Option<String>,
    /// That came.
    pub samples: u64,
    /// That did not come to the service.
    pub missed: u64,
    /// Ticks that the loop passed over.
    pub skipped: u64,
    /// What people are asked for.
    pub waiting: Option<Waiting>,
}

/// A step of the script.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Step {
    /// As in the samples.
    pub index: u32,
    /// As written.
    pub text: String,
}

/// What people are asked for.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Waiting {
    /// Its number.
    pub request: u32,
    /// In words.
    pub text: String,
    /// `volume_ml` where an amount is asked for.
    pub amount: Option<&'static str>,
}

/// The last run of the queue that ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Last {
    /// Of its recording.
    pub id: Option<String>,
    /// Of its profile.
    pub name: String,
    /// How it ended.
    pub outcome: &'static str,
    /// What it said at its end.
    pub text: String,
}

/// Signs of life of the device, at one sample.
#[derive(Clone, Debug, Serialize)]
pub struct Link {
    heartbeat_age_ms: f64,
    ages_ms: BTreeMap<&'static str, Option<f64>>,
    valid: BTreeMap<&'static str, bool>,
}

const INPUTS: [&str; 5] = ["angle", "pressure1", "pressure2", "torque", "volume"];

impl From<&Sample> for Link {
    fn from(sample: &Sample) -> Self {
        let measured = sample.measurement();
        let of_input = || Input::ALL.into_iter().map(|input| (INPUTS[input as usize], input));
        let age = |input: Input| f64::from(measured.age_ns[input as usize]) * 1e-6;
        Link {
            heartbeat_age_ms: f64::from(sample.heartbeat_age_ns) * 1e-6,
            ages_ms: of_input()
                .map(|(name, input)| (name, measured.value(input).is_finite().then(|| age(input))))
                .collect(),
            valid: of_input().map(|(name, input)| (name, measured.is_valid(input))).collect(),
        }
    }
}

/// How the supervisor stands at a sample.
pub fn supervisor(sample: &Sample) -> &'static str {
    if sample.tripped() {
        "tripped"
    } else if sample.flags & flags::STOPPED != 0 {
        "stopped"
    } else if sample.waiting() {
        "waiting"
    } else {
        "ok"
    }
}

/// Why the supervisor tripped, as far as a sample tells.
pub fn trip_reason(sample: &Sample) -> Option<String> {
    let channel = Channel::of_code(sample.trip)?;
    let how = match sample.trip >> 8 {
        1 => "below its limit",
        2 if channel == Channel::Deadline => "missed",
        2 => "above its limit",
        3 => "not a finite number",
        4 => "missing",
        5 => "too old",
        _ => "",
    };
    Some(format!("{} {how}", channel.name()).trim_end().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::{Breach, Trip};

    #[test]
    fn every_trip_has_its_words() {
        let words = |channel, breach| {
            let trip = Trip { tick: 0, channel, value: 0.0, breach };
            trip_reason(&Sample { trip: trip.code(), ..Sample::BLANK })
        };
        let some = |text: &str| Some(text.to_owned());
        assert_eq!(words(Channel::Pressure1, Breach::Above(8.0)), some("pressure 1 above its limit"));
        assert_eq!(words(Channel::Pressure2, Breach::Below(0.5)), some("pressure 2 below its limit"));
        assert_eq!(words(Channel::Deadline, Breach::Above(1.0)), some("deadline missed"));
        assert_eq!(words(Channel::Angle, Breach::Missing(20)), some("angle missing"));
        assert_eq!(words(Channel::Heartbeat, Breach::Stale(100.0)), some("heartbeat of the drivers too old"));
        assert_eq!(words(Channel::Voltage, Breach::NotFinite), some("voltage not a finite number"));
        assert_eq!(words(Channel::EmergencyStop, Breach::Demanded), some("emergency stop"));
        assert_eq!(trip_reason(&Sample::BLANK), None);
    }

    #[test]
    fn what_is_not_measured_has_no_age_and_is_not_valid() {
        let sample = Sample { angle_deg: 3.0, age_ns: [2_000_000; 5], quality: 1, ..Sample::BLANK };
        let link = serde_json::to_value(Link::from(&sample)).expect("JSON");
        assert_eq!(link["ages_ms"]["angle"], 2.0);
        assert!(link["ages_ms"]["torque"].is_null());
        assert_eq!((&link["valid"]["angle"], &link["valid"]["torque"]), (&true.into(), &false.into()));
    }
}
