//! The REC rig as a plant of the engine: its own simulation ([`crate::predict`]), parameters of [`model::Parameters`].

use model::Parameters;
use model::effects::{Balance, LIBRARY};
use model::integrate::SimulationError;
use model::parameters::{COUNT, NAMES, UNITS, close_losses, index};
use model::port::PortKind;
use model::scalar::Tangent;

use crate::false_minimum::with_plain_losses;
use crate::layout::Layout;
use crate::plant::{BaseParameter, Plant, PlantHeader, Quantity};
use crate::predict::{self, Linear};
use crate::prepare::{Stand, Stretch};

/// The hydraulic actuator with rotary elastic chambers.
pub struct Rec;

/// The rig.
pub static REC: Rec = Rec;

/// Base parameters that an identification may free. `l4` follows from the continuity of eq. (16), `a2` can't be told from
/// the scale of h1 and h3, and J, G are known of the rig.
pub const FREE: [usize; 18] = {
    use index::*;
    [M1, M2, M3, H1, H2, H3, A1, V1, V2, F1, F2, F3, F4, L1, L2, L3, A, K_B]
};

/// Length of a cluster where the lever moves freely, s: several times what the residual remembers.
const CLUSTER_S: f64 = 5.0;

/// Bounds of a plant parameter.
const fn bounds(parameter: usize) -> (f64, f64) {
    use index::*;
    match parameter {
        H1 | V2 | F1 | K_B | M3 => (1e-9, f64::INFINITY),
        // the capacity falls with pressure and stays positive
        H2 => (-6.0, -0.05),
        H3 => (0.0, f64::INFINITY),
        A => (3e-3, 0.2),
        // losses take energy; their growth may weaken with speed, but not by much
        L1 => (-10.0, f64::INFINITY),
        L2 | L3 => (0.0, f64::INFINITY),
        // the pump slips backwards
        F3 => (f64::NEG_INFINITY, 0.0),
        _ => (f64::NEG_INFINITY, f64::INFINITY),
    }
}

/// A fit of the rig starts from the component experiments, not from a value that is known before.
const PARAMETERS: [BaseParameter; COUNT] = {
    let mut all = [BaseParameter { name: "", unit: "", lower: 0.0, upper: 0.0, start: f64::NAN }; COUNT];
    let mut i = 0;
    while i < COUNT {
        let (lower, upper) = bounds(i);
        all[i] = BaseParameter { name: NAMES[i], unit: UNITS[i], lower, upper, start: f64::NAN };
        i += 1;
    }
    all
};

const fn quantity(name: &'static str, unit: &'static str) -> Quantity {
    Quantity { name, unit }
}

static HEADER: PlantHeader = PlantHeader {
    id: "rec",
    summary: "hydraulic actuator with rotary elastic chambers",
    equation: "J phi'' = M(phi, dp) - losses(phi') - G sin(phi); C(phi, p_i) p_i' = Q_i - V'(phi) phi'",
    states: &[
        quantity("angle", "rad"),
        quantity("velocity", "rad/s"),
        quantity("pressure1", "bar"),
        quantity("pressure2", "bar"),
        quantity("volume", "ml"),
    ],
    inputs: &[quantity("voltage", "V"), quantity("brake_open", "1"), quantity("bypass_open", "1")],
    channels: &[
        quantity("angle", "deg"),
        quantity("pressure1", "bar"),
        quantity("pressure2", "bar"),
        quantity("torque", "Nm"),
        quantity("volume", "ml"),
    ],
    parameters: &PARAMETERS,
    balances: &[
        (Balance::Torque, "torque"),
        (Balance::Flow, "flow"),
        (Balance::Pump, "pump"),
        (Balance::Sensor, "sensor"),
    ],
    ports: &[PortKind::Actuator, PortKind::Line, PortKind::Hydraulic, PortKind::Mechanical, PortKind::Sensor],
    library: LIBRARY,
};

impl Plant for Rec {
    fn header(&self) -> &'static PlantHeader {
        &HEADER
    }

    fn cluster_s(&self, stretch: &Stretch) -> Option<f64> {
        matches!(stretch.stand, Stand::Free | Stand::Led).then_some(CLUSTER_S)
    }

    fn rest_rows(&self, stretch: &Stretch) -> usize {
        if stretch.stand != Stand::Free {
            return 0;
        }
        stretch.voltage_v.iter().position(|u| *u != 0.0).unwrap_or(stretch.rows())
    }

    fn can_be_guided(&self) -> bool {
        true
    }

    fn complete_values(&self, k: &mut [f64]) {
        close_losses(k);
    }

    fn complete_tangents(&self, k: &mut [Tangent]) {
        close_losses(k);
    }

    fn unbend(&self, k: &mut [f64]) {
        if let Ok(own) = <&[f64; COUNT]>::try_from(&*k) {
            // the largest voltage is none of them
            let plain = with_plain_losses(Parameters::from_vector(own, 0.0));
            k.copy_from_slice(&plain.to_vector());
        }
    }

    fn predict(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Vec<f64>, SimulationError> {
        predict::predict(stretch, layout, theta, initial)
    }

    fn linearise(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Linear, SimulationError> {
        predict::linearise(stretch, layout, theta, initial)
    }

    fn rows(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Vec<Vec<f64>>, SimulationError> {
        Ok(predict::predict_rows(stretch, layout, theta, initial)?.iter().map(|y| y.to_vec()).collect())
    }
}

/// What only a layout of the rig has.
impl Layout {
    /// Everything of [`FREE`] free, no effect.
    pub fn base(start: &Parameters) -> Self {
        Layout {
            plant: &REC,
            base: FREE.to_vec(),
            effects: Vec::new(),
            fixed: start.to_vector().to_vec(),
            u_max: start.pump.u_max,
            held: Default::default(),
        }
    }

    /// Its plant is the rig.
    pub fn is_of_the_rig(&self) -> bool {
        self.plant.header().id == HEADER.id
    }

    /// The free entries of a full parameter set, without effects.
    pub fn vector_of(&self, p: &Parameters) -> Vec<f64> {
        let full = p.to_vector();
        self.base.iter().map(|&i| full[i]).collect()
    }

    /// The reference model's part of these values.
    pub fn parameters(&self, theta: &[f64]) -> Parameters {
        let (k, _) = self.expand(theta);
        Parameters::from_vector(k[..].try_into().expect("expand gives a whole parameter vector"), self.u_max)
    }
}
