//! Seeded fault injection around any device, real or emulated.
//!
//! [`Faulty`] stands where the loop meets its device. What each fault does there is told in [`rt_core::fault`]. The same faults,
//! seed and ticks give the same run: whether a fault hits a frame depends on the seed, its place in the list and the tick alone.
//! The begin and the end of each fault, and how often it struck, go to the driver's journal and so into the recording.
//!
//! On a sensor's way to the loop, faults of the sensor come first (`stuck`, `drift`, `nan`), then what happens to its frames, in
//! the list's order. A frame is taken away by one fault at most.

mod injected;
mod route;
mod sensor;

use crate::journal::Journal;
use injected::Injected;
use route::Route;
use rt_core::fault::{self, Fault, FaultError, FaultKind, MOST_DELAY_TICKS, MOST_FAULTS, Valve};
use rt_core::{Command, Device, DeviceError, Fixture, Input, Measurement, SafeState, Tick};
use sensor::{Frame, Sensor};

/// A device whose wires and parts fail as a list of faults says. Without faults it is the device itself.
///
/// A fault is injected, no accident: when the run is over ([`Faulty::end_run`], or this is dropped) the device gets what was
/// withheld from it, with 0 V.
pub struct Faulty<D: Device> {
    device: D,
    faults: Vec<Injected>,
    journal: Journal,
    safe_state: SafeState,
    sensors: [Sensor; 5],
    voltage: Route<f64>,
    valves: Route<ValveCommand>,
    /// The amplifier was gone or faulty: 0 V until the operator's word.
    disarmed: bool,
    /// Last time at which all drivers had heard from their nodes, ns since the run's start.
    alive_ns: i64,
    /// What the loop wrote last, and what the device got.
    last: Option<(Tick, Command)>,
    delivered: Option<Command>,
}

/// What goes to valves and fixture.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ValveCommand {
    brake_open: bool,
    bypass_open: bool,
    fixture: Fixture,
    segment: u32,
}

impl<D: Device> Faulty<D> {
    /// The device with these faults. `seed` decides which frames they hit.
    ///
    /// # Errors
    /// More than [`MOST_FAULTS`], or one whose numbers are out of range.
    pub fn new(device: D, faults: &[Fault], seed: u64, journal: Journal) -> Result<Self, FaultError> {
        if faults.len() > MOST_FAULTS {
            let (number, got) = (faults.len(), faults.len() as f64);
            let expected = format!("at most {MOST_FAULTS}");
            return Err(FaultError { number, name: "list", field: "its length", expected, got });
        }
        for (index, fault) in faults.iter().enumerate() {
            fault.check(index + 1)?;
        }
        let (mut delays, mut amplifier, mut nodes) = ([0u32; 7], None, None);
        let shorter =
            |known: &mut Option<u32>, ticks: u32| *known = Some(known.map_or(ticks, |known| known.min(ticks)));
        for fault in faults {
            match fault.kind {
                FaultKind::Late { route, ticks, .. } => {
                    let place = match route {
                        fault::Route::Input(input) => input as usize,
                        fault::Route::Voltage { .. } => 5,
                        fault::Route::Valves { .. } => 6,
                    };
                    delays[place] = delays[place].max(ticks).min(MOST_DELAY_TICKS);
                }
                FaultKind::PortGone { timeout_ticks } => shorter(&mut amplifier, timeout_ticks),
                FaultKind::BusOff { timeout_ticks } => shorter(&mut nodes, timeout_ticks),
                _ => {}
            }
            match fault.kind {
                FaultKind::Lost { route } | FaultKind::Late { route, .. } => match route {
                    fault::Route::Input(_) => {}
                    fault::Route::Voltage { timeout_ticks } => shorter(&mut amplifier, timeout_ticks),
                    fault::Route::Valves { timeout_ticks } => shorter(&mut nodes, timeout_ticks),
                },
                _ => {}
            }
        }
        let hits = |input: Input| faults.iter().any(|f| f.kind.input() == Some(input));
        let bus = faults.iter().any(|f| matches!(f.kind, FaultKind::BusOff { .. }));
        Ok(Faulty {
            device,
            faults: faults.iter().enumerate().map(|(index, fault)| Injected::new(*fault, index, seed)).collect(),
            journal,
            safe_state: SafeState::default(),
            sensors: Input::ALL.map(|input| Sensor::new(input, bus || hits(input), delays[input as usize])),
            voltage: Route::new(delays[5], amplifier),
            valves: Route::new(delays[6], nodes),
            disarmed: false,
            alive_ns: 0,
            last: None,
            delivered: None,
        })
    }

