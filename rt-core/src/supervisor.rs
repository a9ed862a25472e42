//! The supervisor: judges every measurement and every command, and has the last word on what is written.
//!
//! A trip latches. From its tick on, that tick included, the loop writes the safe state. Nothing clears a trip but
//! [`Supervisor::reset`], which is the operator's act and no part of the loop.

use std::fmt;

use crate::types::{Command, Fixture, Measurement, Tick};

/// Longest window for the velocity, ticks.
pub const VELOCITY_WINDOW_MAX: usize = 64;

/// What the supervisor enforces. Limits are data: a rig brings its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest pressure of either chamber, bar absolute.
    pub pressure_min_bar: f64,
    /// Highest pressure of either chamber, bar absolute.
    pub pressure_max_bar: f64,
    /// Largest angle to either side, degrees.
    pub angle_max_deg: f64,
    /// Largest velocity in either direction, degrees per second; judged while the lever is free.
    pub velocity_max_deg_s: f64,
    /// The velocity is the difference of two angles this many ticks apart, 1..=[`VELOCITY_WINDOW_MAX`]: one tick of
    /// an encoder with 0.05 deg of noise would already read as 70 deg/s.
    pub velocity_window_ticks: u32,
    /// Largest torque on the clamp to either side, Nm; judged where it is measured.
    pub torque_max_nm: f64,
    /// A required channel may be missing for this many ticks in a row; one more trips.
    pub missing_max_ticks: u32,
    /// After a trip the run goes on for this many ticks in the safe state, so that the recording holds what followed.
    pub aftermath_ticks: u64,
}

impl Default for Limits {
    /// For an actuator of the paper's size: its chambers work at 1.2..6 bar and its lever at -40..40 degrees.
    fn default() -> Self {
        Limits {
            pressure_min_bar: 0.5,
            pressure_max_bar: 8.0,
            angle_max_deg: 60.0,
            velocity_max_deg_s: 1000.0,
            velocity_window_ticks: 10,
            torque_max_nm: 80.0,
            missing_max_ticks: 20,
            aftermath_ticks: 500,
        }
    }
}

/// Limits that can't be enforced.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("limits: {field} must be {expected}, got {got}")]
pub struct LimitsError {
    /// Name of the field.
    pub field: &'static str,
    /// What it must be.
    pub expected: String,
    /// What it is.
    pub got: f64,
}

impl Limits {
    /// Whether each limit is a number that can be enforced.
    pub fn validate(&self) -> Result<(), LimitsError> {
        let check = |field, got: f64, valid: bool, expected: &str| {
            if valid { Ok(()) } else { Err(LimitsError { field, expected: expected.to_owned(), got }) }
        };
        let positive = |field, got: f64| check(field, got, got.is_finite() && got > 0.0, "finite and above 0");
        let finite = self.pressure_min_bar.is_finite();
        check("pressure_min_bar", self.pressure_min_bar, finite, "finite")?;
        positive("pressure_max_bar", self.pressure_max_bar)?;
        let ordered = self.pressure_max_bar > self.pressure_min_bar;
        check("pressure_max_bar", self.pressure_max_bar, ordered, "above pressure_min_bar")?;
        positive("angle_max_deg", self.angle_max_deg)?;
        positive("velocity_max_deg_s", self.velocity_max_deg_s)?;
        positive("torque_max_nm", self.torque_max_nm)?;
        let window = self.velocity_window_ticks;
        let fits = (1..=VELOCITY_WINDOW_MAX as u32).contains(&window);
        check("velocity_window_ticks", f64::from(window), fits, &format!("1..={VELOCITY_WINDOW_MAX}"))
    }
}

/// What was judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// Pressure of chamber 1.
    Pressure1,
    /// Pressure of chamber 2.
    Pressure2,
    /// Angle of the lever.
    Angle,
    /// Velocity of the lever, from angle differences.
    Velocity,
    /// Torque on the clamp.
    Torque,
    /// The commanded voltage.
    Voltage,
}

