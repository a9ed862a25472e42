//! Values back to when they were measured. A sample holds what was known at its tick, with the age of each value; a row of a recording
//! holds the state at its time. Where every age is 0 (a device that measures at the tick itself) nothing changes, bit for bit.

use rt_core::{Input, Measurement, Sample};

use crate::Recording;

/// Between two readings further apart than this nothing is interpolated, ns.
const LONGEST_GAP_NS: i64 = 20_000_000;

/// When a value was measured, since the run's start (negative: before it), and the value; NaN = there was none.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    at_ns: i64,
    value: f64,
}

/// The readings of a run, input by input, as its samples come.
#[derive(Default)]
pub(crate) struct Alignment {
    readings: [Vec<Reading>; 5],
    row_ns: Vec<i64>,
    aged: bool,
}

impl Alignment {
    /// Takes the sample of the next row.
    pub fn push(&mut self, sample: &Sample) {
        let scheduled_ns = i64::try_from(sample.scheduled_ns).unwrap_or(i64::MAX);
        self.row_ns.push(scheduled_ns);
        let measured = sound(sample);
        for input in Input::ALL {
            let age_ns = sample.age_ns[input as usize];
            self.aged |= age_ns != 0;
            // An age beyond what the field holds is none.
            let value = if age_ns == u32::MAX { f64::NAN } else { measured.value(input) };
            let reading = Reading { at_ns: scheduled_ns - i64::from(age_ns), value };
            let readings = &mut self.readings[input as usize];
            match readings.last_mut() {
                // The same reading, seen again; a fault of the sensor may be known only then.
                Some(last) if reading.at_ns == last.at_ns => *last = reading,
                // An older one does not come after a newer.
                Some(last) if reading.at_ns < last.at_ns => {}
                _ => readings.push(reading),
            }
        }
    }

    /// Puts the values in `recording`, whose rows are the samples, back to their times. The last rows, whose state was not yet measured
    /// when the run ended, are taken off.
    pub fn apply(self, recording: &mut Recording) {
        if !self.aged {
            return;
        }
        let Alignment { readings, row_ns, .. } = self;
        let Recording { angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, .. } = recording;
        let columns = [angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml];
        for ((input, readings), column) in Input::ALL.into_iter().zip(&readings).zip(columns) {
            *column = match input {
                // What a person reads off a cylinder is no signal that goes on between two readings.
                Input::Volume => nearest(readings, &row_ns),
                _ => interpolated(readings, &row_ns),
            };
        }
        let measured = |row: &usize| recording.measured().iter().any(|(_, values)| values[*row].is_finite());
        let rows = (0..row_ns.len()).rev().find(measured).map_or(0, |last| last + 1);
        recording.truncate(rows);
    }
}

/// What a sample's row holds: what its device does not call wrong.
pub(crate) fn sound(sample: &Sample) -> Measurement {
    let mut measured = sample.measurement();
    for input in Input::ALL {
        if measured.faulty & input.bit() != 0 {
            let Measurement { angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, .. } = &mut measured;
            *[angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml][input as usize] = f64::NAN;
        }
    }
    measured
}

fn interpolated(readings: &[Reading], row_ns: &[i64]) -> Vec<f64> {
    let mut next = 0;
    let at = |&row_ns: &i64| {
        while next < readings.len() && readings[next].at_ns <= row_ns {
            next += 1;
        }
        let Some(before) = next.checked_sub(1).map(|last| readings[last]) else { return f64::NAN };
        match readings.get(next) {
            _ if before.at_ns == row_ns => before.value,
            Some(after) if after.at_ns - before.at_ns <= LONGEST_GAP_NS => {
                let share = (row_ns - before.at_ns) as f64 / (after.at_ns - before.at_ns) as f64;
                before.value + share * (after.value - before.value)
            }
            _ => f64::NAN,
        }
    };
    row_ns.iter().map(at).collect()
}