    /// Where the valve nodes go by themselves when they hear no commands; [`SafeState::default`] where this is not said.
    pub fn with_safe_state(mut self, safe_state: SafeState) -> Self {
        self.safe_state = safe_state;
        self
    }

    /// The device inside.
    pub fn device(&self) -> &D {
        &self.device
    }

    /// The device inside, for what is no part of a run.
    pub fn device_mut(&mut self) -> &mut D {
        &mut self.device
    }

    /// The operator's word: the amplifier's cause of fault is removed, commands are obeyed again.
    pub fn arm(&mut self) {
        self.disarmed = false;
    }

    /// Begins and ends what begins and ends by this tick.
    fn reach(&mut self, now: Tick) {
        for fault in &mut self.faults {
            let ended = fault.reach(now, &mut self.journal);
            self.disarmed |= ended && matches!(fault.kind(), FaultKind::PortGone { .. });
            self.disarmed |= fault.acting() && matches!(fault.kind(), FaultKind::AmplifierFault { .. });
        }
    }

    /// Counts a tick for each fault that acts and is one of these, and says whether there is one.
    fn strike(&mut self, is: impl Fn(&FaultKind) -> bool) -> bool {
        let mut any = false;
        for fault in self.faults.iter_mut().filter(|fault| fault.acting() && is(&fault.kind())) {
            fault.struck();
            any = true;
        }
        any
    }

    /// What the amplifier has in force.
    fn voltage_v(&mut self, now: Tick, commanded_v: f64) -> f64 {
        let gone = |fault: &Injected| fault.acting() && matches!(fault.kind(), FaultKind::PortGone { .. });
        if self.faults.iter().any(gone) {
            self.voltage.cut();
        } else {
            let of = |route| matches!(route, fault::Route::Voltage { .. });
            send(&mut self.voltage, &mut self.faults, now, commanded_v, of);
        }
        if self.disarmed { 0.0 } else { self.voltage.in_force(now).unwrap_or(0.0) }
    }

    /// What valves and fixture have in force.
    fn valve_command(&mut self, now: Tick, commanded: ValveCommand) -> ValveCommand {
        let off = |fault: &Injected| fault.acting() && matches!(fault.kind(), FaultKind::BusOff { .. });
        if self.faults.iter().any(off) {
            self.valves.cut();
        } else {
            let of = |route| matches!(route, fault::Route::Valves { .. });
            send(&mut self.valves, &mut self.faults, now, commanded, of);
        }
        let SafeState { brake_open, bypass_open } = self.safe_state;
        let mut in_force = match (self.valves.in_force(now), self.valves.newest()) {
            (Some(command), _) => command,
            (None, Some(last)) => ValveCommand { brake_open, bypass_open, fixture: last.fixture.at_rest(), ..last },
            (None, None) => ValveCommand { brake_open, bypass_open, ..commanded },
        };
        for fault in self.faults.iter_mut().filter(|fault| fault.acting()) {
            let FaultKind::ValveStuck { valve, open } = fault.kind() else { continue };
            let (valve_open, stood_open) = match valve {
                Valve::Brake => (&mut in_force.brake_open, self.delivered.map(|last| last.brake_open)),
                Valve::Bypass => (&mut in_force.bypass_open, self.delivered.map(|last| last.bypass_open)),
            };
            let stands_open = open.unwrap_or_else(|| fault.remember_open(stood_open.unwrap_or(*valve_open)));
            if std::mem::replace(valve_open, stands_open) != stands_open {
                fault.struck();
            }
        }
        in_force
    }
}

