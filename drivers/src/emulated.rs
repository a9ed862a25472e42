//! The emulated rig: the model's plant, an operator and sensors, in virtual time.
//!
//! It implements the loop's `Device`: `read` at tick k shows the state at k, the command written at k acts from k to k+1.
//! No clock is read; the same construction and the same commands give the same bytes.
//!
//! What the operator does (`Fixture`) is done at once or at finite speed:
//!
//! | fixture | lever | chambers | torque | volume |
//! |---|---|---|---|---|
//! | `Free` | moves by its torques | pump and valves | none | none |
//! | `Clamped` | led to its angle, then held | as the valves say (below) | read while it stands | none |
//! | `Driven` | led to its angle, smoothly | as the valves say | none | oil in chamber 1, where known |
//! | `Filled` | at its angle at once | at their pressures at once, walls settled | none | none (afterwards known) |
//! | `Released` | as `Clamped` | shut off; oil leaves chamber 1 | read while it stands | released since `Filled`, while the rate is 0 |
//! | `PumpBench` | out of the rig | the pump's ports at these pressures | none | delivered in this segment, every 0.2 s from 0.1 s on, while u != 0 |
//!
//! A lever that is held or led while brake and bypass are closed has its chambers *shut off at their ports*, as in the volume and
//! clamp experiments; a free lever with closed valves has its chambers behind the valve block. A cylinder at rest is read
//! once: the reading stays until the oil moves. The readings at a tick belong to the command before it, so a script ends a reading
//! before its segment does.

mod cylinder;
mod lever;
mod oil;
mod sensors;
mod settings;

pub use settings::{EmulatedError, Noise, Settings};

use cylinder::Cylinder;
use lever::LedLever;
use model::Parameters;
use model::effects::EffectSet;
use model::integrate::{Integrator, MOST_STATES, Trail, states_with};
use model::rec::{self, Circuit, Input, Lever, state};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rt_core::{Command, Device, DeviceError, Fixture, Measurement, PERIOD_NS, Tick};
use sensors::Sensors;

const NAME: &str = "emulated rig";
const PERIOD_S: f64 = PERIOD_NS as f64 * 1e-9;
/// Longest inner step of the integration, time constants of what is fastest.
const TIME_CONSTANTS: f64 = 0.4;

/// Streams of the seed: one a source of chance, so that none shifts another.
mod stream {
    pub const ANGLE: u64 = 0;
    pub const PRESSURE1: u64 = 1;
    pub const PRESSURE2: u64 = 2;
    pub const TORQUE: u64 = 3;
    pub const VOLUME: u64 = 4;
    pub const HAND: u64 = 5;

    pub const COUNT: u64 = 6;
}

fn rng(seed: u64, stream: u64) -> ChaCha8Rng {
    debug_assert!(stream < stream::COUNT);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

/// The pump at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pump {
    /// Voltage at its motor, V.
    pub voltage_v: f64,
    /// Pressure at port 1 over that at port 2, bar.
    pub difference_bar: f64,
    /// Flow from port 2 to port 1, ml/s.
    pub flow_ml_s: f64,
}

/// The emulated rig, for one run: effects that depend on time since the start begin with it. See the module.
pub struct EmulatedRig {
    parameters: [f64; model::parameters::COUNT],
    u_max_v: f64,
    effects: EffectSet<f64>,
    settings: Settings,
    /// Plant states, then the effects'.
    x: Vec<f64>,
    /// Chamber pressures while the pump is on its bench, bar absolute.
    aside_bar: Option<[f64; 2]>,
    command: Command,
    /// The tick of the state; `None` before the first read.
    tick: Option<u64>,
    led: LedLever,
    cylinder: Cylinder,
    sensors: Sensors,
    integrator: Integrator,
    trail: Trail,
    /// What the integrator's step was chosen for.
    integrated: Option<(bool, bool, bool, std::mem::Discriminant<Circuit>)>,
    failed: Option<DeviceError>,
}

impl EmulatedRig {
    /// A rig with these parameters and effects, prepared as the settings say: a free lever stands in its equilibrium.
    ///
    /// # Errors
    /// Settings out of range, more states than the integrator holds, no equilibrium of a free lever.
    pub fn new(parameters: &Parameters, effects: EffectSet<f64>, settings: Settings) -> Result<Self, EmulatedError> {
        settings.check(parameters.pump.u_max)?;
        let states = states_with(&effects);
        if states > MOST_STATES {
            return Err(EmulatedError::States { states, most: MOST_STATES });
        }
        let seed = settings.seed;
        let k = parameters.to_vector();
        let mut rig = EmulatedRig {
            parameters: k,
            u_max_v: parameters.pump.u_max,
            effects,
            x: vec![0.0; states],
            aside_bar: None,
            command: settings.start,
            tick: None,
            led: LedLever::new(settings.lever_speed_deg_s),
            cylinder: Cylinder::new(rng(seed, stream::VOLUME), rng(seed, stream::HAND), &settings),
            sensors: Sensors::new(seed, &settings.noise),
            integrator: Integrator::new(settings.step_s),
            trail: Trail::new(&k),
            integrated: None,
            failed: None,
            settings,
        };
        rig.x[state::PRESSURE1] = rig.settings.fill_bar;
        rig.x[state::PRESSURE2] = rig.settings.fill_bar;
        match rig.command.fixture {
            Fixture::Free => rig.x[state::ANGLE] = rig.equilibrium_rad()?,
            Fixture::Clamped { angle_deg } | Fixture::Driven { angle_deg } | Fixture::Released { angle_deg, .. } => {
                rig.x[state::ANGLE] = angle_deg.to_radians();
            }
            Fixture::Filled { .. } => rig.fill(),
            Fixture::PumpBench { .. } => rig.set_bench(),
        }
        rig.settle();
        Ok(rig)
    }

