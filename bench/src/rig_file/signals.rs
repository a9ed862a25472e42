//! The mapping of `[can]`: channels and commands to signals of the database.

use super::document::{Document, label};
use super::problems::{Problems, meant};
use super::units::{BAR, DEGREE, MILLILITRE, MILLILITRE_A_SECOND, NEWTON_METRE, Relation, Unit};
use drivers::can::FrameId;
use drivers::dbc::{Codec, Database, Message, Signal};
use drivers::wired::{CanSettings, Sensor};
use rt_core::{Limits, PERIOD_NS};
use std::collections::BTreeMap;

/// Fewest values of a counter: with fewer, a lost frame or two are a counter that stands.
const FEWEST_COUNTS: f64 = 16.0;

/// What a command's signal must be able to say.
enum Says {
    /// 0 and 1.
    Bit,
    /// Whole numbers from 0, one after the other, and then from 0 again.
    Counter,
    /// 0..=5.
    Kind,
    /// Every value between these, in a unit.
    Range(f64, f64, &'static Unit),
}

pub(super) struct Mapping<'a> {
    pub(super) settings: &'a CanSettings,
    pub(super) database: &'a Database,
    pub(super) limits: &'a Limits,
    pub(super) document: &'a Document,
    pub(super) problems: &'a mut Problems,
}

impl<'a> Mapping<'a> {
    /// Checks everything that is mapped.
    pub(super) fn check(mut self) {
        let commanded = self.commands();
        let mut values: BTreeMap<String, &str> = BTreeMap::new();
        let units = [&DEGREE, &BAR, &BAR, &NEWTON_METRE, &MILLILITRE];
        let Limits { angle_max_deg, pressure_min_bar, pressure_max_bar, .. } = *self.limits;
        let angles = Some((-angle_max_deg, angle_max_deg));
        let pressures = Some((pressure_min_bar, pressure_max_bar));
        let needed = [angles, pressures, pressures, None, None];
        let names = ["angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml"];
        for (((sensor, name), unit), needed) in
            self.settings.sensors.by_input().into_iter().zip(names).zip(units).zip(needed)
        {
            let Some(sensor) = sensor else { continue };
            let path = format!("can.sensors.{name}");
            if let Some(other) = values.insert(sensor.signal.clone(), name)
                && !sensor.signal.is_empty()
            {
                let what = format!(
                    "{} is mapped already, by [can.sensors.{other}] signal; each quantity has a signal of its own",
                    sensor.signal
                );
                self.problem(&format!("{path}.signal"), what);
            }
            self.sensor(sensor, &path, unit, needed, &commanded);
        }
        self.companions_are_no_values(&values);
        self.heartbeats(&commanded);
    }

    fn problem(&mut self, path: &str, what: impl AsRef<str>) {
        self.problems.add(self.document.line(path), format!("{}: {}", label(path), what.as_ref()));
    }

    /// The signal with its message; what is wrong with the name is said. `None` also where the file says nothing.
    fn find(&mut self, name: &str, path: &str) -> Option<(&'a Message, &'a Signal)> {
        if name.is_empty() {
            return None;
        }
        match self.database.signal(name) {
            Ok(found) => Some(found),
            Err(error) => {
                self.problem(path, error.to_string());
                None
            }
        }
    }

