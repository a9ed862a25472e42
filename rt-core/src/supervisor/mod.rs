//! The supervisor: judges every measurement and every command, and has the last word on what is written.
//!
//! A trip latches. From its tick on, that tick included, the loop writes the safe state. Nothing clears a trip but
//! [`Supervisor::reset`], which is the operator's act and no part of the loop.

mod limits;
mod trip;
mod velocity;

pub use limits::{Limits, LimitsError};
pub use trip::{Breach, Channel, Trip};

use velocity::VelocityWindow;

use crate::traits::Demand;
use crate::types::{Command, Fixture, Input, Measurement, PERIOD_NS, Tick};

/// Longest window for the velocity, ticks.
pub const VELOCITY_WINDOW_MAX: usize = 64;

/// Latches the first breach of its limits and replaces every command from then on.
#[derive(Clone, Debug)]
pub struct Supervisor {
    limits: Limits,
    trip: Option<Trip>,
    /// Fixture of the command that acts while the next measurement is taken; unknown before the first command.
    acting: Option<Fixture>,
    /// What holds the lever before the first command.
    at_start: Option<Fixture>,
    /// The last voltage that was released, and when.
    released: Option<(Tick, f64)>,
    slew_limited: bool,
    missing: [u32; 3],
    /// People have their hands on the rig.
    hands_on: bool,
    velocity: VelocityWindow,
    /// What was judged at this tick.
    velocity_deg_s: Option<f64>,
}

impl Supervisor {
    /// A supervisor that has not tripped.
    pub fn new(limits: Limits) -> Result<Self, LimitsError> {
        limits.validate()?;
        Ok(Supervisor {
            limits,
            trip: None,
            acting: None,
            at_start: None,
            released: None,
            slew_limited: false,
            missing: [0; 3],
            hands_on: false,
            velocity: VelocityWindow::default(),
            velocity_deg_s: None,
        })
    }

    /// What it enforces.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// From the next run on it enforces these. A latched trip stays.
    ///
    /// # Errors
    /// Limits that can't be enforced; then nothing changes.
    pub fn enforce(&mut self, limits: Limits) -> Result<(), LimitsError> {
        limits.validate()?;
        self.limits = limits;
        Ok(())
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
        self.at_start = None;
        self.released = None;
        self.slew_limited = false;
        self.missing = [0; 3];
        self.hands_on = false;
        self.velocity.clear();
    }

    /// Whether people have their hands on the rig from now on, because the run asked them to and rests. Until that is over the lever's velocity
    /// is theirs, and sensors may be off (a pump that is taken out, an encoder that is moved): neither velocity nor absence nor age is
    /// judged. Whatever is measured must still be within its limits: pressures, angle, torque. So must the drivers' heartbeat.
    pub fn hands_on(&mut self, hands_on: bool) {
        self.hands_on = hands_on;
    }

    /// What holds the lever before the first command of the run that begins: a run that goes safe at its first tick leaves it there.
    pub fn held_at_start(&mut self, fixture: Fixture) {
        self.at_start = Some(fixture);
    }

    /// Judges what people ask for and what was measured at this tick.
    pub fn check(&mut self, now: Tick, demand: Demand, measured: &Measurement) {
        if demand == Demand::EmergencyStop {
            self.latch(now, Channel::EmergencyStop, 0.0, Breach::Demanded);
        }
        let Limits { pressure_min_bar, pressure_max_bar, angle_max_deg, torque_max_nm, .. } = self.limits;
        self.check_presence(now, measured);
        self.check_heartbeat(now, measured);
        let judged = [
            (Channel::Pressure1, Input::Pressure1, pressure_min_bar, pressure_max_bar),
            (Channel::Pressure2, Input::Pressure2, pressure_min_bar, pressure_max_bar),
            (Channel::Angle, Input::Angle, -angle_max_deg, angle_max_deg),
            (Channel::Torque, Input::Torque, -torque_max_nm, torque_max_nm),
        ];
        for (channel, input, min, max) in judged {
            if measured.faulty & input.bit() == 0 {
                self.check_range(now, channel, measured.value(input), min, max);
            }
        }
        self.check_velocity(now, if measured.is_valid(Input::Angle) { measured.angle_deg } else { f64::NAN });
    }

    /// The loop missed its deadline, and its policy takes that for a reason to go safe: `late_ns` after the tick's beginning
    /// its work was done.
    pub fn deadline_missed(&mut self, now: Tick, late_ns: u64) {
        let limit_ms = PERIOD_NS as f64 * 1e-6;
        self.latch(now, Channel::Deadline, late_ns as f64 * 1e-6, Breach::Above(limit_ms));
    }

