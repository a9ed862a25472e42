//! Commands and their answers as JSON, so that any program that speaks zenoh can send one.

use super::VERSION;
use rt_core::{Amount, Answer, Confirmation, Refusal, RunCommand, Waiting};
use serde::{Deserialize, Serialize};

/// A command.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// [`VERSION`].
    version: u32,
    command: Word,
    /// Of `confirm`: the request that is answered; without it the open one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    request: Option<u32>,
    /// Of `confirm`: the amount, ml.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    volume_ml: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Word {
    Look,
    Stop,
    EmergencyStop,
    Confirm,
}

/// An answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Said {
    version: u32,
    taken: bool,
    /// The tick at which the loop took it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tick: Option<u64>,
    /// Why it was not taken: one of [`REFUSALS`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    refused: Option<String>,
    /// The same for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    message: Option<String>,
    /// The request that is open now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    request: Option<u32>,
    /// Whether it wants an amount in ml.
    #[serde(default)]
    wants_volume_ml: bool,
    /// That request in words.
    #[serde(default)]
    text: String,
}

/// The words for the reasons.
pub const REFUSALS: [(Refusal, &str); 8] = [
    (Refusal::NothingWaits, "nothing-waits"),
    (Refusal::OtherRequest, "other-request"),
    (Refusal::AmountMissing, "amount-missing"),
    (Refusal::AmountUnasked, "amount-unasked"),
    (Refusal::AmountNotFinite, "amount-not-finite"),
    (Refusal::NoAnswer, "no-answer"),
    (Refusal::ReadOnly, "read-only"),
    (Refusal::Unreachable, "unreachable"),
];

impl From<RunCommand> for Asked {
    fn from(command: RunCommand) -> Asked {
        let (command, Confirmation { request, volume_ml }) = match command {
            RunCommand::Look => (Word::Look, Confirmation::default()),
            RunCommand::Stop => (Word::Stop, Confirmation::default()),
            RunCommand::EmergencyStop => (Word::EmergencyStop, Confirmation::default()),
            RunCommand::Confirm(confirmation) => (Word::Confirm, confirmation),
        };
        Asked { version: VERSION, command, request, volume_ml }
    }
}

impl Asked {
    /// The command of this text.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &[u8]) -> Result<RunCommand, String> {
        let asked: Asked = serde_json::from_slice(text).map_err(|error| {
            format!("expected a command such as {{\"version\":{VERSION},\"command\":\"stop\"}}, got \"{error}\"")
        })?;
        if asked.version != VERSION {
            return Err(format!(
                "expected a command of version {VERSION}, got {}; use programs of one build",
                asked.version
            ));
        }
        let Asked { request, volume_ml, .. } = asked;
        Ok(match asked.command {
            Word::Look => RunCommand::Look,
            Word::Stop => RunCommand::Stop,
            Word::EmergencyStop => RunCommand::EmergencyStop,
            Word::Confirm => RunCommand::Confirm(Confirmation { request, volume_ml }),
        })
    }
}

impl From<&Answer> for Said {
    fn from(Answer { taken, open, text }: &Answer) -> Said {
        let word =
            |refusal: &Refusal| REFUSALS.iter().find(|(known, _)| known == refusal).map(|(_, word)| (*word).to_owned());
        Said {
            version: VERSION,
            taken: taken.is_ok(),
            tick: taken.as_ref().ok().copied().flatten(),
            refused: taken.as_ref().err().and_then(word),
            message: taken.as_ref().err().map(ToString::to_string),
            request: open.map(|open| open.request),
            wants_volume_ml: open.is_some_and(|open| open.amount.is_some()),
            text: text.clone(),
        }
    }
}

impl Said {
    /// The answer of this text; `None`: it is none, or of another version.
    pub fn parse(text: &[u8]) -> Option<Answer> {
        let said: Said = serde_json::from_slice(text).ok().filter(|said: &Said| said.version == VERSION)?;
        let taken = match (said.taken, said.refused.as_deref()) {
            (true, _) => Ok(said.tick),
            (false, word) => Err(REFUSALS.iter().find(|(_, known)| Some(*known) == word)?.0),
        };
        let amount = said.wants_volume_ml.then_some(Amount::VolumeMl);
        Some(Answer { taken, open: said.request.map(|request| Waiting { request, amount }), text: said.text })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(value: &impl Serialize) -> Vec<u8> {
        serde_json::to_vec(value).expect("plain values")
    }

    #[test]
    fn commands_and_answers_come_through_as_they_were() {
        let confirmation = Confirmation { request: Some(7), volume_ml: Some(-0.25) };
        for command in [
            RunCommand::Look,
            RunCommand::Stop,
            RunCommand::EmergencyStop,
            RunCommand::Confirm(confirmation),
            RunCommand::Confirm(Confirmation::default()),
        ] {
            assert_eq!(Asked::parse(&json(&Asked::from(command))), Ok(command));
        }
        assert_eq!(Refusal::ALL.map(Err::<Option<u64>, _>), REFUSALS.map(|(refusal, _)| Err(refusal)));
        let open = Some(Waiting { request: 3, amount: Some(Amount::VolumeMl) });
        for taken in Refusal::ALL.map(Err).into_iter().chain([Ok(None), Ok(Some(0))]) {
            let answer = Answer { taken, open, text: "read the cylinder".to_owned() };
            assert_eq!(Said::parse(&json(&Said::from(&answer))), Some(answer));
        }
    }

    #[test]
    fn what_is_no_command_is_refused() {
        for wrong in
            ["", "stop", "{}", r#"{"version":1,"command":"levitate"}"#, r#"{"version":1,"command":"stop","now":true}"#]
        {
            assert!(Asked::parse(wrong.as_bytes()).is_err(), "{wrong}");
        }
        let newer = Asked::parse(br#"{"version":2,"command":"stop"}"#).expect_err("another version");
        assert!(newer.contains("version 1, got 2"), "{newer}");
        assert_eq!(Said::parse(br#"{"version":1,"taken":false,"refused":"boredom"}"#), None);
    }
}
