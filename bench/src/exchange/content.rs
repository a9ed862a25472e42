//! The tables that a recording holds: aligned rows, samples as they are, events, the amplifier's reports. Names, units and meaning of
//! the columns are those of `recordings/FORMAT.md`.

use super::table::{Block, Cell, Column, Kind, Values};
use recordings::{AmplifierReport, Event, Recording, Severity};
use rt_core::{Sample, flags};

/// One of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// The contract's columns: every value at the time at which it was measured. What the identification reads.
    Rows,
    /// Every field of every sample, as the loop published it.
    Raw,
    /// The events.
    Events,
    /// What the motor amplifier told of itself.
    Amplifier,
}

impl Content {
    /// Its name in files that hold several tables.
    pub fn name(self) -> &'static str {
        match self {
            Content::Rows => "rows",
            Content::Raw => "samples",
            Content::Events => "events",
            Content::Amplifier => "amplifier",
        }
    }

    /// What it holds, for the comment of a table.
    pub fn about(self) -> &'static str {
        match self {
            Content::Rows => "the contract's columns: each value at the time at which it was measured",
            Content::Raw => "every field of every sample, as the loop published it",
            Content::Events => "what happened besides the samples",
            Content::Amplifier => "what the motor amplifier told of itself",
        }
    }

    /// Its columns; the first one is the time, s.
    pub fn columns(self) -> Vec<Column> {
        match self {
            Content::Rows => ROWS.to_vec(),
            Content::Raw => RAW.iter().map(|(column, _)| *column).collect(),
            Content::Events => EVENTS.iter().map(|(column, _)| *column).collect(),
            Content::Amplifier => AMPLIFIER.iter().map(|(column, _)| *column).collect(),
        }
    }
}

const fn number(name: &'static str, unit: &'static str, about: &'static str) -> Column {
    Column { name, unit, about, kind: Kind::Number }
}

const fn natural(name: &'static str, unit: &'static str, about: &'static str) -> Column {
    Column { name, unit, about, kind: Kind::Natural }
}

const fn flag(name: &'static str, about: &'static str) -> Column {
    Column { name, unit: "", about, kind: Kind::Flag }
}

const fn text(name: &'static str, about: &'static str) -> Column {
    Column { name, unit: "", about, kind: Kind::Text }
}

const TIME: Column = number("time_s", "s", "since the run's start");
const VOLTAGE: Column = number("voltage_v", "V", "command to the motor amplifier; acts until the next row");
const ANGLE: Column = number("angle_deg", "deg", "absolute encoder; > 0 expands chamber 1");
const PRESSURE1: Column = number("pressure1_bar", "bar", "chamber 1, absolute (pump map: port 1)");
const PRESSURE2: Column = number("pressure2_bar", "bar", "chamber 2, absolute (pump map: port 2)");
const TORQUE: Column = number("torque_nm", "Nm", "torque that the clamp holds");
const VOLUME: Column = number("volume_ml", "ml", "measuring cylinder");
const BRAKE: Column = flag("brake_open", "valve in series with the pump, as commanded");
const BYPASS: Column = flag("bypass_open", "valve parallel to the pump, as commanded");

const ROWS: [Column; 10] = [
    TIME,
    VOLTAGE,
    ANGLE,
    PRESSURE1,
    PRESSURE2,
    TORQUE,
    VOLUME,
    BRAKE,
    BYPASS,
    Column { name: "segment", unit: "", about: "counts the set points of the protocol", kind: Kind::Integer },
];

/// The list of [`rt_core::TargetKind`] in words; a test compares them.
const TARGET_OF: &str = "what the target is of: 1 voltage, V; 2 flow, ml/s; 3 pressure of chamber 1, bar; 4 pressure of chamber 2, bar; \
                         5 pressure difference, bar; 6 angle, deg; 0 = there is none";

type Field<T> = (Column, fn(&T) -> Cell);

const fn nat32(value: u32) -> Cell {
    Cell::Natural(value as u64)
}

const fn bit(sample: &Sample, bit: u32) -> Cell {
    Cell::Flag(sample.flags & bit != 0)
}

