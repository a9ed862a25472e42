//! What `[can]` of a rig file says, looked up in the database: which signal is what. Both ends of the bus read it here, the bench and the
//! emulated nodes; how a quantity becomes a signal's value is each end's own business.

use super::settings::{CanSettings, Heartbeat, Sensor};
use crate::dbc::{Codec, Database, DbcError, Message};
use rt_core::Input;

/// Why a rig file and a database do not fit together.
#[derive(Debug, thiserror::Error)]
pub enum MappingError {
    /// The settings name a signal that can't be used.
    #[error("{key}: {source}")]
    Signal {
        /// Key of the rig file.
        key: String,
        /// Why not.
        #[source]
        source: Box<DbcError>,
    },
    /// The settings contradict the database, or each other.
    #[error("{key}: expected {expected}, got {got}")]
    Setting {
        /// Key of the rig file.
        key: String,
        /// What can be used.
        expected: String,
        /// What is there.
        got: String,
    },
}

/// What a signal of a command says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Meaning {
    BrakeOpen,
    BypassOpen,
    Counter,
    Running,
    Kind,
    AngleDeg,
    Pressure1Bar,
    Pressure2Bar,
    FlowMlS,
    Segment,
    Run,
    Vertical,
    FillBar,
}

/// A signal of a command.
pub(crate) struct Commanded<'a> {
    /// Key of the rig file.
    pub key: &'static str,
    pub meaning: Meaning,
    pub message: &'a Message,
    pub codec: Codec,
}

/// The signals of `[can.command]` and `[can.fixture]`, and the message on which nodes act: that of the counter, of the brake where there
/// is none.
///
/// # Errors
/// A signal that does not exist or can't be used.
pub(crate) fn commanded<'a>(
    settings: &CanSettings,
    database: &'a Database,
) -> Result<(Vec<Commanded<'a>>, &'a Message), MappingError> {
    let command = &settings.command;
    let mut wanted = vec![
        ("[can.command] brake_open", Meaning::BrakeOpen, &command.brake_open),
        ("[can.command] bypass_open", Meaning::BypassOpen, &command.bypass_open),
    ];
    wanted.extend(command.running.as_ref().map(|name| ("[can.command] running", Meaning::Running, name)));
    if let Some(fixture) = &settings.fixture {
        wanted.extend([
            ("[can.fixture] kind", Meaning::Kind, &fixture.kind),
            ("[can.fixture] angle_deg", Meaning::AngleDeg, &fixture.angle_deg),
            ("[can.fixture] pressure1_bar", Meaning::Pressure1Bar, &fixture.pressure1_bar),
            ("[can.fixture] pressure2_bar", Meaning::Pressure2Bar, &fixture.pressure2_bar),
            ("[can.fixture] flow_ml_s", Meaning::FlowMlS, &fixture.flow_ml_s),
            ("[can.fixture] segment", Meaning::Segment, &fixture.segment),
            ("[can.fixture] run", Meaning::Run, &fixture.run),
            ("[can.fixture] vertical", Meaning::Vertical, &fixture.vertical),
            ("[can.fixture] fill_bar", Meaning::FillBar, &fixture.fill_bar),
        ]);
    }
    wanted.extend(command.counter.as_ref().map(|name| ("[can.command] counter", Meaning::Counter, name)));
    let (mut signals, mut sync) = (vec![], None);
    for (key, meaning, name) in wanted {
        let (message, codec) = signal(database, name, || key.to_owned())?;
        match meaning {
            Meaning::BrakeOpen => sync = sync.or(Some(message)),
            Meaning::Counter => sync = Some(message),
            _ => {}
        }
        signals.push(Commanded { key, meaning, message, codec });
    }
    Ok((signals, sync.expect("brake_open is always looked up")))
}

/// A sensor with its companions, all of one message.
pub(crate) struct Sensed<'a> {
    pub input: Input,
    /// Its calibration: a gain that is finite and not 0, a finite offset.
    pub sensor: &'a Sensor,
    pub message: &'a Message,
    pub value: Codec,
    pub fault: Option<Codec>,
    pub present: Option<Codec>,
    pub counter: Option<Codec>,
}

/// The sensors of `[can.sensors]`, in the order of [`Input`].
///
/// # Errors
/// A signal that does not exist or can't be used, a companion in another message, a calibration that can't be inverted.
pub(crate) fn sensed<'a>(settings: &'a CanSettings, database: &'a Database) -> Result<Vec<Sensed<'a>>, MappingError> {
    let sensors = Input::ALL.into_iter().zip(settings.sensors.by_input());
    sensors.filter_map(|(input, sensor)| Some(Sensed::find(input, sensor?, database))).collect()
}

impl<'a> Sensed<'a> {
    fn find(input: Input, sensor: &'a Sensor, database: &'a Database) -> Result<Sensed<'a>, MappingError> {
        let key = |part: &str| format!("[can.sensors.{}] {part}", input.column());
        let refused = |part, expected: String, got| MappingError::Setting { key: key(part), expected, got };
        if sensor.gain == 0.0 || !sensor.gain.is_finite() {
            return Err(refused("gain", "a finite number other than 0".to_owned(), sensor.gain.to_string()));
        }
        if !sensor.offset.is_finite() {
            return Err(refused("offset", "a finite number".to_owned(), sensor.offset.to_string()));
        }
        let (message, value) = signal(database, &sensor.signal, || key("signal"))?;
        let companion = |part, name: &Option<String>| {
            let Some(name) = name else { return Ok(None) };
            let (other, codec) = signal(database, name, || key(part))?;
            if other.id != message.id {
                let expected = format!("a signal of {}, the message of the value", message.name);
                return Err(refused(part, expected, format!("{name:?}")));
            }
            Ok(Some(codec))
        };
        Ok(Sensed {
            input,
            sensor,
            message,
            value,
            fault: companion("fault", &sensor.fault)?,
            present: companion("present", &sensor.present)?,
            counter: companion("counter", &sensor.counter)?,
        })
    }
}

/// The messages of `[[can.heartbeat]]`.
///
/// # Errors
/// A message that does not exist.
pub(crate) fn heartbeats<'a>(
    settings: &'a CanSettings,
    database: &'a Database,
) -> Result<Vec<(&'a Heartbeat, &'a Message)>, MappingError> {
    let find = |heartbeat: &'a Heartbeat| match database.message(&heartbeat.message) {
        Some(message) => Ok((heartbeat, message)),
        None => Err(MappingError::Setting {
            key: "[[can.heartbeat]] message".to_owned(),
            expected: "a message of the database".to_owned(),
            got: format!("{:?}", heartbeat.message),
        }),
    };
    settings.heartbeat.iter().map(find).collect()
}

/// How many values a counter has, its highest and 0: it begins anew after so many. 2..=65536.
pub(crate) fn modulus(counter: Codec) -> u64 {
    let (_, highest) = counter.range();
    // The cast saturates.
    (highest as u64).saturating_add(1).clamp(2, 1 << 16)
}

/// A signal with its message; the error names the key that asked for it.
pub(super) fn signal<'a>(
    database: &'a Database,
    path: &str,
    key: impl FnOnce() -> String,
) -> Result<(&'a Message, Codec), MappingError> {
    match database.signal(path) {
        Ok((message, signal)) => Ok((message, signal.codec)),
        Err(source) => Err(MappingError::Signal { key: key(), source: Box::new(source) }),
    }
}
