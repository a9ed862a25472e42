//! The rig's device over the runs of a session: the emulated rig is made anew for each run, a rig on wires stays open and is prepared
//! for each. Faults that a profile asks for are put around either.

use crate::emulation::rig_for;
use crate::failure::{Failure, Kind};
use crate::operator;
use crate::rig_file::DeviceSpec;
use crate::runner::Mode;
use drivers::dbc::Database;
use drivers::faults::Faulty;
use drivers::journal::JournalReader;
use drivers::wired::{Preparation, WiredError, WiredRig};
use model::ModelFile;
use profiles::{Hands, Plane, Script};
use rt_core::system::{self, Request};
use rt_core::{Device, SafeState, Switches};

/// The I/O threads' priority lies below the loop's by this much: the loop preempts them.
const IO_BELOW: u8 = 5;

/// Who does the operator's part: an emulated rig does it itself, one on wires where its rig file maps an automatic fixture.
pub fn hands_of(spec: &DeviceSpec) -> Hands {
    match spec {
        DeviceSpec::Wired(settings) if settings.can.fixture.is_none() => Hands::People,
        DeviceSpec::Wired(_) | DeviceSpec::Emulated(_) => Hands::Rig,
    }
}

/// See the module.
pub enum Devices {
    /// In this process, in any time.
    Emulated {
        /// The plant with its effects.
        plant: Box<ModelFile>,
    },
    /// On wires.
    Wired(Box<WiredRig>),
}

impl Devices {
    /// Opens the device.
    ///
    /// # Errors
    /// A wired rig in virtual time (2); a port, an interface or an amplifier that does not answer as it must (4).
    pub fn open(
        spec: &DeviceSpec,
        safe_state: SafeState,
        mode: &Mode,
        journals: &mut JournalReader,
    ) -> Result<Devices, Failure> {
        let settings = match spec {
            DeviceSpec::Emulated(plant) => return Ok(Devices::Emulated { plant: plant.clone() }),
            DeviceSpec::Wired(settings) => settings,
        };
        let Mode::RealTime { request, .. } = mode else {
            let message = "expected real time, got virtual time: a rig on wires has its own time; add --realtime";
            return Err(Failure::new(Kind::Input, message));
        };
        let database = Database::read(&settings.can.dbc).map_err(|e| Failure::of(Kind::Input, &e))?;
        let below = Request { priority: request.priority.saturating_sub(IO_BELOW).max(1), ..request.clone() };
        // The loop's own thread asks the same and says what is refused.
        let thread = move || drop(system::prepare_thread(&below));
        let rig = WiredRig::open(settings, &database, safe_state, thread, journals)
            .map_err(|error| Failure::of(if error.is_configuration() { Kind::Input } else { Kind::Device }, &error))?;
        Ok(Devices::Wired(Box::new(rig)))
    }

    /// Who does the operator's part: an emulated rig does it itself, one on wires where its rig file maps an automatic fixture.
    pub fn hands(&self) -> Hands {
        match self {
            Devices::Emulated { .. } => Hands::Rig,
            Devices::Wired(rig) if rig.has_fixture() => Hands::Rig,
            Devices::Wired(_) => Hands::People,
        }
    }

    /// The device at the start of run number `run` of the session, prepared as the script asks, with the faults that it asks for.
    ///
    /// # Errors
    /// A rig that can't be made (2, 4); a rig on wires that is not ready (4); a stop (130) or an emergency stop (5), which arms nothing.
    pub fn prepare<'a>(
        &'a mut self,
        script: &Script,
        seed: u64,
        run: usize,
        safe_state: SafeState,
        journals: &mut JournalReader,
        switches: &Switches,
    ) -> Result<Box<dyn Device + Send + 'a>, Failure> {
        operator::still_wanted(script, switches)?;
        let device: Box<dyn Device + Send + 'a> = match self {
            Devices::Emulated { plant } => Box::new(rig_for(plant, script, seed, run)?),
            Devices::Wired(rig) => {
                if let Err(error) = rig.prepare(preparation(script, run), switches) {
                    if matches!(error, WiredError::Stopped) {
                        operator::still_wanted(script, switches)?;
                    }
                    return Err(Failure::of(Kind::Device, &error));
                }
                Box::new(&mut **rig)
            }
        };
        if script.faults.is_empty() {
            return Ok(device);
        }
        let faulty = Faulty::new(device, &script.faults, seed, journals.journal("faults"));
        Ok(Box::new(faulty.map_err(|e| Failure::of(Kind::Input, &e))?.with_safe_state(safe_state)))
    }
}

fn preparation(script: &Script, run: usize) -> Preparation {
    let fill_bar = script.fill_bar.unwrap_or(drivers::emulated::Settings::default().fill_bar);
    Preparation { run: (run % 256) as u8, vertical: script.plane == Plane::Vertical, fill_bar, start: script.start() }
}