#[rustfmt::skip]
const RAW: &[Field<Sample>] = &[
    (TIME, |s| Cell::Number(s.time_s())),
    (VOLTAGE, |s| Cell::Number(s.voltage_v)),
    (ANGLE, |s| Cell::Number(s.angle_deg)),
    (PRESSURE1, |s| Cell::Number(s.pressure1_bar)),
    (PRESSURE2, |s| Cell::Number(s.pressure2_bar)),
    (TORQUE, |s| Cell::Number(s.torque_nm)),
    (VOLUME, |s| Cell::Number(s.volume_ml)),
    (BRAKE, |s| bit(s, flags::BRAKE_OPEN)),
    (BYPASS, |s| bit(s, flags::BYPASS_OPEN)),
    (natural("segment", "", "set point of the protocol"), |s| nat32(s.segment)),
    (natural("step", "", "active step of the profile, through its unrolled loops from 0"), |s| nat32(s.step)),
    (number("target", "", "what the profile asks for; of what and in which unit: target_of"), |s| Cell::Number(s.target)),
    (natural("target_of", "", TARGET_OF), |s| nat32(s.target_of)),
    (natural("run", "", "number of the run within the service's life"), |s| nat32(s.run)),
    (natural("version", "", "layout of the sample"), |s| nat32(s.version)),
    (natural("tick", "", "number of the 1 ms period since the run's start"), |s| Cell::Natural(s.tick)),
    (natural("skipped", "", "ticks that the loop passed over up to here"), |s| Cell::Natural(s.skipped)),
    (natural("scheduled_ns", "ns", "scheduled time since the run's start"), |s| Cell::Natural(s.scheduled_ns)),
    (natural("woken_ns", "ns", "CLOCK_MONOTONIC at the wake-up; 0 in virtual time"), |s| Cell::Natural(s.woken_ns)),
    (natural("lateness_ns", "ns", "wake-up later than scheduled by"), |s| Cell::Natural(s.lateness_ns)),
    (natural("behind_ns", "ns", "part of the lateness that earlier ticks caused"), |s| nat32(s.behind_ns)),
    (natural("angle_age_ns", "ns", "age of the angle at the tick"), |s| nat32(s.age_ns[0])),
    (natural("pressure1_age_ns", "ns", "age of pressure 1 at the tick"), |s| nat32(s.age_ns[1])),
    (natural("pressure2_age_ns", "ns", "age of pressure 2 at the tick"), |s| nat32(s.age_ns[2])),
    (natural("torque_age_ns", "ns", "age of the torque at the tick"), |s| nat32(s.age_ns[3])),
    (natural("volume_age_ns", "ns", "age of the volume at the tick"), |s| nat32(s.age_ns[4])),
    (natural("heartbeat_age_ns", "ns", "age of the drivers' oldest sign of life"), |s| nat32(s.heartbeat_age_ns)),
    (natural("read_ns", "ns", "duration of reading the inputs"), |s| nat32(s.read_ns)),
    (natural("check_ns", "ns", "duration of the supervisor's check"), |s| nat32(s.check_ns)),
    (natural("reference_ns", "ns", "duration of the reference"), |s| nat32(s.reference_ns)),
    (natural("control_ns", "ns", "duration of the controller"), |s| nat32(s.control_ns)),
    (natural("write_ns", "ns", "duration of writing the outputs"), |s| nat32(s.write_ns)),
    (natural("publish_ns", "ns", "duration of the hand-over of the sample before this one"), |s| nat32(s.publish_ns)),
    (natural("quality", "", "bits 0 to 4: sound values; 8 to 12: called wrong by the device"), |s| nat32(s.quality)),
    (natural("trip", "", "why the supervisor tripped: channel + 256 * breach; 0 = it has not"), |s| nat32(s.trip)),
    (flag("tripped", "the supervisor has tripped"), |s| bit(s, flags::TRIPPED)),
    (flag("last", "last sample of the run"), |s| bit(s, flags::LAST)),
    (flag("fault", "the device failed within this tick"), |s| bit(s, flags::FAULT)),
    (flag("overrun", "the tick before this one ended too late"), |s| bit(s, flags::OVERRUN)),
    (flag("stopped", "a stop was asked for"), |s| bit(s, flags::STOPPED)),
    (flag("slew_limited", "the voltage was held back by the slew limit"), |s| bit(s, flags::SLEW_LIMITED)),
    (flag("waiting", "the run waits for a person"), |s| bit(s, flags::WAITING)),
    (flag("confirmed", "a person confirmed at this tick"), |s| bit(s, flags::CONFIRMED)),
];

const EVENTS: &[Field<Event>] = &[
    (TIME, |e| Cell::Number(e.scheduled_ns as f64 * 1e-9)),
    (natural("tick", "", "tick at which it happened"), |e| Cell::Natural(e.tick)),
    (text("severity", "info, warning or error"), |e| Cell::Text(severity(e.severity).to_owned())),
    (text("source", "who says it"), |e| Cell::Text(e.source.clone())),
    (text("text", "what happened"), |e| Cell::Text(e.text.clone())),
];

