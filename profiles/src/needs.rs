//! What must be known of a rig before a script can run on it.

use crate::controlled::Controlled;
use crate::script::{ItemKind, Script};

/// What a script's targets ask of the controller's knowledge; each knows what the one before knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Need {
    /// Voltages only: they need no knowledge.
    Nothing,
    /// Flows: the pump's characteristic, eq. (10).
    Pump,
    /// Pressures or angles: an identified model.
    Model,
}

impl Need {
    /// As written in a campaign's plan.
    pub fn as_str(self) -> &'static str {
        match self {
            Need::Nothing => "nothing",
            Need::Pump => "pump",
            Need::Model => "model",
        }
    }
}

impl Script {
    /// What the most demanding of its targets needs.
    pub fn need(&self) -> Need {
        let of_target = |quantity: Controlled| match quantity {
            Controlled::VoltageV | Controlled::VoltageUMax => Need::Nothing,
            Controlled::FlowMlS => Need::Pump,
            Controlled::Pressure1Bar
            | Controlled::Pressure2Bar
            | Controlled::PressureDifferenceBar
            | Controlled::AngleDeg => Need::Model,
        };
        let of_item = |kind: &ItemKind| match kind {
            ItemKind::Hold(hold) => hold.change.drive.as_ref().map_or(Need::Nothing, |drive| of_target(drive.quantity)),
            ItemKind::Random { .. } => Need::Nothing,
        };
        self.items.iter().map(|item| of_item(&item.kind)).max().unwrap_or(Need::Nothing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BUILTIN, EXAMPLES};

    #[test]
    fn a_script_needs_what_its_most_demanding_target_needs() {
        let need = |targets: &[&str]| {
            let steps: String = targets.iter().map(|t| format!("[[step]]\ntarget = {t}\nfor_s = 1.0\n")).collect();
            let text = format!(
                "name = \"a\"\nprotocol = \"random-steps\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
                 [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\n{steps}"
            );
            Script::parse(&text, "a.toml").expect("the script is written by hand above").need()
        };
        let sine = "{ quantity = \"angle_deg\", wave = \"sine\", amplitude = 1.0, frequency_hz = 1.0 }";
        assert_eq!(need(&["{ voltage_v = 1.0 }", "{ voltage_u_max = 0.5 }"]), Need::Nothing);
        assert_eq!(need(&["{ voltage_v = 1.0 }", "{ flow_ml_s = 1.0 }", "{ voltage_v = 0.0 }"]), Need::Pump);
        assert_eq!(need(&["{ flow_ml_s = 1.0 }", sine, "{ voltage_v = 0.0 }"]), Need::Model);
        for pressure in ["pressure1_bar", "pressure2_bar", "pressure_difference_bar"] {
            assert_eq!(need(&[&format!("{{ {pressure} = 1.0 }}")]), Need::Model, "{pressure}");
        }
    }

    #[test]
    fn only_the_constant_flow_of_the_paper_s_experiments_needs_the_pump() {
        let need = |(file, text): &(&str, &str)| Script::parse(text, file).expect("built in").need();
        for script in BUILTIN {
            let expected = if script.0 == "constant_flow.toml" { Need::Pump } else { Need::Nothing };
            assert_eq!(need(script), expected, "{}", script.0);
        }
        let examples: Vec<Need> = EXAMPLES.iter().map(need).collect();
        assert_eq!(examples, [Need::Model, Need::Model, Need::Nothing]);
    }
}
