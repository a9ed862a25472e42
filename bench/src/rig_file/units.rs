//! Units as databases spell them, against the unit of a channel.

/// Spellings of a unit, with what one of it is in the channel's: gain and offset.
type Spelling = (&'static [&'static str], f64, f64);

/// A unit of a channel.
#[derive(Debug)]
pub(super) struct Unit {
    pub(super) name: &'static str,
    /// The first are the unit itself.
    spellings: &'static [Spelling],
}

pub(super) const DEGREE: Unit = Unit {
    name: "deg",
    spellings: &[
        (&["deg", "Deg", "DEG", "°", "degree", "degrees"], 1.0, 0.0),
        (&["mdeg"], 1e-3, 0.0),
        (&["rad"], 57.295_779_513_082_32, 0.0),
        (&["mrad"], 0.057_295_779_513_082_32, 0.0),
        (&["rev", "turn", "turns"], 360.0, 0.0),
    ],
};

pub(super) const BAR: Unit = Unit {
    name: "bar",
    spellings: &[
        (&["bar", "Bar", "BAR", "bara", "bar(a)", "bar_a"], 1.0, 0.0),
        // Above the air's pressure, 1.01325 bar by definition.
        (&["barg", "bar(g)", "bar_g"], 1.0, 1.01325),
        (&["mbar", "hPa"], 1e-3, 0.0),
        (&["Pa"], 1e-5, 0.0),
        (&["kPa", "kpa", "KPa"], 1e-2, 0.0),
        (&["MPa"], 10.0, 0.0),
        (&["psi", "PSI", "psia"], 0.068_947_572_931_683_6, 0.0),
        (&["psig"], 0.068_947_572_931_683_6, 1.01325),
    ],
};

pub(super) const NEWTON_METRE: Unit = Unit {
    name: "Nm",
    spellings: &[
        (&["Nm", "N.m", "N*m", "N·m", "N m"], 1.0, 0.0),
        (&["mNm"], 1e-3, 0.0),
        (&["cNm"], 1e-2, 0.0),
        (&["kNm"], 1e3, 0.0),
    ],
};

pub(super) const MILLILITRE: Unit = Unit {
    name: "ml",
    spellings: &[
        (&["ml", "mL", "cm3", "cm^3", "cm³", "ccm", "cc"], 1.0, 0.0),
        (&["ul", "µl", "mm3", "mm^3", "mm³"], 1e-3, 0.0),
        (&["cl"], 10.0, 0.0),
        (&["l", "L", "dm3"], 1e3, 0.0),
    ],
};

pub(super) const MILLILITRE_A_SECOND: Unit = Unit {
    name: "ml/s",
    spellings: &[
        (&["ml/s", "mL/s", "cm3/s", "cm^3/s", "cm³/s", "ccm/s"], 1.0, 0.0),
        (&["ml/min", "mL/min"], 1.0 / 60.0, 0.0),
        (&["l/min", "L/min"], 1000.0 / 60.0, 0.0),
        (&["l/s", "L/s"], 1e3, 0.0),
    ],
};

/// What a signal's unit is to a channel's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Relation {
    /// The same, or not said.
    Same,
    /// Gain and offset from the signal's unit to the channel's.
    Scaled { gain: f64, offset: f64 },
    /// Nothing that is known.
    Foreign,
}

impl Unit {
    pub(super) fn relation(&self, signal_unit: &str) -> Relation {
        let signal_unit = signal_unit.trim();
        if signal_unit.is_empty() {
            return Relation::Same;
        }
        match self.spellings.iter().find(|(names, ..)| names.contains(&signal_unit)) {
            Some(&(_, 1.0, 0.0)) => Relation::Same,
            Some(&(_, gain, offset)) => Relation::Scaled { gain, offset },
            None => Relation::Foreign,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_the_same_scaled_or_foreign() {
        assert_eq!(BAR.relation("bar"), Relation::Same);
        assert_eq!(BAR.relation(""), Relation::Same);
        assert_eq!(BAR.relation("kPa"), Relation::Scaled { gain: 0.01, offset: 0.0 });
        assert_eq!(BAR.relation("V"), Relation::Foreign);
        assert_eq!(MILLILITRE.relation("cm³"), Relation::Same);
        for (unit, signal, value, expected) in [
            (&BAR, "psi", 14.503_773_773, 1.0),
            (&BAR, "barg", 1.0, 2.01325),
            (&BAR, "Pa", 101_325.0, 1.01325),
            (&DEGREE, "rad", std::f64::consts::PI, 180.0),
            (&MILLILITRE_A_SECOND, "l/min", 6.0, 100.0),
            (&NEWTON_METRE, "mNm", 1500.0, 1.5),
        ] {
            let Relation::Scaled { gain, offset } = unit.relation(signal) else { panic!("{signal}") };
            assert!((gain * value + offset - expected).abs() < 1e-6, "{signal}");
        }
    }

    #[test]
    fn no_spelling_means_two_things() {
        for unit in [&DEGREE, &BAR, &NEWTON_METRE, &MILLILITRE, &MILLILITRE_A_SECOND] {
            let names: Vec<&str> = unit.spellings.iter().flat_map(|(names, ..)| names.iter().copied()).collect();
            assert_eq!(names[0], unit.name);
            for (n, name) in names.iter().enumerate() {
                assert!(!names[..n].contains(name), "{name}");
            }
        }
    }
}
