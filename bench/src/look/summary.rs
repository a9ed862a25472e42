//! What one recording holds, in one pass and bounded memory, and whether it is good.

use super::curve::Curve;
use crate::exchange::content::severity;
use hdrhistogram::Histogram;
use recordings::{AmplifierReport, CampaignError, Event, Item, McapReader, RunMetadata, Severity};
use rt_core::{Channel as TripChannel, LossCertificate, Sample};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Lateness beyond this counts as this, ns.
const LATEST_NS: u64 = 3_600_000_000_000;
/// Events that are kept one by one; the others are counted.
const EVENTS_KEPT: usize = 200;

/// See the module.
pub struct Summary {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// What it says of its run.
    pub run: RunMetadata,
    /// Its certificate, where it was closed and is sound.
    pub certificate: Option<LossCertificate>,
    /// What kept it from being read to its end.
    pub trouble: Option<String>,
    /// Samples that were read.
    pub samples: u64,
    /// Scheduled time of the first and the last of them, s.
    pub span_s: Option<(f64, f64)>,
    /// Voltage and what is measured.
    pub channels: Vec<Channel>,
    /// Different segments.
    pub segments: usize,
    /// Different steps of the profile.
    pub steps: usize,
    /// Of the wake-ups, ns.
    pub lateness_ns: Histogram<u64>,
    /// Ticks that the loop passed over.
    pub skipped: u64,
    /// Ticks after one that ended too late.
    pub overruns: u64,
    /// Ticks in which the device failed.
    pub faults: u64,
    /// Ticks in which the run waited for a person.
    pub waiting: u64,
    /// When the supervisor tripped, s, and over what.
    pub tripped: Option<(f64, &'static str)>,
    /// When a stop was asked for, s.
    pub stopped_s: Option<f64>,
    /// The run's last sample is there.
    pub ended: bool,
    /// Events, the first ones.
    pub events: Vec<Event>,
    /// All events, by severity: info, warning, error.
    pub event_counts: [u64; 3],
    /// Reports of the amplifier.
    pub reports: u64,
    /// What it told: name, unit, lowest, highest.
    pub amplifier: Vec<Channel>,
}

/// A channel of a recording.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Name with the unit in it.
    pub name: &'static str,
    /// Values that are there.
    pub count: u64,
    /// Lowest of them.
    pub low: f64,
    /// Highest of them.
    pub high: f64,
    sum: f64,
    /// Their course.
    pub curve: Curve,
}

impl Channel {
    fn new(name: &'static str) -> Channel {
        Channel { name, count: 0, low: f64::NAN, high: f64::NAN, sum: 0.0, curve: Curve::default() }
    }

    fn push(&mut self, time_s: f64, value: f64) {
        self.curve.push(time_s, value);
        if value.is_finite() {
            self.count += 1;
            self.sum += value;
            self.low = self.low.min(value);
            self.high = self.high.max(value);
        }
    }

    /// Their mean; NaN: there are none.
    pub fn mean(&self) -> f64 {
        self.sum / self.count as f64
    }
}

const CHANNELS: [&str; 6] = ["voltage_v", "angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml"];
const AMPLIFIER: [&str; 5] = ["supply_v", "motor_current_a", "speed_rpm", "duty", "temperature_c"];

impl Summary {
    /// Reads a recording, closed or not, as far as it is sound.
    ///
    /// # Errors
    /// It can't be opened, or is no recording of this project's format.
    pub fn read(path: &Path) -> Result<Summary, CampaignError> {
        let mut reader = McapReader::open(path)?;
        let mut summary = Summary {
            path: path.to_owned(),
            bytes: path.metadata().map_or(0, |metadata| metadata.len()),
            run: reader.run().clone(),
            certificate: None,
            trouble: None,
            samples: 0,
            span_s: None,
            channels: CHANNELS.map(Channel::new).to_vec(),
            segments: 0,
            steps: 0,
            lateness_ns: Histogram::new_with_max(LATEST_NS, 3)
                .expect("digits and highest value are within what it can hold"),
            skipped: 0,
            overruns: 0,
            faults: 0,
            waiting: 0,
            tripped: None,
            stopped_s: None,
            ended: false,
            events: Vec::new(),
            event_counts: [0; 3],
            reports: 0,
            amplifier: AMPLIFIER.map(Channel::new).to_vec(),
        };
        let (mut segments, mut steps) = (BTreeSet::new(), BTreeSet::new());
        for item in &mut reader {
            match item {
                Ok(Item::Sample(sample)) => {
                    segments.insert(sample.segment);
                    steps.insert(sample.step);
                    summary.sample(&sample);
                }
                Ok(Item::Event(event)) => summary.event(event),
                Ok(Item::Amplifier(report)) => summary.report(&report),
                Err(error) => summary.trouble = Some(error.to_string()),
            }
        }
        (summary.segments, summary.steps) = (segments.len(), steps.len());
        summary.certificate = reader.certificate().cloned();
        Ok(summary)
    }