/// Each reading in the row that is nearest to it in time.
fn nearest(readings: &[Reading], row_ns: &[i64]) -> Vec<f64> {
    let mut values = vec![f64::NAN; row_ns.len()];
    for reading in readings.iter().filter(|reading| reading.value.is_finite()) {
        let after = row_ns.partition_point(|&row| row < reading.at_ns);
        let candidates = [after.checked_sub(1), (after < row_ns.len()).then_some(after)];
        let distance = |row: &usize| (row_ns[*row] - reading.at_ns).abs();
        if let Some(row) = candidates.into_iter().flatten().min_by_key(distance) {
            values[row] = reading.value;
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::PERIOD_NS;

    /// A run whose angle at time t is `angle(t)`, read at every tick with this age.
    fn run(ticks: u64, age_ns: impl Fn(u64) -> u32, angle: impl Fn(f64) -> f64) -> Recording {
        let (mut recording, mut alignment) = (Recording::default(), Alignment::default());
        for tick in 0..ticks {
            let scheduled_ns = tick * PERIOD_NS;
            let age = age_ns(tick);
            let angle_deg = angle((scheduled_ns as f64 - f64::from(age)) * 1e-9);
            let sample = Sample {
                tick,
                scheduled_ns,
                voltage_v: tick as f64,
                angle_deg,
                pressure1_bar: 2.0,
                pressure2_bar: f64::NAN,
                torque_nm: f64::NAN,
                volume_ml: if tick == 7 { 3.5 } else { f64::NAN },
                age_ns: [age; 5],
                quality: rt_core::Input::Angle.bit(),
                ..Sample::BLANK
            };
            recording.push_sample(&sample);
            alignment.push(&sample);
        }
        alignment.apply(&mut recording);
        recording
    }

    #[test]
    fn values_of_age_zero_stay_as_they_are() {
        let recording = run(20, |_| 0, f64::sin);
        assert_eq!(recording.len(), 20);
        assert!(recording.time_s.iter().zip(&recording.angle_deg).all(|(t, angle)| (angle - t.sin()).abs() < 1e-15));
    }

    #[test]
    fn a_constant_age_of_whole_ticks_is_a_shift_and_costs_the_last_rows() {
        let recording = run(20, |_| 2 * PERIOD_NS as u32, |t| 3.0 * t + 1.0);
        assert_eq!((recording.len(), recording.voltage_v.len(), recording.segment.len()), (18, 18, 18));
        for (row, angle) in recording.angle_deg.iter().enumerate() {
            assert_eq!(*angle, 3.0 * (row as f64 * PERIOD_NS as f64 * 1e-9) + 1.0);
            assert_eq!(recording.voltage_v[row], row as f64, "the command acts at its own time");
        }
        assert_eq!(recording.volume_ml.iter().position(|volume| volume.is_finite()), Some(5));
    }

    #[test]
    fn ages_that_wander_are_put_right_between_two_readings() {
        let recording = run(200, |tick| 200_000 + (tick % 7) as u32 * 130_000, |t| 40.0 * t - 1.0);
        for (time_s, angle) in recording.time_s.iter().zip(&recording.angle_deg) {
            assert!((angle - (40.0 * time_s - 1.0)).abs() < 1e-9, "{time_s}: {angle}");
        }
        assert!(recording.len() >= 198);
    }

    #[test]
    fn over_a_silence_nothing_is_invented() {
        // From tick 50 to 89 the last value only grows older.
        let stale =
            |tick: u64| if (50..90).contains(&tick) { ((tick - 50) * PERIOD_NS) as u32 + 1_000_000 } else { 1_000_000 };
        let recording = run(120, stale, |t| t);
        let missing: Vec<usize> = (0..recording.len()).filter(|&row| recording.angle_deg[row].is_nan()).collect();
        assert_eq!(missing, (50..89).collect::<Vec<_>>());
    }

    #[test]
    fn what_the_device_calls_wrong_is_missing() {
        let mut alignment = Alignment::default();
        let mut recording = Recording::default();
        for tick in 0..4u64 {
            let quality = if tick == 2 { Input::Angle.bit() << 8 } else { Input::Angle.bit() };
            let sample = Sample {
                tick,
                scheduled_ns: tick * PERIOD_NS,
                angle_deg: 5.0,
                pressure1_bar: 2.0,
                age_ns: [PERIOD_NS as u32; 5],
                quality,
                ..Sample::BLANK
            };
            recording.push_sample(&sample);
            alignment.push(&sample);
        }
        alignment.apply(&mut recording);
        assert_eq!(recording.angle_deg.iter().map(|angle| angle.is_nan()).collect::<Vec<_>>(), [false, true, false]);
    }
}