    /// Messages that the bench sends, with the key that says so.
    fn commands(&mut self) -> BTreeMap<FrameId, String> {
        let settings = self.settings;
        let command = &settings.command;
        let limits = self.limits;
        let angles = || Says::Range(-limits.angle_max_deg, limits.angle_max_deg, &DEGREE);
        let pressures = || Says::Range(limits.pressure_min_bar, limits.pressure_max_bar, &BAR);
        let mut wanted: Vec<(String, &str, Says)> = vec![
            ("can.command.brake_open".to_owned(), &command.brake_open, Says::Bit),
            ("can.command.bypass_open".to_owned(), &command.bypass_open, Says::Bit),
        ];
        wanted.extend(command.counter.iter().map(|name| ("can.command.counter".to_owned(), &**name, Says::Counter)));
        wanted.extend(command.running.iter().map(|name| ("can.command.running".to_owned(), &**name, Says::Bit)));
        for (key, name) in settings.fixture.iter().flat_map(|fixture| fixture.by_key()) {
            let says = match key {
                "kind" => Says::Kind,
                "angle_deg" => angles(),
                "flow_ml_s" => Says::Range(0.0, 0.0, &MILLILITRE_A_SECOND),
                "segment" | "run" => Says::Counter,
                "vertical" => Says::Bit,
                _ => pressures(),
            };
            wanted.push((format!("can.fixture.{key}"), name, says));
        }
        let mut sent = BTreeMap::new();
        let mut taken: BTreeMap<&str, String> = BTreeMap::new();
        for (path, name, says) in wanted {
            let Some((message, signal)) = self.find(name, &path) else { continue };
            let multiplexed = message.signals().iter().any(|signal| signal.codec.is_multiplexed());
            sent.entry(message.id).or_insert_with(|| label(&path));
            if let Some(other) = taken.insert(name, label(&path)) {
                self.problem(
                    &path,
                    format!("{name} is mapped already, by {other}; each command needs a signal of its own"),
                );
            }
            if multiplexed {
                let what = format!(
                    "expected a message whose signals are all in every frame, got {}, which is multiplexed; give the command a \
                     message of its own",
                    message.name
                );
                self.problem(&path, what);
                continue;
            }
            if let Err(what) = says.fits(name, signal, message.length) {
                self.problem(&path, what);
            }
        }
        sent
    }

    fn sensor(
        &mut self,
        sensor: &Sensor,
        path: &str,
        unit: &Unit,
        needed: Option<(f64, f64)>,
        commanded: &BTreeMap<FrameId, String>,
    ) {
        let key = |key: &str| format!("{path}.{key}");
        let commands_missing = !self.document.has("can.command") || self.document.refused("can.command.counter");
        if sensor.counter.is_some() && self.settings.command.counter.is_none() && !commands_missing {
            let what = "expected [can.command] counter too, got none: a sensor's counter is the echo of the command's";
            self.problem(&key("counter"), what);
        }
        if sensor.counter.is_some() && sensor.latency_ms > 0.0 {
            let what = "is for sensors without a counter: the counter already says when the value was measured; leave one of the two out";
            self.problem(&key("latency_ms"), what);
        }
        let Some((message, signal)) = self.find(&sensor.signal, &key("signal")) else { return };
        if let Some(command) = commanded.get(&message.id) {
            let what = format!(
                "expected a message that a node sends, got {} {}, which the bench sends for {command}",
                message.name, message.id
            );
            self.problem(&key("signal"), what);
        }
        if sensor.gain == 1.0 && sensor.offset == 0.0 {
            let taken = format!("{} is in {:?}, the channel in {}", sensor.signal, signal.unit, unit.name);
            match unit.relation(&signal.unit) {
                Relation::Same => {}
                Relation::Scaled { gain, offset: 0.0 } => {
                    self.problem(&key("signal"), format!("{taken}; set gain = {gain}"));
                }
                Relation::Scaled { gain, offset } => {
                    self.problem(&key("signal"), format!("{taken}; set gain = {gain} and offset = {offset}"));
                }
                Relation::Foreign => {
                    let what = format!(
                        "{taken}; set the gain and the offset of its calibration, or correct the unit in the database"
                    );
                    self.problem(&key("signal"), what);
                }
            }
        }
        let ends = [signal.minimum, signal.maximum].map(|value| sensor.gain * value + sensor.offset);
        let (low, high) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        if let Some((least, most)) = needed
            && (low > least || high < most)
        {
            let what = format!(
                "expected a signal that can say {least}..{most} {0}, the range of [limits], got {low}..{high} {0} after gain and offset; a limit \
                 that the sensor can't show protects from nothing: narrow [limits], or correct calibration or database",
                unit.name
            );
            self.problem(&key("signal"), what);
        }
        for (name, companion) in [("fault", &sensor.fault), ("present", &sensor.present), ("counter", &sensor.counter)]
        {
            let Some(companion) = companion else { continue };
            let Some((other, Signal { codec, .. })) = self.find(companion, &key(name)) else { continue };
            if other.id != message.id {
                let what = format!(
                    "expected a signal of {}, the message of the value, got {companion}: frames come one by one, and two of them need not belong \
                     together",
                    message.name
                );
                self.problem(&key(name), what);
            } else if name == "counter"
                && let Err(what) =
                    counts(companion, codec, other.length).and_then(|()| self.echo_tells(companion, codec))
            {
                self.problem(&key(name), what);
            }
        }
        // What is judged by its size must be fresh: what is required, and the torque.
        let judged = needed.is_some() || path.ends_with("torque_nm");
        if let Some(cycle_ms) = message.cycle_time_ms
            && judged
            && cycle_ms > self.limits.age_max_ms
        {
            let what = format!(
                "{} comes every {cycle_ms} ms by the database, [limits] age_max_ms = {} would trip; let the node send it more often, or raise the \
                 limit",
                message.name, self.limits.age_max_ms
            );
            self.problem(&key("signal"), what);
        }
    }