    /// The last word on the command of this tick: the command itself, as fast as it may follow, or the safe state.
    pub fn release(&mut self, now: Tick, command: Command) -> Command {
        let max_v = self.limits.voltage_max_v;
        if command.voltage_v.is_finite() {
            self.check_range(now, Channel::Voltage, command.voltage_v, -max_v, max_v);
        } else {
            self.latch(now, Channel::Voltage, command.voltage_v, Breach::NotFinite);
        }
        if self.trip.is_some() {
            return self.rest(now, command.fixture, command.segment);
        }
        let released = Command { voltage_v: self.slewed(now, command.voltage_v), ..command };
        self.slew_limited = released.voltage_v != command.voltage_v;
        self.acting = Some(released.fixture);
        self.released = Some((now, released.voltage_v));
        released
    }

    /// The safe state as this tick's command: after a trip, or because the run is to end. The slew limit does not hold it
    /// back. What holds the lever goes on holding it, whatever fixture the profile has come to; `fixture` counts only
    /// where nothing was commanded before, nor known of the start.
    pub fn rest(&mut self, now: Tick, fixture: Fixture, segment: u32) -> Command {
        let held = self.acting.or(self.at_start).unwrap_or(fixture);
        let safe = self.limits.safe_state.command(held, segment);
        self.slew_limited = false;
        self.acting = Some(safe.fixture);
        self.released = Some((now, safe.voltage_v));
        safe
    }

    /// Velocity of the free lever as it was judged at the last checked tick, deg/s; `None` where none was.
    pub fn velocity_deg_s(&self) -> Option<f64> {
        self.velocity_deg_s
    }

    /// Whether the voltage of the last command was held back by the slew limit.
    pub fn slew_limited(&self) -> bool {
        self.slew_limited
    }

    /// Whether a tripped run has recorded its aftermath.
    pub fn aftermath_over(&self, now: Tick) -> bool {
        self.trip.is_some_and(|trip| now.index >= trip.tick.saturating_add(self.limits.aftermath_ticks))
    }

    /// As near to the wanted voltage as the slew limit lets it come; a run begins at 0 V.
    fn slewed(&self, now: Tick, wanted_v: f64) -> f64 {
        if self.limits.slew_max_v_s == f64::INFINITY {
            return wanted_v;
        }
        let (before_ns, before_v) = self.released.map_or((0, 0.0), |(tick, voltage_v)| (tick.scheduled_ns, voltage_v));
        let elapsed_ns = now.scheduled_ns.saturating_sub(before_ns).max(PERIOD_NS);
        let most_v = self.limits.slew_max_v_s * elapsed_ns as f64 * 1e-9;
        wanted_v.clamp(before_v - most_v, before_v + most_v)
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

    /// Pressures are required under every fixture, the angle wherever there is a lever: there, sound, and fresh. A torque, where there is one, must be fresh.
    fn check_presence(&mut self, now: Tick, measured: &Measurement) {
        let Some(acting) = self.acting else { return };
        if self.hands_on {
            self.missing = [0; 3];
            return;
        }
        let lever = !matches!(acting, Fixture::PumpBench { .. });
        let required = [
            (Channel::Pressure1, Input::Pressure1, true),
            (Channel::Pressure2, Input::Pressure2, true),
            (Channel::Angle, Input::Angle, lever),
        ];
        let Limits { missing_max_ticks, age_max_ms, .. } = self.limits;
        for (index, (channel, input, required)) in required.into_iter().enumerate() {
            let valid = measured.is_valid(input);
            self.missing[index] = if required && !valid { self.missing[index].saturating_add(1) } else { 0 };
            if self.missing[index] > missing_max_ticks {
                self.latch(now, channel, measured.value(input), Breach::Missing(missing_max_ticks));
            }
            let age_ms = f64::from(measured.age_ns[input as usize]) * 1e-6;
            if required && valid && age_ms > age_max_ms {
                self.latch(now, channel, age_ms, Breach::Stale(age_max_ms));
            }
        }
        // No fixture requires a torque, but one that was told once would go on being judged however old it is.
        let age_ms = f64::from(measured.age_ns[Input::Torque as usize]) * 1e-6;
        if measured.is_valid(Input::Torque) && age_ms > age_max_ms {
            self.latch(now, Channel::Torque, age_ms, Breach::Stale(age_max_ms));
        }
    }

    fn check_heartbeat(&mut self, now: Tick, measured: &Measurement) {
        let age_ms = f64::from(measured.heartbeat_age_ns) * 1e-6;
        if age_ms > self.limits.heartbeat_max_ms {
            self.latch(now, Channel::Heartbeat, age_ms, Breach::Stale(self.limits.heartbeat_max_ms));
        }
    }

    /// Only a free lever has a velocity of its own; under every other fixture the operator moves it.
    fn check_velocity(&mut self, now: Tick, angle_deg: f64) {
        self.velocity_deg_s = None;
        if self.hands_on || self.acting != Some(Fixture::Free) {
            self.velocity.clear();
            return;
        }
        if !angle_deg.is_finite() {
            return;
        }
        let window = self.limits.velocity_window_ticks as usize;
        self.velocity_deg_s = self.velocity.push(now, angle_deg, window);
        if let Some(velocity_deg_s) = self.velocity_deg_s {
            let max = self.limits.velocity_max_deg_s;
            self.check_range(now, Channel::Velocity, velocity_deg_s, -max, max);
        }
    }
}
