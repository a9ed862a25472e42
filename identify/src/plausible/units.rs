//! Units: ranges that physics gives, the twin sensor, the other runs.

use recordings::{Campaign, Protocol, Recording};

use super::Implausible;
use super::series::quantile;
use crate::prepare::segments;

/// Pressures of a rig of this kind at rest, bar absolute. Its chambers are elastic: the paper's work at 1.2..6 bar.
const PRESSURE_BAR: (f64, f64) = (0.5, 20.0);
/// A pressure below this is negative beyond any sensor's zero error, bar.
const NEGATIVE_BAR: f64 = -0.1;
/// The largest angle of a lever on two chambers, degrees.
const ANGLE_DEG: f64 = 180.0;
/// A lever that is driven or led and never leaves this range of angles, degrees, is more likely recorded in rad: a quarter turn.
const RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Largest torque on the clamp of a rig of this kind, Nm.
const TORQUE_NM: f64 = 500.0;
/// Largest and least amounts of oil that a cylinder measures, ml.
const VOLUME_ML: (f64, f64) = (0.3, 20_000.0);
/// Sampling interval, s, where the lever is free: it swings at some 10 Hz, and no rig of this kind is sampled at 200 kHz.
const INTERVAL_S: (f64, f64) = (5e-6, 0.25);
/// The same where it is clamped or led, or the pump is on its bench: everything takes seconds, and a person may read the instruments.
const SLOW_INTERVAL_S: f64 = 5.0;
/// Typical lengths of such a run's segments, and of a run with a free lever, s.
const SEGMENT_S: (f64, f64) = (0.3, 300.0);
const FREE_RUN_S: (f64, f64) = (3.0, 3000.0);
/// Segments of rows that are seldom are in another unit where they are longer than this, s.
const LONG_SEGMENT_S: f64 = 1000.0;
/// Share of u_max below which a pump that is to drive the lever does next to nothing.
const SHARE: f64 = 0.2;
/// Medians of one channel in two runs, or of twin channels in one, that differ by this factor are in two units: the least factor between units of pressure is 10.
const FACTOR: f64 = 6.0;

/// Units of pressure: factor to bar, name.
const PRESSURE_UNITS: [(f64, &str); 5] =
    [(1e-5, "Pa"), (1e-3, "mbar or hPa"), (1e-2, "kPa"), (0.068_947_6, "psi"), (10.0, "MPa")];
/// Typical pressure, bar, to which the likely unit brings a column.
const TYPICAL_BAR: (f64, f64) = (0.8, 9.0);

/// Judges every run.
///
/// # Errors
/// The first column that can't be in the contract's unit.
pub(super) fn judge(campaign: &Campaign, recordings: &[Recording]) -> Result<(), Implausible> {
    let runs: Vec<Run> = campaign
        .runs
        .iter()
        .zip(recordings)
        .map(|(entry, r)| Run {
            file: campaign.dir.join(&entry.file).display().to_string(),
            protocol: entry.protocol,
            r,
        })
        .collect();
    for run in &runs {
        run.time()?;
        run.voltage(campaign.rig.u_max_v)?;
    }
    for run in &runs {
        run.pressures()?;
    }
    between_runs(&runs)?;
    runs.iter().try_for_each(Run::angle)?;
    turned_little(&runs)?;
    runs.iter().try_for_each(Run::torque)?;
    runs.iter().try_for_each(Run::volume)
}

struct Run<'a> {
    file: String,
    protocol: Protocol,
    r: &'a Recording,
}

/// Smallest, middle and largest value of a column, a thousandth of the samples left out at either end: spikes are no unit.
fn range(values: &[f64]) -> Option<(f64, f64, f64)> {
    let at = |share| quantile(values.iter().copied(), share);
    let middle = at(0.5);
    middle.is_finite().then(|| (at(0.001), middle, at(0.999)))
}

