//! Values back to when they were measured. A sample holds what was known at its tick, with the age of each value; a row of a recording
//! holds the state at its time. Where every age is 0 (a device that measures at the tick itself) nothing changes, bit for bit.
//!
//! It goes by blocks of rows. A row is given once nothing that may still come can change it: an age is a number of 32 bits, 4.3 s at
//! most, so no later sample speaks of an earlier time than that.

use rt_core::{Input, Measurement, Sample};

use crate::Recording;

/// Between two readings further apart than this nothing is interpolated, ns.
const LONGEST_GAP_NS: i64 = 20_000_000;
/// After this much scheduled time no sample can change a row any more, ns: the greatest age, and the reading after the row.
const LOOK_AHEAD_NS: i64 = u32::MAX as i64 + LONGEST_GAP_NS;
/// Rows of a block at most.
pub(crate) const BLOCK_ROWS: usize = 4096;

/// When a value was measured, since the run's start (negative: before it), and the value; NaN = there was none.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    at_ns: i64,
    value: f64,
}

/// Makes rows of samples. Memory holds the rows of the look-ahead and a block.
#[derive(Default)]
pub(crate) struct Alignment {
    /// Rows that were not given yet, as their samples have them.
    rows: Recording,
    /// Their times.
    row_ns: Vec<i64>,
    /// Readings of each input that rows to come may need, in the order of their times. Filled from the first age on.
    readings: [Vec<Reading>; 5],
    /// Some age was not 0.
    aged: bool,
}

impl Alignment {
    /// Whether the rows up to now were put back at all.
    pub fn aged(&self) -> bool {
        self.aged
    }

