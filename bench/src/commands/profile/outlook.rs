//! What a profile would do, as data.

use crate::dry_run::{Extreme, Peak, Prediction};
use profiles::{Hands, Place, Playback, Script};
use rt_core::{Limits, Tick};
use serde::Serialize;
use std::collections::BTreeMap;

/// Of a profile that fits the rig.
#[derive(Debug, Serialize)]
pub(super) struct Outlook {
    pub name: String,
    pub protocol: &'static str,
    pub role: &'static str,
    pub plane: &'static str,
    pub about: String,
    /// What follows a missed deadline.
    pub overrun: &'static str,
    /// The steps as they are written.
    pub steps: Vec<Step>,
    /// What people prepare before the run; none where the rig does it itself.
    pub preparation: Option<String>,
    /// What people are asked for at most, in order; none where the rig does it itself.
    pub requests: Vec<Asked>,
    /// Who does the operator's part: `rig` or `people`.
    pub hands: &'static str,
    /// Faults that the script injects.
    pub faults: usize,
    /// Without the time that people take, s: whatever is waited for is there at once, and as late as it may be.
    pub shortest_s: f64,
    pub longest_s: f64,
    pub limits: InForce,
    /// None without a model.
    pub dry_run: Option<DryRun>,
}

#[derive(Debug, Serialize)]
pub(super) struct Step {
    pub line: usize,
    pub depth: usize,
    pub what: String,
    pub ends: String,
    #[serde(skip_serializing_if = "String::is_empty")]
    pub operator: String,
    /// How often the dry run came by, and for how long together, s; none for a loop and without a model.
    pub passes: Option<u64>,
    pub time_s: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(super) struct Asked {
    #[serde(flatten)]
    pub place: At,
    pub text: String,
    /// It must be confirmed with a number.
    pub amount: bool,
}

/// Where a step is written.
#[derive(Debug, Serialize)]
pub(super) struct At {
    pub line: usize,
    /// The loops around it, with their variables; may be empty.
    pub with: String,
}

/// What the supervisor would enforce, the script's envelope included.
#[derive(Debug, Serialize)]
pub(super) struct InForce {
    pub pressure_min_bar: f64,
    pub pressure_max_bar: f64,
    pub angle_max_deg: f64,
    pub velocity_max_deg_s: f64,
    pub torque_max_nm: f64,
    pub voltage_max_v: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct DryRun {
    /// Where the model is from.
    pub model: String,
    pub duration_s: f64,
    pub peaks: Vec<PeakOf>,
    pub timeouts: Vec<Struck>,
    /// Of steps that drive the pump until people confirm: for how long they are predicted.
    pub remarks: Vec<String>,
    pub trip: Option<Trips>,
    /// Why the rig failed before the script's end.
    pub failed: Option<String>,
}

#[derive(Debug, Serialize)]
pub(super) struct PeakOf {
    pub channel: &'static str,
    pub unit: &'static str,
    pub least: Value,
    pub most: Value,
    pub limit_low: f64,
    pub limit_high: f64,
    /// What is left to the nearer limit, % of that limit; negative beyond it.
    pub margin_percent: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Value {
    pub value: f64,
    pub time_s: f64,
    #[serde(flatten)]
    pub place: At,
}

#[derive(Debug, Serialize)]
pub(super) struct Struck {
    pub time_s: f64,
    #[serde(flatten)]
    pub place: At,
    pub message: String,
}

#[derive(Debug, Serialize)]
pub(super) struct Trips {
    pub tick: u64,
    pub time_s: f64,
    #[serde(flatten)]
    pub place: At,
    pub message: String,
}

impl From<Option<Place>> for At {
    fn from(place: Option<Place>) -> Self {
        place.map_or(At { line: 0, with: String::new() }, |Place { line, with }| At { line, with })
    }
}

impl Outlook {
    pub fn new(script: &Script, playback: &Playback, hands: Hands, limits: Limits) -> Self {
        let steps = script.outline().into_iter().map(|row| Step {
            line: row.line,
            depth: row.depth,
            what: row.what,
            ends: row.ends,
            operator: row.operator,
            passes: None,
            time_s: None,
        });
        let requests = playback.requests().iter().map(|request| Asked {
            place: playback.place(request.step).into(),
            text: request.text.clone(),
            amount: request.amount.is_some(),
        });
        Outlook {
            name: script.name.clone(),
            protocol: script.protocol.as_str(),
            role: script.role.as_str(),
            plane: script.plane.as_str(),
            about: script.about.clone(),
            overrun: script.overrun.as_str(),
            steps: steps.collect(),
            preparation: (hands == Hands::People).then(|| script.preparation()),
            requests: requests.collect(),
            hands: hands.as_str(),
            faults: script.faults.len(),
            shortest_s: script.duration_least_s(),
            longest_s: script.duration_bound_s(),
            limits: InForce {
                pressure_min_bar: limits.pressure_min_bar,
                pressure_max_bar: limits.pressure_max_bar,
                angle_max_deg: limits.angle_max_deg,
                velocity_max_deg_s: limits.velocity_max_deg_s,
                torque_max_nm: limits.torque_max_nm,
                voltage_max_v: limits.voltage_max_v,
            },
            dry_run: None,
        }
    }

    /// With what was predicted by the model from `source`.
    pub fn with(mut self, playback: &Playback, prediction: &Prediction, source: String) -> Self {
        let mut by_line: BTreeMap<usize, (u64, u64)> = BTreeMap::new();
        for played in &prediction.played {
            if let Some(place) = playback.place(played.step) {
                let (passes, ticks) = by_line.entry(place.line).or_default();
                *passes += 1;
                *ticks += played.ticks;
            }
        }
        for step in self.steps.iter_mut().filter(|step| !step.ends.is_empty()) {
            let (passes, ticks) = by_line.get(&step.line).copied().unwrap_or_default();
            step.passes = Some(passes);
            step.time_s = Some(Tick::at(ticks).seconds());
        }
        let value = |seen: &Extreme| Value {
            value: seen.value,
            time_s: Tick::at(seen.tick).seconds(),
            place: playback.place(seen.step).into(),
        };
        let peak = |peak: &Peak| {
            let (limit_low, limit_high) = prediction.limit(peak.channel)?;
            Some(PeakOf {
                channel: peak.channel.name(),
                unit: peak.channel.unit(),
                least: value(&peak.least),
                most: value(&peak.most),
                limit_low,
                limit_high,
                margin_percent: 100.0 * prediction.margin(peak)?,
            })
        };
        self.dry_run = Some(DryRun {
            model: source,
            duration_s: prediction.duration_s(),
            peaks: prediction.peaks.iter().filter_map(peak).collect(),
            timeouts: prediction
                .timeouts
                .iter()
                .map(|timeout| Struck {
                    time_s: Tick::at(timeout.tick).seconds(),
                    place: Some(timeout.place.clone()).into(),
                    message: timeout.to_string(),
                })
                .collect(),
            remarks: prediction.remarks(),
            trip: prediction.trip.as_ref().map(|trips| Trips {
                tick: trips.trip.tick,
                time_s: Tick::at(trips.trip.tick).seconds(),
                place: Some(trips.place.clone()).into(),
                message: trips.trip.to_string(),
            }),
            failed: prediction.failed.clone(),
        });
        self
    }
}