fn seen(values: &[f64]) -> String {
    match range(values) {
        Some((low, middle, high)) => format!("{} .. {} (median {})", number(low), number(high), number(middle)),
        None => "no value".into(),
    }
}

fn number(v: f64) -> String {
    crate::figures::text::number(v, 4)
}

impl Run<'_> {
    fn refuse(&self, column: &str, expected: String, got: String, remedy: String) -> Implausible {
        Implausible { file: self.file.clone(), column: column.into(), expected, got, remedy }
    }

    fn free(&self) -> bool {
        matches!(self.protocol, Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps)
    }

    fn time(&self) -> Result<(), Implausible> {
        let steps: Vec<f64> = self.r.time_s.windows(2).map(|w| w[1] - w[0]).collect();
        let interval = quantile(steps.iter().copied(), 0.5);
        if !interval.is_finite() || (INTERVAL_S.0..=INTERVAL_S.1).contains(&interval) {
            return Ok(());
        }
        // rows that are seldom say nothing of the unit, the lengths of a run and its segments do
        let seldom = interval > INTERVAL_S.1;
        let segment_s = self.segment_s();
        if seldom && !self.free() && interval <= SLOW_INTERVAL_S && segment_s <= LONG_SEGMENT_S {
            return Ok(());
        }
        let run_s = self.r.time_s[self.r.len() - 1] - self.r.time_s[0];
        let (length_s, typical_s) = if self.free() { (run_s, FREE_RUN_S) } else { (segment_s, SEGMENT_S) };
        let units = [(1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"), (60.0, "min"), (3600.0, "h")];
        let unit = units.into_iter().find(|(f, _)| {
            if seldom {
                length_s > typical_s.1 && (typical_s.0..=typical_s.1).contains(&(length_s * f))
            } else {
                (2e-4..=0.05).contains(&(interval * f))
            }
        });
        let most = if self.free() { INTERVAL_S.1 } else { SLOW_INTERVAL_S };
        let swing = if self.free() { ", at a rate that shows the lever's swing of some 10 Hz" } else { "" };
        Err(self.refuse(
            "time_s",
            format!("rows {} .. {} s apart", number(INTERVAL_S.0), number(most)),
            format!("{} s in segments of some {} s", number(interval), number(segment_s)),
            match unit {
                Some((factor, unit)) => format!("the column is likely in {unit}: multiply it by {factor:e}"),
                None => format!("give the time in seconds{swing}"),
            },
        ))
    }

    /// Median length of the segments, s.
    fn segment_s(&self) -> f64 {
        let lengths = segments(self.r).into_iter().map(|(first, end)| self.r.time_s[end - 1] - self.r.time_s[first]);
        quantile(lengths, 0.5)
    }

    fn voltage(&self, u_max_v: f64) -> Result<(), Implausible> {
        let most = self.r.voltage_v.iter().fold(0.0f64, |m, u| m.max(u.abs()));
        let refuse = |remedy: String| {
            let expected = format!("at most u_max = {u_max_v} V of campaign.toml either way");
            Err(self.refuse("voltage_v", expected, format!("up to {} V", number(most)), remedy))
        };
        if most > 1.05 * u_max_v {
            let percent = (most <= 101.0).then_some("percent of u_max");
            return refuse(match (most > 50.0 * u_max_v, percent) {
                (true, _) => "the column is likely in mV: multiply it by 0.001".into(),
                (false, Some(unit)) => {
                    format!(
                        "the column is likely in {unit}: multiply it by u_max/100; or u_max in campaign.toml is too small"
                    )
                }
                (false, None) => "give the command in V, or correct u_max in campaign.toml".into(),
            });
        }
        // a pump of some 24 V that drives the lever to and fro with 1 V
        let drives = self.free() && moved(&self.r.angle_deg) && most > 0.0;
        if drives && most <= 1.0 + 1e-9 && most < SHARE * u_max_v {
            return Err(self.refuse(
                "voltage_v",
                format!("voltages that drive the lever to and fro, of the order of u_max = {u_max_v} V"),
                format!("at most {} V", number(most)),
                "the column is likely a share of u_max: multiply it by u_max; or correct u_max in campaign.toml".into(),
            ));
        }
        Ok(())
    }

    fn pressures(&self) -> Result<(), Implausible> {
        for (column, values) in [("pressure1_bar", &self.r.pressure1_bar), ("pressure2_bar", &self.r.pressure2_bar)] {
            let Some((low, middle, high)) = range(values) else { continue };
            if low < NEGATIVE_BAR {
                let gauge = if middle > -1.0 && high < PRESSURE_BAR.1 {
                    "the column is likely a gauge pressure: add the ambient pressure, some 1.013 bar".to_owned()
                } else {
                    likely(middle).unwrap_or_else(|| "correct the sensor's scaling".into())
                };
                return Err(self.refuse(
                    column,
                    "no negative pressure: the contract's are absolute".into(),
                    seen(values),
                    gauge,
                ));
            }
            if !(PRESSURE_BAR.0..=PRESSURE_BAR.1).contains(&middle) {
                return Err(self.refuse(
                    column,
                    format!("a median of {} .. {} bar absolute", PRESSURE_BAR.0, PRESSURE_BAR.1),
                    seen(values),
                    likely(middle).unwrap_or_else(|| "give absolute pressures in bar".into()),
                ));
            }
        }
        let medians = [&self.r.pressure1_bar, &self.r.pressure2_bar].map(|p| quantile(p.iter().copied(), 0.5));
        // on the bench each port has a reservoir of its own, and the clamp-steps drain one chamber
        let twins = !matches!(self.protocol, Protocol::PumpMap | Protocol::ClampSteps);
        let ratio = medians[0] / medians[1];
        if twins && ratio.is_finite() && !(1.0 / FACTOR..=FACTOR).contains(&ratio) {
            let (odd, column) = if ratio > 1.0 { (medians[0], "pressure1_bar") } else { (medians[1], "pressure2_bar") };
            return Err(self.refuse(
                column,
                "two chambers at pressures of the same order".into(),
                format!("medians of {} and {} bar", number(medians[0]), number(medians[1])),
                likely(odd).unwrap_or_else(|| "give both pressures in bar absolute".into()),
            ));
        }
        Ok(())
    }

    fn angle(&self) -> Result<(), Implausible> {
        let Some((low, _, high)) = range(&self.r.angle_deg) else { return Ok(()) };
        if high - low <= 2.0 * ANGLE_DEG && low.abs().max(high.abs()) <= 2.0 * ANGLE_DEG {
            return Ok(());
        }
        let wide = high - low;
        Err(self.refuse(
            "angle_deg",
            format!("angles within {ANGLE_DEG} degrees of the middle"),
            seen(&self.r.angle_deg),
            if wide > 2000.0 {
                "the column is likely in counts of the encoder or thousandths of a degree: give degrees".into()
            } else {
                "the column is likely in mrad, or not counted from the middle position: give degrees from there".into()
            },
        ))
    }

    fn torque(&self) -> Result<(), Implausible> {
        let Some((low, _, high)) = range(&self.r.torque_nm) else { return Ok(()) };
        let most = low.abs().max(high.abs());
        if most <= TORQUE_NM {
            return Ok(());
        }
        let unit = if most * 1e-3 <= 80.0 { "mNm: multiply it by 0.001" } else { "smaller than Nm" };
        Err(self.refuse(
            "torque_nm",
            format!("at most {TORQUE_NM} Nm either way"),
            seen(&self.r.torque_nm),
            format!("the column is likely in {unit}"),
        ))
    }

    fn volume(&self) -> Result<(), Implausible> {
        let Some((low, _, high)) = range(&self.r.volume_ml) else { return Ok(()) };
        let most = low.abs().max(high.abs());
        let turned = self.protocol != Protocol::PumpMap || self.r.voltage_v.iter().any(|u| *u != 0.0);
        let unit = if most > VOLUME_ML.1 {
            "mm3 (ul): multiply it by 0.001"
        } else if most < VOLUME_ML.0 && most > 0.0 && turned {
            "l: multiply it by 1000"
        } else {
            return Ok(());
        };
        Err(self.refuse(
            "volume_ml",
            format!("a largest reading of {} .. {} ml", VOLUME_ML.0, VOLUME_ML.1),
            seen(&self.r.volume_ml),
            format!("the column is likely in {unit}"),
        ))
    }
}

fn moved(angle: &[f64]) -> bool {
    range(angle).is_some_and(|(low, _, high)| high - low > RAD)
}

/// The unit that brings a median into the usual range.
fn likely(median: f64) -> Option<String> {
    let (factor, unit) =
        PRESSURE_UNITS.into_iter().find(|(f, _)| (TYPICAL_BAR.0..=TYPICAL_BAR.1).contains(&(median * f)))?;
    Some(format!("the column is likely in {unit}: multiply it by {factor:e}"))
}

/// One channel in one unit throughout the campaign. On the pump's bench each port has a reservoir of its own, at whatever pressure: its runs
/// are neither judged by the chambers' pressures nor counted with them.
fn between_runs(all: &[Run]) -> Result<(), Implausible> {
    let runs: Vec<&Run> = all.iter().filter(|run| run.protocol != Protocol::PumpMap).collect();
    for column in ["pressure1_bar", "pressure2_bar"] {
        let of = |r: &Run| {
            let values = if column == "pressure1_bar" { &r.r.pressure1_bar } else { &r.r.pressure2_bar };
            quantile(values.iter().copied(), 0.5)
        };
        let mut medians: Vec<f64> = runs.iter().map(|run| of(run)).filter(|m| m.is_finite()).collect();
        if medians.len() < 2 {
            continue;
        }
        let usual = crate::noise::median(&mut medians);
        for run in &runs {
            let (own, ratio) = (of(run), of(run) / usual);
            if ratio.is_finite() && !(1.0 / FACTOR..=FACTOR).contains(&ratio) {
                return Err(run.refuse(
                    column,
                    format!("a median like that of the other runs, {} bar", number(usual)),
                    format!("{} bar", number(own)),
                    likely(own).unwrap_or_else(|| "give this run in the unit of the others".into()),
                ));
            }
        }
    }
    Ok(())
}

/// No lever of the campaign leaves a range that in degrees is next to nothing.
fn turned_little(runs: &[Run]) -> Result<(), Implausible> {
    // every run with an angle: where the lever is led or clamped at several positions it is moved on purpose
    let within = |r: &Run| range(&r.r.angle_deg).is_none_or(|(low, _, high)| low.abs().max(high.abs()) <= RAD);
    let moves = |r: &Run| range(&r.r.angle_deg).is_some_and(|(low, _, high)| high - low > 0.05);
    let driven = |r: &&Run| {
        let most = r.r.voltage_v.iter().fold(0.0f64, |m, u| m.max(u.abs()));
        let rows = r.r.voltage_v.iter().filter(|u| u.abs() > 0.5 * most && most > 0.0).count();
        r.free() && rows > 100 || matches!(r.protocol, Protocol::TorqueMap | Protocol::VolumeMap | Protocol::ClampSteps)
    };
    let chosen: Vec<&Run> = runs.iter().filter(|r| r.protocol != Protocol::PumpMap).collect();
    if chosen.is_empty() || !chosen.iter().all(|r| within(r)) {
        return Ok(());
    }
    let Some(run) = chosen.iter().filter(|r| moves(r)).find(|r| driven(r)) else { return Ok(()) };
    Err(run.refuse(
        "angle_deg",
        format!("a lever that turns by more than {} degrees somewhere in the campaign", number(RAD)),
        seen(&run.r.angle_deg),
        "the column is likely in rad: multiply it by 57.2958".into(),
    ))
}