const AMPLIFIER: &[Field<AmplifierReport>] = &[
    (number("time_s", "s", "arrival since the run's start"), |r| Cell::Number(r.arrived_ns as f64 * 1e-9)),
    (natural("tick", "", "tick of the loop in which it arrived"), |r| Cell::Natural(r.tick)),
    (number("supply_v", "V", "supply voltage"), |r| Cell::Number(r.supply_v)),
    (number("motor_current_a", "A", "motor current"), |r| Cell::Number(r.motor_current_a)),
    (number("speed_rpm", "rpm", "speed of the motor's shaft"), |r| Cell::Number(r.speed_rpm)),
    (number("duty", "", "duty cycle, -1 to 1"), |r| Cell::Number(r.duty)),
    (number("temperature_c", "degC", "temperature of the power stage"), |r| Cell::Number(r.temperature_c)),
    (number("fault_code", "", "fault by the amplifier's own numbering; missing: none"), |r| {
        Cell::Number(r.fault.as_ref().map_or(f64::NAN, |fault| f64::from(fault.code)))
    }),
    (text("fault_name", "its name"), |r| Cell::Text(r.fault.as_ref().map_or(String::new(), |f| f.name.clone()))),
];

/// The word for how bad an event is.
pub fn severity(severity: Severity) -> &'static str {
    match severity {
        Severity::Info => "info",
        Severity::Warning => "warning",
        Severity::Error => "error",
    }
}

/// The contract's columns as a block.
pub fn of_rows(rows: Recording) -> Block {
    let Recording { time_s, voltage_v, angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml, .. } = rows;
    let numbers = [time_s, voltage_v, angle_deg, pressure1_bar, pressure2_bar, torque_nm, volume_ml];
    let mut values: Vec<Values> = numbers.into_iter().map(Values::Number).collect();
    values.push(Values::Flag(rows.brake_open));
    values.push(Values::Flag(rows.bypass_open));
    values.push(Values::Integer(rows.segment));
    Block { values }
}

/// Appends a sample to a block of [`Content::Raw`].
pub fn push_sample(block: &mut Block, sample: &Sample) {
    push(block, RAW, sample);
}

/// Appends an event to a block of [`Content::Events`].
pub fn push_event(block: &mut Block, event: &Event) {
    push(block, EVENTS, event);
}

/// Appends a report to a block of [`Content::Amplifier`].
pub fn push_report(block: &mut Block, report: &AmplifierReport) {
    push(block, AMPLIFIER, report);
}

fn push<T>(block: &mut Block, fields: &[Field<T>], item: &T) {
    for (values, (_, field)) in block.values.iter_mut().zip(fields) {
        values.push(field(item));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_table_has_its_time_first_and_each_name_once() {
        for content in [Content::Rows, Content::Raw, Content::Events, Content::Amplifier] {
            let columns = content.columns();
            assert_eq!((columns[0].name, columns[0].kind), ("time_s", Kind::Number));
            let mut names: Vec<_> = columns.iter().map(|column| column.name).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), columns.len(), "{content:?}");
            for column in columns {
                let unit = column.name.rsplit_once('_').map_or("", |(_, unit)| unit);
                let said = column.unit.to_lowercase();
                let named = ["s", "v", "deg", "bar", "nm", "ml", "ns", "a", "rpm"].contains(&unit) || unit == "c";
                assert!(!named || said == unit || (unit == "c" && said == "degc"), "{column:?}");
            }
        }
    }

    #[test]
    fn the_kinds_of_targets_are_named_as_in_the_list() {
        let list = rt_core::TargetKind::LIST.map(|(kind, name, unit)| format!("{} {name}, {unit}", kind.code()));
        assert_eq!(TARGET_OF, format!("what the target is of: {}; 0 = there is none", list.join("; ")));
    }

    #[test]
    fn every_bit_of_a_sample_has_a_column_of_its_own() {
        for shift in 0..10 {
            let mut block = Block::empty(&Content::Raw.columns());
            push_sample(&mut block, &Sample { flags: 1 << shift, ..Sample::BLANK });
            let set = block.values.iter().filter(|values| **values == Values::Flag(vec![true])).count();
            assert_eq!(set, 1, "bit {shift}");
        }
    }
}
