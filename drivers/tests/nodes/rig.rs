//! The rigs of these tests.

use drivers::EmulatedRig;
use drivers::emulated::Settings;
use drivers::nodes::{Plant, PlantFactory};
use drivers::wired::Preparation;
use model::Parameters;
use model::effects::EffectSet;
use rt_core::{Command, Fixture, SafeState};

pub const MS: u64 = 1_000_000;
pub const NODE_TIMEOUT_NS: u64 = 50 * MS;

/// A free lever with open brake.
pub const FREE: Command =
    Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };

pub fn preparation(run: u8, start: Command) -> Preparation {
    Preparation { run, vertical: false, fill_bar: 2.8, start }
}

/// The rig of this preparation, as it is in process.
pub fn in_process(preparation: &Preparation) -> EmulatedRig {
    let Preparation { run, vertical, fill_bar, start } = *preparation;
    let settings = Settings { start, fill_bar, vertical, seed: 100 + u64::from(run), ..Settings::default() };
    EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings).unwrap()
}

pub fn factory() -> PlantFactory {
    Box::new(|preparation| {
        let Preparation { run, vertical, fill_bar, start } = *preparation;
        let settings = Settings { start, fill_bar, vertical, seed: 100 + u64::from(run), ..Settings::default() };
        EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings)
    })
}

/// A plant as it is before anybody has said anything.
pub fn plant() -> Plant {
    Plant::new(factory(), in_process(&preparation(0, FREE)), NODE_TIMEOUT_NS, SafeState::default())
}