impl Channel {
    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Channel::Pressure1 => "pressure 1",
            Channel::Pressure2 => "pressure 2",
            Channel::Angle => "angle",
            Channel::Velocity => "velocity",
            Channel::Torque => "torque",
            Channel::Voltage => "voltage",
        }
    }

    /// Unit of the channel's values and limits.
    pub fn unit(self) -> &'static str {
        match self {
            Channel::Pressure1 | Channel::Pressure2 => "bar",
            Channel::Angle => "deg",
            Channel::Velocity => "deg/s",
            Channel::Torque => "Nm",
            Channel::Voltage => "V",
        }
    }
}

/// How a limit was broken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Breach {
    /// The value is below this limit.
    Below(f64),
    /// The value is above this limit.
    Above(f64),
    /// The value is no number, where a command must be one.
    NotFinite,
    /// A required value was missing for more than this many ticks in a row.
    Missing(u32),
}

/// Why the supervisor tripped. The first breach counts; later ones are consequences.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trip {
    /// The tick at which it tripped; that tick's command already is the safe state.
    pub tick: u64,
    /// What was judged.
    pub channel: Channel,
    /// The value, in the channel's unit; NaN where it was missing.
    pub value: f64,
    /// The limit and the side on which it was broken.
    pub breach: Breach,
}

impl fmt::Display for Trip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Trip { tick, channel, value, breach } = self;
        let (name, unit) = (channel.name(), channel.unit());
        match breach {
            Breach::Below(limit) => write!(f, "{name} {value:.4} {unit} below {limit} {unit} at tick {tick}"),
            Breach::Above(limit) => write!(f, "{name} {value:.4} {unit} above {limit} {unit} at tick {tick}"),
            Breach::NotFinite => write!(f, "{name} is {value}, not a finite number, at tick {tick}"),
            Breach::Missing(limit) => write!(f, "{name} missing for more than {limit} ticks at tick {tick}"),
        }
    }
}

/// Latches the first breach of its limits and replaces every command from then on.
#[derive(Clone, Debug)]
pub struct Supervisor {
    limits: Limits,
    trip: Option<Trip>,
    /// Fixture of the command that acts while the next measurement is taken; unknown before the first command.
    acting: Option<Fixture>,
    missing: [u32; 3],
    velocity: VelocityWindow,
}

impl Supervisor {
    /// A supervisor that has not tripped.
    pub fn new(limits: Limits) -> Result<Self, LimitsError> {
        limits.validate()?;
        Ok(Supervisor { limits, trip: None, acting: None, missing: [0; 3], velocity: VelocityWindow::default() })
    }

    /// What it enforces.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The latched trip.
    pub fn trip(&self) -> Option<&Trip> {
        self.trip.as_ref()
    }

    /// The operator's act: the cause was removed, the latch is opened.
    pub fn reset(&mut self) {
        self.trip = None;
        self.begin_run();
    }

    /// A run begins: what was measured in the run before has no bearing. A latched trip stays.
    pub fn begin_run(&mut self) {
        self.acting = None;
        self.missing = [0; 3];
        self.velocity.clear();
    }

    /// Judges the measurement of this tick.
    pub fn check(&mut self, now: Tick, measured: &Measurement) {
        let Limits { pressure_min_bar, pressure_max_bar, angle_max_deg, torque_max_nm, .. } = self.limits;
        self.check_presence(now, measured);
        for (channel, value) in
            [(Channel::Pressure1, measured.pressure1_bar), (Channel::Pressure2, measured.pressure2_bar)]
        {
            self.check_range(now, channel, value, pressure_min_bar, pressure_max_bar);
        }
        self.check_range(now, Channel::Angle, measured.angle_deg, -angle_max_deg, angle_max_deg);
        self.check_range(now, Channel::Torque, measured.torque_nm, -torque_max_nm, torque_max_nm);
        self.check_velocity(now, measured.angle_deg);
    }