    fn sample(&mut self, sample: &Sample) {
        let time_s = sample.time_s();
        self.samples += 1;
        self.span_s = Some((self.span_s.map_or(time_s, |(first_s, _)| first_s), time_s));
        let measured = sample.measurement();
        let values = [
            sample.voltage_v,
            measured.angle_deg,
            measured.pressure1_bar,
            measured.pressure2_bar,
            measured.torque_nm,
            measured.volume_ml,
        ];
        self.channels.iter_mut().zip(values).for_each(|(channel, value)| channel.push(time_s, value));
        // A value beyond the histogram's range counts as its highest.
        self.lateness_ns.saturating_record(sample.lateness_ns);
        self.skipped = sample.skipped;
        self.overruns += u64::from(sample.overrun());
        self.faults += u64::from(sample.fault());
        self.waiting += u64::from(sample.flags & rt_core::flags::WAITING != 0);
        if sample.tripped() && self.tripped.is_none() {
            self.tripped = Some((
                time_s,
                TripChannel::of_code(sample.trip).map_or("its reason is not recorded", TripChannel::name),
            ));
        }
        if sample.flags & rt_core::flags::STOPPED != 0 && self.stopped_s.is_none() {
            self.stopped_s = Some(time_s);
        }
        self.ended |= sample.last();
    }

    fn event(&mut self, event: Event) {
        let count = match event.severity {
            Severity::Info => 0,
            Severity::Warning => 1,
            Severity::Error => 2,
        };
        self.event_counts[count] += 1;
        if self.events.len() < EVENTS_KEPT {
            self.events.push(event);
        }
    }

    fn report(&mut self, report: &AmplifierReport) {
        self.reports += 1;
        let time_s = report.arrived_ns as f64 * 1e-9;
        let AmplifierReport { supply_v, motor_current_a, speed_rpm, duty, temperature_c, .. } = *report;
        let values = [supply_v, motor_current_a, speed_rpm, duty, temperature_c];
        self.amplifier.iter_mut().zip(values).for_each(|(channel, value)| channel.push(time_s, value));
    }

    /// From the first sample to the last, s.
    pub fn duration_s(&self) -> f64 {
        self.span_s.map_or(0.0, |(first_s, last_s)| last_s - first_s)
    }

    /// Samples a second, over the whole run; `None`: there are not two.
    pub fn rate_hz(&self) -> Option<f64> {
        (self.samples > 1).then(|| (self.samples - 1) as f64 / self.duration_s())
    }

    /// The events' time, severity, source and text.
    pub fn event_rows(&self) -> impl Iterator<Item = (f64, &'static str, &str, &str)> {
        let row = |event: &'_ Event| (event.scheduled_ns as f64 * 1e-9, severity(event.severity));
        self.events.iter().map(move |event| {
            let (time_s, word) = row(event);
            (time_s, word, event.source.as_str(), event.text.as_str())
        })
    }

    /// What speaks against the recording, with what to do; empty: it is good.
    pub fn faults_found(&self) -> Vec<String> {
        let mut found = Vec::new();
        let part = self.path.extension().is_some_and(|extension| extension == "part");
        let recover = format!("`bench recover {}` saves what is sound", self.path.display());
        if part {
            found.push(format!("unfinished: it was never closed; if no run is under way, {recover}"));
        } else if let Some(trouble) = &self.trouble {
            found.push(format!("damaged: {trouble}"));
        }
        if self.samples == 0 {
            found.push("empty: it holds no sample; record the run again".to_owned());
        }
        if let Some(certificate) = self.certificate.as_ref().filter(|certificate| !certificate.is_lossless()) {
            found.push(format!("lossy: {certificate}; no model can be fitted to it, record the run again"));
        }
        if let Some((time_s, reason)) = self.tripped {
            found.push(format!("tripped: the supervisor ended it at {time_s:.3} s ({reason})"));
        }
        if let Some(time_s) = self.stopped_s {
            found.push(format!("stopped: somebody asked for it at {time_s:.3} s"));
        }
        if self.faults > 0 {
            found.push(format!("device: it failed in {} ticks", self.faults));
        }
        found
    }
}