    /// The age of a value, as an echoed counter tells it, must not begin anew before it is above its limit: a node that repeats one frame for ever would be
    /// fresh for ever.
    fn echo_tells(&self, name: &str, echo: &Codec) -> Result<(), String> {
        let commanded = self.settings.command.counter.as_ref().and_then(|name| self.database.signal(name).ok());
        let own = (echo.range().1, name);
        let (highest, narrower) = match (&commanded, &self.settings.command.counter) {
            (Some((_, signal)), Some(name)) if signal.codec.range().1 < own.0 => {
                (signal.codec.range().1, name.as_str())
            }
            _ => own,
        };
        let around_ms = (highest + 1.0) * PERIOD_NS as f64 * 1e-6;
        let most_ms = self.limits.age_max_ms;
        if around_ms > most_ms {
            return Ok(());
        }
        Err(format!(
            "expected a counter that begins anew after more than [limits] age_max_ms = {most_ms}, got {narrower}, which does after {around_ms} ms: a node \
             that repeats one frame for ever would count as fresh; give it more bits, or lower the limit"
        ))
    }

    fn companions_are_no_values(&mut self, values: &BTreeMap<String, &str>) {
        let settings = self.settings;
        let sensors = &settings.sensors;
        let named = [
            ("angle_deg", &sensors.angle_deg),
            ("pressure1_bar", &sensors.pressure1_bar),
            ("pressure2_bar", &sensors.pressure2_bar),
            ("torque_nm", &sensors.torque_nm),
            ("volume_ml", &sensors.volume_ml),
        ];
        for (name, sensor) in named.into_iter().filter_map(|(name, sensor)| Some((name, sensor.as_ref()?))) {
            let mut own: Vec<(&str, &str)> = vec![];
            let companions = [("fault", &sensor.fault), ("present", &sensor.present), ("counter", &sensor.counter)];
            for (key, companion) in companions.into_iter().filter_map(|(key, path)| Some((key, path.as_deref()?))) {
                let path = format!("can.sensors.{name}.{key}");
                if let Some(other) = values.get(companion) {
                    self.problem(
                        &path,
                        format!("{companion} is mapped already, as the value of [can.sensors.{other}]"),
                    );
                }
                if let Some((other, _)) = own.iter().find(|(_, path)| *path == companion) {
                    self.problem(&path, format!("{companion} is mapped already, as {other} of the same sensor"));
                }
                own.push((key, companion));
            }
        }
    }