    /// Takes the sample of the next row. Gives a block of rows when there is one.
    #[inline]
    pub fn push(&mut self, sample: &Sample) -> Option<Recording> {
        let scheduled_ns = i64::try_from(sample.scheduled_ns).unwrap_or(i64::MAX);
        let mut measured = sound(sample);
        if !self.aged && sample.age_ns != [0; 5] {
            self.first_age();
        }
        self.row_ns.push(scheduled_ns);
        if !self.aged {
            self.rows.push_sample(sample, &measured);
            // The last row stays: a sample to come may speak of it again.
            return (self.row_ns.len() > BLOCK_ROWS).then(|| self.take(BLOCK_ROWS));
        }
        for input in Input::ALL {
            let age_ns = sample.age_ns[input as usize];
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
        // What was read off is put where it belongs when the rows are given.
        measured.volume_ml = f64::NAN;
        self.rows.push_sample(sample, &measured);
        let settled = self.row_ns.get(BLOCK_ROWS).is_some_and(|next| *next <= scheduled_ns - LOOK_AHEAD_NS);
        settled.then(|| self.give(BLOCK_ROWS))
    }

    /// The next rows of those that are left when no sample is to come; none when there are none.
    pub fn rest(&mut self) -> Option<Recording> {
        let rows = self.row_ns.len().min(BLOCK_ROWS);
        if rows == 0 {
            return None;
        }
        Some(if self.aged { self.give(rows) } else { self.take(rows) })
    }

    /// From here on ages count. The rows that were not given yet were read at their own times.
    fn first_age(&mut self) {
        self.aged = true;
        for (readings, (_, values)) in self.readings.iter_mut().zip(self.rows.measured()) {
            readings.extend(self.row_ns.iter().zip(values).map(|(&at_ns, &value)| Reading { at_ns, value }));
        }
        self.rows.volume_ml.fill(f64::NAN);
    }

    /// The first rows, as they are.
    fn take(&mut self, rows: usize) -> Recording {
        self.row_ns.drain(..rows);
        let rest = self.rows.split_off(rows);
        std::mem::replace(&mut self.rows, rest)
    }

    /// The first rows, their values put back to their times. Whatever can change them is known.
    fn give(&mut self, rows: usize) -> Recording {
        let row_ns = &self.row_ns;
        let Recording { angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, .. } = &mut self.rows;
        for (input, column) in [
            (Input::Angle, angle_deg),
            (Input::Pressure1, pressure1_bar),
            (Input::Pressure2, pressure2_bar),
            (Input::Torque, torque_nm),
        ] {
            let readings = &mut self.readings[input as usize];
            let used = interpolate(readings, &row_ns[..rows], column);
            // The one before the next row stays.
            readings.drain(..used.saturating_sub(1));
        }
        // What a person reads off a cylinder is no signal that goes on between two readings.
        let readings = &mut self.readings[Input::Volume as usize];
        // Those up to the next row's time: the later ones may belong to later rows.
        let used = row_ns.get(rows).map_or(readings.len(), |next| readings.partition_point(|r| r.at_ns <= *next));
        to_nearest(&readings[..used], row_ns, volume_ml);
        readings.drain(..used);
        self.take(rows)
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

/// Puts the value at each row's time into `column`; says how many readings are not after the last row.
fn interpolate(readings: &[Reading], row_ns: &[i64], column: &mut [f64]) -> usize {
    let mut next = 0;
    for (row_ns, value) in row_ns.iter().zip(column) {
        while next < readings.len() && readings[next].at_ns <= *row_ns {
            next += 1;
        }
        let before = next.checked_sub(1).map(|last| readings[last]);
        *value = match (before, readings.get(next)) {
            (None, _) => f64::NAN,
            (Some(before), _) if before.at_ns == *row_ns => before.value,
            (Some(before), Some(after)) if after.at_ns - before.at_ns <= LONGEST_GAP_NS => {
                let share = (row_ns - before.at_ns) as f64 / (after.at_ns - before.at_ns) as f64;
                before.value + share * (after.value - before.value)
            }
            _ => f64::NAN,
        };
    }
    next
}

/// Each reading into the row that is nearest to it in time.
fn to_nearest(readings: &[Reading], row_ns: &[i64], column: &mut [f64]) {
    for reading in readings.iter().filter(|reading| reading.value.is_finite()) {
        let after = row_ns.partition_point(|&row| row < reading.at_ns);
        let candidates = [after.checked_sub(1), (after < row_ns.len()).then_some(after)];
        let distance = |row: &usize| (row_ns[*row] - reading.at_ns).abs();
        if let Some(row) = candidates.into_iter().flatten().min_by_key(distance) {
            column[row] = reading.value;
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test")]

    use super::*;
    use proptest::prelude::*;
    use rt_core::PERIOD_NS;

    /// The rows of a run, and in how many blocks they came.
    fn aligned(samples: &[Sample]) -> (Recording, usize) {
        let (mut recording, mut alignment, mut blocks) = (Recording::default(), Alignment::default(), 0);
        for sample in samples {
            if let Some(block) = alignment.push(sample) {
                recording.append(block);
                blocks += 1;
            }
            assert!(alignment.row_ns.len() <= BLOCK_ROWS + 4_400, "it looks ahead no further than it must");
        }
        while let Some(block) = alignment.rest() {
            recording.append(block);
            blocks += 1;
        }
        (recording, blocks)
    }

    /// The same with the whole run in memory, column by column: what the format says, told in another way.
    fn of_the_whole_run(samples: &[Sample]) -> [Vec<f64>; 5] {
        let row_ns: Vec<i64> = samples.iter().map(|sample| sample.scheduled_ns.cast_signed()).collect();
        Input::ALL.map(|input| {
            let value = |sample: &Sample| sound(sample).value(input);
            if samples.iter().all(|sample| sample.age_ns == [0; 5]) {
                return samples.iter().map(value).collect();
            }
            let mut readings: Vec<Reading> = Vec::new();
            for sample in samples {
                let age_ns = sample.age_ns[input as usize];
                let value = if age_ns == u32::MAX { f64::NAN } else { value(sample) };
                let reading = Reading { at_ns: sample.scheduled_ns.cast_signed() - i64::from(age_ns), value };
                match readings.last_mut() {
                    Some(last) if reading.at_ns == last.at_ns => *last = reading,
                    Some(last) if reading.at_ns < last.at_ns => {}
                    _ => readings.push(reading),
                }
            }
            let mut column = vec![f64::NAN; row_ns.len()];
            match input {
                Input::Volume => to_nearest(&readings, &row_ns, &mut column),
                _ => drop(interpolate(&readings, &row_ns, &mut column)),
            }
            column
        })
    }

    /// Runs as devices and their failures make them: ages that jitter, readings that are seen again and again, silences beyond the age
    /// that the field holds, ticks that were passed over, values that are called wrong later.
    fn runs() -> impl Strategy<Value = Vec<Sample>> {
        let shape = (any::<u64>(), 0..4u32, 0..3usize, prop_oneof![Just(0usize), Just(9_000), 0..9_000usize]);
        shape.prop_map(|(seed, jitter, steps, quiet_rows)| {
            let mut dice = seed | 1;
            let mut below = move |limit: u64| {
                dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (dice >> 33) % limit
            };
            let (mut tick, mut readings) = (0, [(0_u64, 0.0_f64); 5]);
            (0..if steps == 0 { 14_000 } else { 5_500 })
                .map(|row| {
                    tick += match steps {
                        1 => 1 + below(12),
                        2 if below(500) == 0 => 1 + below(6_000),
                        _ => 1,
                    };
                    let scheduled_ns = tick * PERIOD_NS;
                    let mut sample = Sample { tick, scheduled_ns, ..Sample::BLANK };
                    let values = [
                        &mut sample.angle_deg,
                        &mut sample.pressure1_bar,
                        &mut sample.pressure2_bar,
                        &mut sample.torque_nm,
                        &mut sample.volume_ml,
                    ];
                    for ((reading, value), age) in readings.iter_mut().zip(values).zip(&mut sample.age_ns) {
                        let aged = row >= quiet_rows && jitter > 0;
                        // Now and then a sensor falls silent for long.
                        if !aged || below(if jitter == 3 { 2_000 } else { 3 }) != 0 {
                            let behind_ns = if aged { below(1 + 700_000 * u64::from(jitter)) } else { 0 };
                            let missing = below(9) == 0;
                            *reading = (
                                scheduled_ns.saturating_sub(behind_ns),
                                if missing { f64::NAN } else { below(1 << 40) as f64 },
                            );
                        }
                        *age = u32::try_from(scheduled_ns - reading.0).unwrap_or(u32::MAX);
                        *value = reading.1;
                    }
                    if below(40) == 0 {
                        sample.quality = (below(32) as u32) << 8;
                    }
                    sample
                })
                .collect()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn block_by_block_gives_what_the_whole_run_gives(samples in runs()) {
            let (recording, blocks) = aligned(&samples);
            prop_assert!(blocks > 1 && recording.len() == samples.len());
            let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            for ((name, values), expected) in recording.measured().into_iter().zip(of_the_whole_run(&samples)) {
                prop_assert!(bits(values) == bits(&expected), "{}", name);
            }
        }
    }

    /// A run whose angle at time t is `angle(t)`, read at every tick with this age.
    fn run(ticks: u64, age_ns: impl Fn(u64) -> u32, angle: impl Fn(f64) -> f64) -> Recording {
        let sample = |tick: u64| {
            let scheduled_ns = tick * PERIOD_NS;
            let age = age_ns(tick);
            let angle_deg = angle((scheduled_ns as f64 - f64::from(age)) * 1e-9);
            Sample {
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
            }
        };
        aligned(&(0..ticks).map(sample).collect::<Vec<_>>()).0
    }

    #[test]
    fn values_of_age_zero_stay_as_they_are() {
        let recording = run(20, |_| 0, f64::sin);
        assert_eq!(recording.len(), 20);
        assert!(recording.time_s.iter().zip(&recording.angle_deg).all(|(t, angle)| (angle - t.sin()).abs() < 1e-15));
    }

    #[test]
    fn a_constant_age_of_whole_ticks_is_a_shift_and_leaves_the_last_rows_empty() {
        let recording = run(20, |_| 2 * PERIOD_NS as u32, |t| 3.0 * t + 1.0);
        assert!(recording.measured().iter().all(|(_, values)| values[18..].iter().all(|value| value.is_nan())));
        for (row, angle) in recording.angle_deg[..18].iter().enumerate() {
            assert_eq!(*angle, 3.0 * (row as f64 * PERIOD_NS as f64 * 1e-9) + 1.0);
            assert_eq!(recording.voltage_v[row], row as f64, "the command acts at its own time");
        }
        assert_eq!(recording.volume_ml.iter().position(|volume| volume.is_finite()), Some(5));
    }

    #[test]
    fn ages_that_wander_are_put_right_between_two_readings() {
        let recording = run(200, |tick| 200_000 + (tick % 7) as u32 * 130_000, |t| 40.0 * t - 1.0);
        for (time_s, angle) in recording.time_s.iter().zip(&recording.angle_deg).take(198) {
            assert!((angle - (40.0 * time_s - 1.0)).abs() < 1e-9, "{time_s}: {angle}");
        }
    }

    #[test]
    fn over_a_silence_nothing_is_invented() {
        // From tick 50 to 89 the last value only grows older.
        let stale =
            |tick: u64| if (50..90).contains(&tick) { ((tick - 50) * PERIOD_NS) as u32 + 1_000_000 } else { 1_000_000 };
        let recording = run(120, stale, |t| t);
        let missing: Vec<usize> = (0..119).filter(|&row| recording.angle_deg[row].is_nan()).collect();
        assert_eq!(missing, (50..89).collect::<Vec<_>>());
    }

    #[test]
    fn what_the_device_calls_wrong_is_missing() {
        let sample = |tick: u64| {
            let quality = if tick == 2 { Input::Angle.bit() << 8 } else { Input::Angle.bit() };
            Sample {
                tick,
                scheduled_ns: tick * PERIOD_NS,
                angle_deg: 5.0,
                pressure1_bar: 2.0,
                age_ns: [PERIOD_NS as u32; 5],
                quality,
                ..Sample::BLANK
            }
        };
        let (recording, _) = aligned(&(0..4).map(sample).collect::<Vec<_>>());
        assert_eq!(
            recording.angle_deg[..3].iter().map(|angle| angle.is_nan()).collect::<Vec<_>>(),
            [false, true, false]
        );
    }
}
