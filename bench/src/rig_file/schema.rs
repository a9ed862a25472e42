//! Every key that a rig file may have, with what may stand there. What depends on more than one key is checked elsewhere.

/// A key of a table.
#[derive(Debug)]
pub(super) struct Key {
    pub(super) name: &'static str,
    pub(super) expects: Expects,
    /// Its table makes no sense without it.
    pub(super) required: bool,
}

/// What may stand at a key.
#[derive(Debug)]
pub(super) enum Expects {
    /// Not empty.
    Text,
    /// One of these.
    Word(&'static [&'static str]),
    /// `true` or `false`.
    Flag,
    /// A number with its unit, which is empty for a ratio.
    Number(Range, &'static str),
    /// A whole number, both ends included.
    Whole(i64, i64),
    /// A table.
    Table(&'static [Key]),
    /// An array of tables.
    Tables(&'static [Key]),
}

/// Which numbers are in range. All but [`Range::AboveOrInfinite`] are finite.
#[derive(Clone, Copy, Debug)]
pub(super) enum Range {
    Any,
    NotZero,
    Above(f64),
    AboveOrInfinite(f64),
    AtLeast(f64),
    /// Without the low end, with the high one.
    UpTo(f64, f64),
    /// With both ends.
    Within(f64, f64),
}

impl Range {
    pub(super) fn holds(self, value: f64) -> bool {
        let finite = value.is_finite();
        match self {
            Range::Any => finite,
            Range::NotZero => finite && value != 0.0,
            Range::Above(low) => finite && value > low,
            Range::AboveOrInfinite(low) => value > low,
            Range::AtLeast(low) => finite && value >= low,
            Range::UpTo(low, high) => value > low && value <= high,
            Range::Within(low, high) => (low..=high).contains(&value),
        }
    }

    fn describe(self) -> String {
        match self {
            Range::Any => "a finite number".to_owned(),
            Range::NotZero => "a finite number other than 0".to_owned(),
            Range::Above(low) => format!("a finite number above {low}"),
            Range::AboveOrInfinite(low) => format!("a number above {low}, inf for none"),
            Range::AtLeast(low) => format!("a finite number, {low} or more"),
            Range::UpTo(low, high) => format!("a number above {low}, at most {high}"),
            Range::Within(low, high) => format!("a number from {low} to {high}"),
        }
    }
}

impl Expects {
    /// For messages, after "expected".
    pub(super) fn describe(&self) -> String {
        match self {
            Expects::Text => "a text that is not empty".to_owned(),
            Expects::Word(words) => words.iter().map(|w| format!("{w:?}")).collect::<Vec<_>>().join(" or "),
            Expects::Flag => "true or false".to_owned(),
            Expects::Number(range, "") => range.describe(),
            Expects::Number(range, unit) => format!("{} ({unit})", range.describe()),
            Expects::Whole(low, high) => format!("a whole number from {low} to {high}"),
            Expects::Table(_) => "a table".to_owned(),
            Expects::Tables(_) => "an array of tables".to_owned(),
        }
    }
}

const fn key(name: &'static str, expects: Expects) -> Key {
    Key { name, expects, required: false }
}

const fn required(name: &'static str, expects: Expects) -> Key {
    Key { name, expects, required: true }
}

const fn number(name: &'static str, range: Range, unit: &'static str) -> Key {
    key(name, Expects::Number(range, unit))
}

use Expects::{Flag, Number, Table, Tables, Text, Whole, Word};
use Range::{Above, AboveOrInfinite, Any, AtLeast, NotZero, UpTo, Within};

/// Everything.
pub(super) const RIG: &[Key] = &[
    key("name", Text),
    key("device", Table(DEVICE)),
    key("rig", Table(FACTS)),
    key("controller", Table(CONTROLLER)),
    key("limits", Table(LIMITS)),
    key("safe_state", Table(SAFE_STATE)),
    key("amplifier", Table(AMPLIFIER)),
    key("can", Table(CAN)),
    key("budget", Table(BUDGET)),
];

const DEVICE: &[Key] = &[key("kind", Word(&["emulated", "wired"])), key("model", Text)];

const FACTS: &[Key] = &[
    required("inertia_kg_m2", Number(Above(0.0), "kg m2")),
    required("gravity_nm", Number(AtLeast(0.0), "Nm")),
    required("u_max_v", Number(Above(0.0), "V")),
];

const CONTROLLER: &[Key] = &[key("model", Text), key("loops", Table(LOOPS))];

/// Their upper ends depend on the model.
const LOOPS: &[Key] = &[
    number("angle_bandwidth_hz", Above(0.0), "Hz"),
    number("angle_integral_hz", AtLeast(0.0), "Hz"),
    number("angle_deadband_deg", AtLeast(0.0), "degrees"),
    number("pressure_bandwidth_hz", Above(0.0), "Hz"),
    number("pressure_integral_hz", AtLeast(0.0), "Hz"),
    number("pressure_deadband_bar", AtLeast(0.0), "bar"),
    number("rest_flow_ml_s", AtLeast(0.0), "ml/s"),
    key("feed_forward", Flag),
    key("anti_windup", Flag),
];

const LIMITS: &[Key] = &[
    number("pressure_min_bar", Any, "bar absolute"),
    number("pressure_max_bar", Above(0.0), "bar absolute"),
    number("angle_max_deg", Above(0.0), "degrees"),
    number("velocity_max_deg_s", Above(0.0), "degrees/s"),
    key("velocity_window_ticks", Whole(1, rt_core::supervisor::VELOCITY_WINDOW_MAX as i64)),
    number("torque_max_nm", Above(0.0), "Nm"),
    key("missing_max_ticks", Whole(0, u32::MAX as i64)),
    number("age_max_ms", AtLeast(1.0), "ms"),
    number("heartbeat_max_ms", Above(0.0), "ms"),
    number("voltage_max_v", Above(0.0), "V"),
    number("slew_max_v_s", AboveOrInfinite(0.0), "V/s"),
    key("aftermath_ticks", Whole(0, i64::MAX)),
];

const VALVE: Expects = Word(&["open", "closed"]);

const SAFE_STATE: &[Key] = &[key("brake", VALVE), key("bypass", VALVE)];

const AMPLIFIER: &[Key] = &[
    required("protocol", Text),
    required("port", Text),
    key("baud", Whole(1, u32::MAX as i64)),
    required("full_scale_v", Number(Above(0.0), "V")),
    key("reversed", Flag),
    key("telemetry_every_ticks", Whole(1, 1000)),
    number("timeout_ms", Above(0.0), "ms"),
    key("vesc", Table(VESC)),
    key("tmcl", Table(TMCL)),
];

const VESC: &[Key] = &[key("pole_pairs", Whole(1, 255))];

const TMCL: &[Key] = &[
    key("module", Text),
    key("module_address", Whole(0, 255)),
    key("reply_address", Whole(0, 255)),
    key("axis", Whole(0, 255)),
    key("command_parameter", Whole(0, 255)),
    key("full_scale_units", Whole(1, i32::MAX as i64)),
];

const CAN: &[Key] = &[
    required("interface", Text),
    // ISO 11898-2: classic CAN carries 1 Mbit/s at most.
    key("bitrate", Whole(10_000, 1_000_000)),
    required("dbc", Text),
    required("sensors", Table(SENSORS)),
    required("command", Table(COMMAND)),
    key("fixture", Table(FIXTURE)),
    key("heartbeat", Tables(HEARTBEAT)),
];

const SENSORS: &[Key] = &[
    required("angle_deg", Table(SENSOR)),
    required("pressure1_bar", Table(SENSOR)),
    required("pressure2_bar", Table(SENSOR)),
    key("torque_nm", Table(SENSOR)),
    key("volume_ml", Table(SENSOR)),
];

const SENSOR: &[Key] = &[
    required("signal", Text),
    number("gain", NotZero, ""),
    number("offset", Any, ""),
    key("fault", Text),
    key("present", Text),
    key("counter", Text),
    number("latency_ms", Within(0.0, 1000.0), "ms"),
];

const COMMAND: &[Key] =
    &[required("brake_open", Text), required("bypass_open", Text), key("counter", Text), key("running", Text)];

const FIXTURE: &[Key] = &[
    required("kind", Text),
    required("angle_deg", Text),
    required("pressure1_bar", Text),
    required("pressure2_bar", Text),
    required("flow_ml_s", Text),
    required("segment", Text),
    required("run", Text),
    required("vertical", Text),
    required("fill_bar", Text),
];

const HEARTBEAT: &[Key] = &[required("message", Text), required("period_ms", Number(AtLeast(1.0), "ms"))];

const BUDGET: &[Key] = &[number("most_share", UpTo(0.0, 1.0), "share of a wire")];
