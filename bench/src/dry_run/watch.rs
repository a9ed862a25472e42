//! What a dry run takes down: the peaks, when each step was played, and where the limits in force would have been broken.

use super::{Extreme, Peak, Played};
use rt_core::{
    Channel, Command, Demand, Device, DeviceError, Handover, Measurement, Publish, Sample, Supervisor, Tick, Trip,
};
use std::cell::RefCell;

/// The channels of the peaks, in their order.
const WATCHED: [Channel; 6] =
    [Channel::Pressure1, Channel::Pressure2, Channel::Angle, Channel::Velocity, Channel::Torque, Channel::Voltage];

/// Listens to the loop from both ends: to its device, and to what it publishes.
pub(super) struct Watch {
    /// With the limits in force. It sees what the one that drives sees, and decides nothing.
    supervisor: Supervisor,
    peaks: [Option<Peak>; WATCHED.len()],
    pub played: Vec<Played>,
    /// The would-be trip, and the step that led to it.
    pub trip: Option<(Trip, u32)>,
    pub ticks: u64,
    /// Every sample, where they are kept.
    pub samples: Option<Vec<Sample>>,
}

impl Watch {
    pub fn new(mut supervisor: Supervisor) -> Self {
        supervisor.begin_run();
        Watch { supervisor, peaks: [None; WATCHED.len()], played: Vec::new(), trip: None, ticks: 0, samples: None }
    }

    pub fn peaks(&self) -> Vec<Peak> {
        self.peaks.iter().flatten().copied().collect()
    }

    /// The step whose command acts while a measurement is taken.
    fn acting(&self) -> u32 {
        self.played.last().map_or(0, |played| played.step)
    }

    fn read(&mut self, now: Tick, measured: &Measurement) {
        self.supervisor.check(now, Demand::None, measured);
        self.note_trip(self.acting());
        let values = [
            measured.pressure1_bar,
            measured.pressure2_bar,
            measured.angle_deg,
            self.supervisor.velocity_deg_s().unwrap_or(f64::NAN),
            measured.torque_nm,
        ];
        let step = self.acting();
        for (place, value) in values.into_iter().enumerate() {
            self.peak(place, Extreme { value, tick: now.index, step });
        }
    }

    fn written(&mut self, now: Tick, command: &Command) {
        // Its answer is not used: where it has tripped, it is the safe state.
        self.supervisor.release(now, *command);
    }

    fn published(&mut self, sample: &Sample) {
        let Sample { tick, step, .. } = *sample;
        self.note_trip(step);
        self.peak(WATCHED.len() - 1, Extreme { value: sample.voltage_v, tick, step });
        self.ticks = tick + 1;
        if let Some(samples) = &mut self.samples {
            samples.push(*sample);
        }
        match self.played.last_mut() {
            Some(last) if last.step == step => last.ticks = tick + 1 - last.tick,
            _ => self.played.push(Played { step, tick, ticks: 1 }),
        }
    }

    fn note_trip(&mut self, step: u32) {
        if self.trip.is_none() {
            self.trip = self.supervisor.trip().map(|trip| (*trip, step));
        }
    }

    fn peak(&mut self, place: usize, seen: Extreme) {
        if seen.value.is_nan() {
            return;
        }
        let channel = WATCHED[place];
        let peak = self.peaks[place].get_or_insert(Peak { channel, least: seen, most: seen });
        if seen.value < peak.least.value {
            peak.least = seen;
        }
        if seen.value > peak.most.value {
            peak.most = seen;
        }
    }
}

/// The device with a watch beside it.
pub(super) struct Watched<'a, D> {
    pub device: D,
    pub watch: &'a RefCell<Watch>,
}

impl<D: Device> Device for Watched<'_, D> {
    fn begin_run(&mut self, origin_ns: u64) {
        self.device.begin_run(origin_ns);
    }

    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let measured = self.device.read(now)?;
        self.watch.borrow_mut().read(now, &measured);
        Ok(measured)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.watch.borrow_mut().written(now, command);
        self.device.write(now, command)
    }

    fn end_run(&mut self) -> Result<(), DeviceError> {
        self.device.end_run()
    }
}

/// Hears the samples.
pub(super) struct Heard<'a>(pub &'a RefCell<Watch>);

impl Publish for Heard<'_> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        self.0.borrow_mut().published(sample);
        Handover::Taken
    }
}