    /// The last word on the command of this tick: the command itself, or the safe state with the command's segment.
    pub fn release(&mut self, now: Tick, command: Command) -> Command {
        if !command.voltage_v.is_finite() {
            self.latch(now, Channel::Voltage, command.voltage_v, Breach::NotFinite);
        }
        let released =
            if self.trip.is_some() { Command { segment: command.segment, ..Command::SAFE } } else { command };
        self.acting = Some(released.fixture);
        released
    }

    /// Whether a tripped run has recorded its aftermath.
    pub fn aftermath_over(&self, now: Tick) -> bool {
        self.trip.is_some_and(|trip| now.index >= trip.tick.saturating_add(self.limits.aftermath_ticks))
    }

    fn latch(&mut self, now: Tick, channel: Channel, value: f64, breach: Breach) {
        self.trip.get_or_insert(Trip { tick: now.index, channel, value, breach });
    }

    fn check_range(&mut self, now: Tick, channel: Channel, value: f64, min: f64, max: f64) {
        // NaN passes both comparisons: a missing value is judged by its absence, not by its size.
        if value > max {
            self.latch(now, channel, value, Breach::Above(max));
        } else if value < min {
            self.latch(now, channel, value, Breach::Below(min));
        }
    }

    /// Pressures are required under every fixture, the angle wherever there is a lever.
    fn check_presence(&mut self, now: Tick, measured: &Measurement) {
        let Some(acting) = self.acting else { return };
        let lever = !matches!(acting, Fixture::PumpBench { .. });
        let required = [
            (Channel::Pressure1, measured.pressure1_bar, true),
            (Channel::Pressure2, measured.pressure2_bar, true),
            (Channel::Angle, measured.angle_deg, lever),
        ];
        for (index, (channel, value, required)) in required.into_iter().enumerate() {
            self.missing[index] = if required && value.is_nan() { self.missing[index].saturating_add(1) } else { 0 };
            if self.missing[index] > self.limits.missing_max_ticks {
                self.latch(now, channel, value, Breach::Missing(self.limits.missing_max_ticks));
            }
        }
    }

    /// Only a free lever has a velocity of its own; under every other fixture the operator moves it.
    fn check_velocity(&mut self, now: Tick, angle_deg: f64) {
        if self.acting != Some(Fixture::Free) {
            self.velocity.clear();
            return;
        }
        if !angle_deg.is_finite() {
            return;
        }
        let window = self.limits.velocity_window_ticks as usize;
        if let Some(velocity_deg_s) = self.velocity.push(now, angle_deg, window) {
            let max = self.limits.velocity_max_deg_s;
            self.check_range(now, Channel::Velocity, velocity_deg_s, -max, max);
        }
    }
}

/// The last angles of the free lever, in fixed memory.
#[derive(Clone, Debug)]
struct VelocityWindow {
    angles: [(u64, f64); VELOCITY_WINDOW_MAX],
    count: usize,
}

impl Default for VelocityWindow {
    fn default() -> Self {
        VelocityWindow { angles: [(0, 0.0); VELOCITY_WINDOW_MAX], count: 0 }
    }
}

impl VelocityWindow {
    fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds an angle; the mean velocity since `window` angles ago, deg/s, once there are that many.
    fn push(&mut self, now: Tick, angle_deg: f64, window: usize) -> Option<f64> {
        // With one slot per angle of the window, the slot to be overwritten is the angle `window` pushes ago.
        let slot = self.count % window;
        let (then_ns, then_deg) = self.angles[slot];
        self.angles[slot] = (now.scheduled_ns, angle_deg);
        let full = self.count >= window;
        self.count += 1;
        let elapsed_s = now.scheduled_ns.saturating_sub(then_ns) as f64 * 1e-9;
        (full && elapsed_s > 0.0).then(|| (angle_deg - then_deg) / elapsed_s)
    }
}