/// Sends a command on its way, unless a fault that acts on this route has it lost or late.
fn send<T: Copy>(
    route: &mut Route<T>,
    faults: &mut [Injected],
    now: Tick,
    command: T,
    of: impl Fn(fault::Route) -> bool,
) {
    let mut delay_ticks = Some(0);
    for fault in faults.iter_mut().filter(|fault| fault.acting()) {
        let hit_delay = match fault.kind() {
            FaultKind::Lost { route } if of(route) => None,
            FaultKind::Late { route, ticks, .. } if of(route) => Some(u64::from(ticks)),
            _ => continue,
        };
        if delay_ticks == Some(0) && fault.hits(now) {
            delay_ticks = hit_delay;
            fault.struck();
        }
    }
    match delay_ticks {
        Some(0) => {
            route.deliver(now);
            route.arrive(now, command);
        }
        Some(ticks) => {
            route.send_late(now, ticks, command);
            route.deliver(now);
        }
        None => {
            route.skip();
            route.deliver(now);
        }
    }
}

impl<D: Device> Device for Faulty<D> {
    fn begin_run(&mut self, origin_ns: u64) {
        // An unfinished run before this one is closed; what the device says to that it says again to the first command.
        let _ = self.end_run();
        self.faults.iter_mut().for_each(Injected::begin_run);
        self.sensors.iter_mut().for_each(Sensor::begin_run);
        self.voltage.begin_run();
        self.valves.begin_run();
        self.disarmed = false;
        self.alive_ns = 0;
        self.last = None;
        self.delivered = None;
        self.device.begin_run(origin_ns);
    }

    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let mut measured = self.device.read(now)?;
        if self.faults.is_empty() {
            return Ok(measured);
        }
        self.reach(now);
        let bus_off = self.strike(|kind| matches!(kind, FaultKind::BusOff { .. }));
        let port_gone = self.strike(|kind| matches!(kind, FaultKind::PortGone { .. }));
        let now_ns = now.scheduled_ns as i64;
        for sensor in self.sensors.iter_mut().filter(|sensor| sensor.concerned) {
            let given = Frame::of(&measured, sensor.input, now_ns);
            sensor.hear(given, now, bus_off, &mut self.faults);
            sensor.show(now_ns, &mut measured);
        }
        if bus_off || port_gone {
            let silent_ns = u32::try_from(now_ns - self.alive_ns).unwrap_or(u32::MAX);
            measured.heartbeat_age_ns = measured.heartbeat_age_ns.max(silent_ns);
        } else {
            self.alive_ns = now_ns - i64::from(measured.heartbeat_age_ns);
        }
        let faulty = self.faults.iter_mut().filter(|fault| fault.acting()).find_map(|fault| match fault.kind() {
            FaultKind::AmplifierFault { code } => Some((fault, code)),
            _ => None,
        });
        if let Some((fault, code)) = faulty {
            fault.struck();
            // As the wired rig says it.
            let what = format!(
                "expected no fault, got fault code {code} (injected); remove its cause, then start the run again"
            );
            return Err(DeviceError { device: "amplifier", tick: now.index, what });
        }
        Ok(measured)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        if self.faults.is_empty() {
            return self.device.write(now, command);
        }
        self.reach(now);
        let Command { voltage_v, brake_open, bypass_open, fixture, segment } = *command;
        let voltage_v = self.voltage_v(now, voltage_v);
        let valves = self.valve_command(now, ValveCommand { brake_open, bypass_open, fixture, segment });
        let ValveCommand { brake_open, bypass_open, fixture, segment } = valves;
        let in_force = Command { voltage_v, brake_open, bypass_open, fixture, segment };
        self.last = Some((now, *command));
        self.delivered = Some(in_force);
        self.device.write(now, &in_force)
    }

    /// The run is over: faults that still act end with it, which is noted, and the device gets the last command that was
    /// withheld from it, with 0 V.
    fn end_run(&mut self) -> Result<(), DeviceError> {
        let Some((now, command)) = self.last.take() else { return Ok(()) };
        let mut acted = self.disarmed;
        for fault in &mut self.faults {
            acted |= fault.end_run(now, &mut self.journal);
        }
        let (Some(delivered), true) = (self.delivered.take(), acted) else { return Ok(()) };
        let last = Command { voltage_v: 0.0, ..command };
        if last == delivered { Ok(()) } else { self.device.write(now, &last) }
    }
}

impl<D: Device> Drop for Faulty<D> {
    fn drop(&mut self) {
        // The device is dropped next, and goes to its safe state by itself.
        let _ = self.end_run();
    }
}
