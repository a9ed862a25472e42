//! A fixture as it goes over the bus.

use rt_core::Fixture;

/// How a fixture is named on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs, reason = "the names are those of rt_core::Fixture")]
pub enum FixtureKind {
    Free = 0,
    Clamped = 1,
    Driven = 2,
    Filled = 3,
    Released = 4,
    PumpBench = 5,
}

/// A fixture as the numbers that go over the bus; what a kind does not use is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FixtureNumbers {
    pub kind: FixtureKind,
    pub angle_deg: f64,
    pub pressure1_bar: f64,
    pub pressure2_bar: f64,
    pub flow_ml_s: f64,
}

impl From<Fixture> for FixtureNumbers {
    fn from(fixture: Fixture) -> Self {
        let none = FixtureNumbers {
            kind: FixtureKind::Free,
            angle_deg: 0.0,
            pressure1_bar: 0.0,
            pressure2_bar: 0.0,
            flow_ml_s: 0.0,
        };
        match fixture {
            Fixture::Free => none,
            Fixture::Clamped { angle_deg } => FixtureNumbers { kind: FixtureKind::Clamped, angle_deg, ..none },
            Fixture::Driven { angle_deg } => FixtureNumbers { kind: FixtureKind::Driven, angle_deg, ..none },
            Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar } => {
                FixtureNumbers { kind: FixtureKind::Filled, angle_deg, pressure1_bar, pressure2_bar, ..none }
            }
            Fixture::Released { angle_deg, flow_ml_s } => {
                FixtureNumbers { kind: FixtureKind::Released, angle_deg, flow_ml_s, ..none }
            }
            Fixture::PumpBench { pressure1_bar, pressure2_bar } => {
                FixtureNumbers { kind: FixtureKind::PumpBench, pressure1_bar, pressure2_bar, ..none }
            }
        }
    }
}

impl FixtureNumbers {
    /// The fixture again; `None` for a kind that there is not.
    pub fn fixture(
        kind: u8,
        angle_deg: f64,
        pressure1_bar: f64,
        pressure2_bar: f64,
        flow_ml_s: f64,
    ) -> Option<Fixture> {
        Some(match kind {
            0 => Fixture::Free,
            1 => Fixture::Clamped { angle_deg },
            2 => Fixture::Driven { angle_deg },
            3 => Fixture::Filled { angle_deg, pressure1_bar, pressure2_bar },
            4 => Fixture::Released { angle_deg, flow_ml_s },
            5 => Fixture::PumpBench { pressure1_bar, pressure2_bar },
            _ => return None,
        })
    }
}