    /// True state at the last tick that was read: what no sensor shows. For tests and for a sealed truth, not for anything that
    /// identifies. Angle (rad), velocity (rad/s), pressures 1 and 2 (bar absolute), volume (ml), then the effects' states.
    pub fn state(&self) -> &[f64] {
        &self.x
    }

    /// What is in force.
    pub fn command(&self) -> Command {
        self.command
    }

    /// Largest voltage of the pump, V either way.
    pub fn u_max_v(&self) -> f64 {
        self.u_max_v
    }

    /// The pump under the command in force, by eq. (10) without effects: what its amplifier could measure.
    pub fn pump(&self) -> Pump {
        let Command { voltage_v, brake_open, fixture, .. } = self.command;
        let shut_off = !brake_open && !matches!(fixture, Fixture::PumpBench { .. });
        let difference_bar = self.x[state::PRESSURE1] - self.x[state::PRESSURE2];
        let flow_ml_s = if shut_off { 0.0 } else { rec::pump_flow(&self.parameters, voltage_v, difference_bar).0 };
        Pump { voltage_v, difference_bar, flow_ml_s }
    }

    /// Effects' states as after a long rest in the present state.
    fn settle(&mut self) {
        let input = self.input(0.0);
        rec::rest_states(&input, &self.parameters, &self.effects, &mut self.x);
    }

    /// The angle (rad) at which the torques on a lever at rest cancel, by bisection.
    fn equilibrium_rad(&mut self) -> Result<f64, EmulatedError> {
        const RANGE_RAD: f64 = 1.05;
        let mut torque_nm = |angle_rad: f64| {
            self.x[state::ANGLE] = angle_rad;
            self.settle();
            self.held_torque_nm()
        };
        let (mut low, mut high) = (-RANGE_RAD, RANGE_RAD);
        let (at_low, at_high) = (torque_nm(low), torque_nm(high));
        // The torque drives back to the equilibrium from both sides: a spring.
        if !(at_low > 0.0 && at_high < 0.0) {
            return Err(EmulatedError::NoEquilibrium { range_deg: RANGE_RAD.to_degrees(), at_low, at_high });
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            match torque_nm(middle) {
                0.0 => return Ok(middle),
                torque if torque > 0.0 => low = middle,
                _ => high = middle,
            }
        }
        Ok(0.5 * (low + high))
    }

    /// Torque that holds the lever where it stands, Nm.
    fn held_torque_nm(&self) -> f64 {
        let mut scratch = [0.0; MOST_STATES];
        let input = Input { lever: Lever::Led { velocity_rad_s: 0.0 }, ..self.input(0.0) };
        let dx = &mut scratch[..self.x.len()];
        rec::derivative(&input, &self.parameters, &self.effects, self.time_s(), &self.x, dx).torque_nm
    }

    fn time_s(&self) -> f64 {
        self.tick.unwrap_or(0) as f64 * PERIOD_S
    }

    /// The plant's input under the present command, with a led lever at this velocity.
    fn input(&self, velocity_rad_s: f64) -> Input {
        let Command { voltage_v, brake_open, bypass_open, fixture, .. } = self.command;
        let valves_closed = !brake_open && !bypass_open;
        let held = Lever::Led { velocity_rad_s };
        let shut_off = |release_ml_s| if valves_closed { Circuit::ShutOff { release_ml_s } } else { Circuit::Pump };
        let (lever, circuit) = match fixture {
            Fixture::Free => (Lever::Free, Circuit::Pump),
            Fixture::Clamped { .. } | Fixture::Driven { .. } | Fixture::Filled { .. } => (held, shut_off(0.0)),
            Fixture::Released { flow_ml_s, .. } => (held, shut_off(self.cylinder.by_hand(flow_ml_s))),
            Fixture::PumpBench { .. } => (held, Circuit::Bench),
        };
        Input { voltage_v, brake_open, bypass_open, vertical: self.settings.vertical, lever, circuit }
    }

