//! What a target in a sample is of: the list of numbers, names and units.

/// What [`Sample::target`](super::Sample::target) is a value of. The number stands in
/// [`Sample::target_of`](super::Sample::target_of); 0 there is no target at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum TargetKind {
    /// The command itself: open loop.
    Voltage = 1,
    /// Flow of the pump into chamber 1.
    Flow = 2,
    /// Pressure of chamber 1, absolute.
    Pressure1 = 3,
    /// Pressure of chamber 2, absolute.
    Pressure2 = 4,
    /// Pressure of chamber 1 above that of chamber 2.
    PressureDifference = 5,
    /// Angle of the lever.
    Angle = 6,
}

impl TargetKind {
    /// All of them, in the order of their numbers, with name and unit.
    pub const LIST: [(TargetKind, &str, &str); 6] = [
        (TargetKind::Voltage, "voltage", "V"),
        (TargetKind::Flow, "flow", "ml/s"),
        (TargetKind::Pressure1, "pressure of chamber 1", "bar"),
        (TargetKind::Pressure2, "pressure of chamber 2", "bar"),
        (TargetKind::PressureDifference, "pressure difference", "bar"),
        (TargetKind::Angle, "angle", "deg"),
    ];

    /// Its number in a sample.
    pub const fn code(self) -> u32 {
        self as u32
    }

    /// The kind with this number; `None` for 0 and for numbers that nobody has given out yet.
    pub fn of_code(code: u32) -> Option<TargetKind> {
        let (kind, _, _) = Self::LIST.into_iter().find(|(kind, _, _)| kind.code() == code)?;
        Some(kind)
    }

    /// What it is called.
    pub fn name(self) -> &'static str {
        let (_, name, _) = Self::LIST[self as usize - 1];
        name
    }

    /// The target's unit.
    pub fn unit(self) -> &'static str {
        let (_, _, unit) = Self::LIST[self as usize - 1];
        unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers stand in recordings and in other languages' clients.
    #[test]
    fn the_list_is_in_the_order_of_its_numbers() {
        for (at, (kind, name, unit)) in TargetKind::LIST.into_iter().enumerate() {
            assert_eq!(kind.code() as usize, at + 1);
            assert_eq!(TargetKind::of_code(kind.code()), Some(kind));
            assert_eq!((kind.name(), kind.unit()), (name, unit));
        }
        assert_eq!((TargetKind::of_code(0), TargetKind::of_code(7)), (None, None));
    }
}