    fn heartbeats(&mut self, commanded: &BTreeMap<FrameId, String>) {
        let settings = self.settings;
        let most_ms = self.limits.heartbeat_max_ms;
        for (index, heartbeat) in settings.heartbeat.iter().enumerate() {
            let key = |key: &str| format!("can.heartbeat.{index}.{key}");
            if heartbeat.period_ms >= most_ms {
                let what = format!(
                    "expected less than [limits] heartbeat_max_ms = {most_ms}, got {}: a node in order would trip; raise the limit, or let the node \
                     send more often",
                    heartbeat.period_ms
                );
                self.problem(&key("period_ms"), what);
            }
            if heartbeat.message.is_empty() {
                continue;
            }
            if let Some(first) = settings.heartbeat[..index].iter().position(|other| other.message == heartbeat.message)
            {
                let what = format!("{} is waited for already, by [[can.heartbeat]] {}", heartbeat.message, first + 1);
                self.problem(&key("message"), what);
            }
            let Some(message) = self.database.message(&heartbeat.message) else {
                let names: Vec<&str> = self.database.messages().iter().map(|message| message.name.as_str()).collect();
                let nearest = meant(&heartbeat.message, names.iter().copied());
                let what = format!(
                    "expected a message of {}, got {:?}{nearest}; it has {}",
                    settings.dbc.display(),
                    heartbeat.message,
                    names.join(", ")
                );
                self.problem(&key("message"), what);
                continue;
            };
            let (id, cycle_ms, length) = (message.id, message.cycle_time_ms, message.length);
            if let Some(command) = commanded.get(&id) {
                let what = format!(
                    "expected a message that a node sends, got {} {id}, which the bench sends for {command}",
                    heartbeat.message
                );
                self.problem(&key("message"), what);
            }
            if length > drivers::can::MOST_BYTES {
                let what =
                    format!("expected a classic frame of at most 8 bytes, got {} of {length}", heartbeat.message);
                self.problem(&key("message"), what);
            }
            if let Some(cycle_ms) = cycle_ms
                && cycle_ms > heartbeat.period_ms
            {
                let what = format!(
                    "expected at least the {cycle_ms} ms at which {} comes by the database, got {}",
                    heartbeat.message, heartbeat.period_ms
                );
                self.problem(&key("period_ms"), what);
            }
        }
    }
}

impl Says {
    /// Whether the signal can say it.
    fn fits(&self, name: &str, signal: &Signal, length: usize) -> Result<(), String> {
        let Signal { minimum, maximum, unit, codec, .. } = signal;
        let (least, most) = match self {
            Says::Bit => (0.0, 1.0),
            Says::Kind => (0.0, 5.0),
            Says::Counter => return counts(name, codec, length),
            Says::Range(least, most, _) => (*least, *most),
        };
        let widest = codec.range();
        let (low, high) = (minimum.max(widest.0), maximum.min(widest.1));
        if low > least || high < most {
            return Err(format!("expected a signal that can hold {least}..{most}, got {name} with {low}..{high}"));
        }
        match self {
            Says::Range(.., wanted) if wanted.relation(unit) != Relation::Same => Err(format!(
                "expected a signal in {}, got {name} in {unit:?}; commands have no gain of their own: factor, offset and unit of the database \
                 must give {}",
                wanted.name, wanted.name
            )),
            Says::Bit | Says::Kind => whole_numbers(codec, length, most as u32).then_some(()).ok_or_else(|| {
                format!("expected a signal that can hold the whole numbers {least}..{most}, got {name}, whose factor and offset do not")
            }),
            _ => Ok(()),
        }
    }
}

/// Whether a signal counts.
fn counts(name: &str, codec: &Codec, length: usize) -> Result<(), String> {
    let (low, high) = codec.range();
    if low == 0.0 && codec.resolution() == 1.0 && high >= FEWEST_COUNTS - 1.0 && whole_numbers(codec, length, 15) {
        return Ok(());
    }
    Err(format!(
        "expected a counter, an unsigned signal of at least 4 bits with factor 1 and offset 0, got {name} with {low}..{high} in steps of {}",
        codec.resolution()
    ))
}

/// Whether 0 up to this number survive the signal.
fn whole_numbers(codec: &Codec, length: usize, most: u32) -> bool {
    (0..=most).map(f64::from).all(|number| {
        let mut data = [0; drivers::can::MOST_BYTES];
        let data = &mut data[..length.min(drivers::can::MOST_BYTES)];
        codec.select(data).is_ok() && codec.encode(number, data).is_ok() && codec.decode(data) == Some(number)
    })
}