    /// Sets lever and chambers as `Filled` asks, at rest.
    fn fill(&mut self) {
        if let Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar } = self.command.fixture {
            self.x[state::ANGLE] = angle_deg.to_radians();
            self.x[state::VELOCITY] = 0.0;
            self.x[state::PRESSURE1] = pressure1_bar;
            self.x[state::PRESSURE2] = pressure2_bar;
            self.x[state::VOLUME] = 0.0;
            self.led.stop();
            self.settle();
            let oil_ml = oil::in_chamber1_ml(&self.parameters, &self.effects, &self.settings, &self.x);
            self.cylinder.filled(oil_ml);
        }
    }

    /// Takes the pump to its bench, or sets other reservoirs there.
    fn set_bench(&mut self) {
        if let Fixture::PumpBench { pressure1_bar, pressure2_bar } = self.command.fixture {
            self.aside_bar.get_or_insert([self.x[state::PRESSURE1], self.x[state::PRESSURE2]]);
            self.x[state::PRESSURE1] = pressure1_bar;
            self.x[state::PRESSURE2] = pressure2_bar;
        }
    }

    /// Moves the state from one tick to the next under the present command.
    fn advance(&mut self, tick: u64) -> Result<(), DeviceError> {
        let target_deg = match self.command.fixture {
            Fixture::Filled { .. } => return Ok(()),
            Fixture::Free | Fixture::PumpBench { .. } => None,
            Fixture::Clamped { angle_deg } | Fixture::Driven { angle_deg } | Fixture::Released { angle_deg, .. } => {
                Some(angle_deg)
            }
        };
        let velocity_rad_s = match target_deg {
            Some(angle_deg) => self.led.velocity_rad_s(self.x[state::ANGLE], angle_deg.to_radians(), PERIOD_S),
            None => 0.0,
        };
        let input = self.input(velocity_rad_s);
        let free = input.lever == Lever::Free;
        let kind = (free, input.brake_open, input.bypass_open, std::mem::discriminant(&input.circuit));
        if self.integrated != Some(kind) {
            // A held lever leaves nothing that is fast but the effects, which the integrator looks at itself.
            let longest_s = if free { self.settings.step_s } else { PERIOD_S };
            let (k, effects) = (&self.parameters, &self.effects);
            self.integrator = Integrator::within_time_constant(longest_s, TIME_CONSTANTS, k, effects, &input, &self.x);
            self.integrated = Some(kind);
        }
        let t = tick as f64 * PERIOD_S;
        self.integrator
            .advance_along(&mut self.trail, &input, &self.parameters, &self.effects, t, PERIOD_S, &mut self.x)
            .map_err(|error| DeviceError { device: NAME, tick, what: error.to_string() })?;
        match input.lever {
            Lever::Free => self.led.moves_at(self.x[state::VELOCITY]),
            Lever::Led { velocity_rad_s } => self.x[state::VELOCITY] = velocity_rad_s,
            Lever::Carried => {}
        }
        Ok(())
    }

    fn measure(&mut self, tick: u64) -> Measurement {
        let mut scratch = [0.0; MOST_STATES];
        let scratch = &mut scratch[..self.x.len()];
        let shown = rec::shown(&self.effects, tick as f64 * PERIOD_S, &self.x, scratch);
        let fixture = self.command.fixture;
        let stands = self.led.stands();
        let torque_nm = match fixture {
            Fixture::Clamped { .. } | Fixture::Released { .. } if stands => self.held_torque_nm(),
            _ => f64::NAN,
        };
        let shut_off = !self.command.brake_open && !self.command.bypass_open;
        let volume_ml = self.cylinder.read(&self.command, shut_off, tick, self.x[state::VOLUME]);
        let on_bench = matches!(fixture, Fixture::PumpBench { .. });
        self.sensors.show(shown, on_bench, torque_nm, volume_ml)
    }

    fn refuse(&self, tick: u64, what: String) -> DeviceError {
        DeviceError { device: NAME, tick, what }
    }

    /// Moves the state on to this tick.
    fn reach(&mut self, now: Tick) -> Result<(), DeviceError> {
        let mut tick = self.tick.unwrap_or(now.index);
        if tick > now.index {
            return Err(self.refuse(now.index, format!("expected no tick before {tick}: time went backwards")));
        }
        while tick < now.index {
            if let Err(error) = self.advance(tick) {
                self.failed = Some(error.clone());
                return Err(error);
            }
            tick += 1;
        }
        self.tick = Some(tick);
        Ok(())
    }

    /// What no rig could be told.
    fn check(&self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        settings::check_command(command, self.u_max_v).map_err(|what| self.refuse(now.index, what))
    }
}

impl Device for EmulatedRig {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        self.reach(now)?;
        Ok(self.measure(now.index))
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        if let Some(error) = &self.failed {
            return Err(error.clone());
        }
        self.reach(now)?;
        self.check(now, command)?;
        let before = std::mem::replace(&mut self.command, *command);
        if let (Some(pressure_bar), false) = (self.aside_bar, matches!(command.fixture, Fixture::PumpBench { .. })) {
            self.aside_bar = None;
            self.x[state::PRESSURE1] = pressure_bar[0];
            self.x[state::PRESSURE2] = pressure_bar[1];
            self.x[state::VOLUME] = 0.0;
            self.settle();
        }
        if self.cylinder.told(&before, command, now.index) {
            self.x[state::VOLUME] = 0.0;
        }
        match command.fixture {
            Fixture::Filled { .. } if before.fixture != command.fixture => self.fill(),
            Fixture::PumpBench { .. } => self.set_bench(),
            _ => {}
        }
        Ok(())
    }
}
