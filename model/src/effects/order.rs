//! In which order effects act on a port: what a set of them does must not depend on how they were found.

/// Ids of the library along the way of what they change, whatever order they are given in. Effects on one port that are not kept apart below do not
/// depend on each other, but for rounding.
const ORDER: [&str; 22] = [
    // what the pump is told
    "pump_lag",
    "brake_valve_lag",
    "bypass_valve_lag",
    // the pump's flow, before the line that it has to set in motion
    "pump_asymmetry",
    "pump_warming",
    "line_inertance",
    // flows between chambers and outside
    "cross_leakage",
    "external_leakage",
    "wall_creep",
    // the characteristics that the chambers have in common, how the second one differs, and what is in it
    "displacement_pressure",
    "chamber_asymmetry",
    "trapped_air",
    // a play displaces as the chambers do in the end
    "backlash",
    // torques
    "tilt",
    "pressure_friction",
    "torque_cubic",
    "stribeck_friction",
    "elastic_hysteresis",
    "end_stop",
    // a sensor shows late what it measures, and its zero is that of what it shows
    "pressure_lag",
    "pressure_drift",
    "angle_offset",
];

/// Place of an effect among those that act. A general form has its plain one's; effects of other plants and nameless terms come last, alike, in the order
/// given.
pub(super) fn rank(id: &str) -> usize {
    ORDER.iter().position(|each| *each == id).unwrap_or(ORDER.len())
}

#[cfg(test)]
mod tests {
    use super::super::empirical::EMPIRICAL;
    use super::super::{LIBRARY, MECHANICAL};
    use super::*;

    #[test]
    fn every_effect_of_the_library_has_its_place() {
        assert_eq!(ORDER.len(), LIBRARY.len());
        for effect in LIBRARY {
            let id = effect.header().id;
            assert!(rank(id) < ORDER.len(), "{id} has no place in the order of effects");
        }
        for effect in EMPIRICAL.iter().chain(MECHANICAL) {
            assert_eq!(rank(effect.header().id), ORDER.len(), "{effect:?}: after the library, in the order given");
        }
    }
}
