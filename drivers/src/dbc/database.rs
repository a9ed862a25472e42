//! A database that was read, and how its messages and signals are found.

use super::codec::Codec;
use super::error::DbcError;
use super::{check, text};
use crate::can::FrameId;
use std::path::Path;

/// Longest list of names in an error.
const MOST_LISTED: usize = 24;

/// The messages of a CAN database, checked and compiled.
#[derive(Clone, Debug)]
pub struct Database {
    /// For messages.
    file: String,
    text: String,
    messages: Vec<Message>,
    /// Ascending [`key`]s of the identifiers, with the place in `messages`.
    ids: Vec<(u32, usize)>,
}

/// A message of the database.
#[derive(Clone, Debug)]
pub struct Message {
    /// Its name.
    pub name: String,
    /// Identifier of its frames.
    pub id: FrameId,
    /// Its length in bytes; more than 8 in messages that are no classic frames.
    pub length: usize,
    /// The node that sends it; `None` where the database names none (`Vector__XXX`).
    pub sender: Option<String>,
    /// Time between two frames, ms, > 0, from the attribute `GenMsgCycleTime` or its default; `None` where it is not sent cyclically (0).
    pub cycle_time_ms: Option<f64>,
    pub(super) signals: Vec<Signal>,
    /// Signals of a message of more than 8 bytes: they have no codec.
    pub(super) unmapped: Vec<String>,
}

impl Message {
    /// Its signals in the order of the file; none for a message of more than 8 bytes.
    pub fn signals(&self) -> &[Signal] {
        &self.signals
    }

    /// The signal of that name.
    pub fn signal(&self, name: &str) -> Option<&Signal> {
        self.signals.iter().find(|s| s.name == name)
    }

    fn signal_names(&self) -> impl Iterator<Item = &str> + Clone {
        self.signals.iter().map(|s| s.name.as_str()).chain(self.unmapped.iter().map(String::as_str))
    }
}

/// A signal of a message of at most 8 bytes.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// Its name, without that of the message.
    pub name: String,
    /// Its unit as the file has it; may be empty.
    pub unit: String,
    /// Lowest value that the database allows, in the unit; that of [`Codec::range`] where it says none (`[0|0]`). The codec does not enforce it.
    pub minimum: f64,
    /// Highest value that the database allows, likewise.
    pub maximum: f64,
    /// The signal of the same message that must have a certain value for this one to be in the frame.
    pub multiplexor: Option<String>,
    /// Decodes and encodes it.
    pub codec: Codec,
}

impl Database {
    /// Reads a database: UTF-8, else Windows-1252 (Latin-1), as DBC files have by tradition.
    ///
    /// # Errors
    /// A file that can't be read, and all that [`Database::parse`] refuses.
    pub fn read(path: &Path) -> Result<Database, DbcError> {
        let file = path.display().to_string();
        match std::fs::read(path) {
            Ok(bytes) => Database::parse(&text::decode(&bytes), &file),
            Err(source) => Err(DbcError::Read { file, source }),
        }
    }

    /// A database from its text; `file` is its name in messages.
    ///
    /// # Errors
    /// The first error found, with its line: what is no DBC file, and each [`super::Problem`].
    pub fn parse(text: &str, file: &str) -> Result<Database, DbcError> {
        let (dbc, places) = text::parse(text, file)?;
        let messages = check::messages(&dbc, &places).map_err(|(line, problem)| DbcError::File {
            file: file.to_owned(),
            line,
            problem,
        })?;
        let mut ids: Vec<(u32, usize)> = messages.iter().enumerate().map(|(i, m)| (key(m.id), i)).collect();
        ids.sort_unstable();
        Ok(Database { file: file.to_owned(), text: text.to_owned(), messages, ids })
    }

    /// The text that it was read from.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Its messages in the order of the file, without `VECTOR__INDEPENDENT_SIG_MSG`.
    pub fn messages(&self) -> &[Message] {
        &self.messages
    }

    /// The message of that name.
    pub fn message(&self, name: &str) -> Option<&Message> {
        self.messages.iter().find(|m| m.name == name)
    }

    /// The message with that identifier. Allocates nothing.
    pub fn by_id(&self, id: FrameId) -> Option<&Message> {
        let id = key(id);
        let found = self.ids.binary_search_by_key(&id, |(id, _)| *id).ok()?;
        Some(&self.messages[self.ids[found].1])
    }

    /// The signal at a path `MESSAGE.Signal`, to be mapped.
    ///
    /// # Errors
    /// A path of another form, a message or signal that the file does not have (the error says which there are, and the nearest name), and a
    /// message of more than 8 bytes.
    pub fn signal(&self, path: &str) -> Result<(&Message, &Signal), DbcError> {
        let (file, got) = (self.file.clone(), path.to_owned());
        let Some((message_name, name)) = path.split_once('.') else {
            let all = self.messages.iter().flat_map(|m| m.signal_names().map(|s| format!("{}.{s}", m.name)));
            let near: Vec<(String, String)> =
                all.filter_map(|p| p.split_once('.').map(|(_, s)| (s.to_owned(), p.clone()))).collect();
            let names = near.iter().map(|(signal, _)| signal.as_str());
            let full = nearest_of(path, names).and_then(|n| near.iter().find(|(signal, _)| signal == n));
            return Err(DbcError::Path { file, got, nearest: question(full.map(|(_, path)| path.as_str())) });
        };
        let Some(message) = self.message(message_name) else {
            let names = self.messages.iter().map(|m| m.name.as_str());
            let nearest = question(nearest_of(message_name, names.clone()));
            return Err(DbcError::NoMessage {
                file,
                got: message_name.to_owned(),
                nearest,
                existing: list(names, "messages"),
            });
        };
        let message_name = message.name.clone();
        if !message.unmapped.is_empty() && message.unmapped.iter().any(|n| n == name) {
            return Err(DbcError::NotClassic { file, message: message_name, length: message.length });
        }
        message.signal(name).map(|signal| (message, signal)).ok_or_else(|| {
            let nearest = question(nearest_of(name, message.signal_names()));
            let existing = list(message.signal_names(), "signals");
            DbcError::NoSignal { file, message: message_name, got: name.to_owned(), nearest, existing }
        })
    }
}

/// Both kinds of identifiers as one number, as the file has them.
fn key(id: FrameId) -> u32 {
    match id {
        FrameId::Standard(id) => u32::from(id),
        FrameId::Extended(id) => id | 1 << 31,
    }
}

/// The name that differs least, where that is little: upper and lower case count as the same.
fn nearest_of<'a>(got: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let lower = got.to_lowercase();
    let most = (got.chars().count() / 3).max(2);
    let distances = names.map(|n| (strsim::damerau_levenshtein(&lower, &n.to_lowercase()), n));
    distances.filter(|(distance, _)| *distance <= most).min_by_key(|(distance, _)| *distance).map(|(_, n)| n)
}

fn question(nearest: Option<&str>) -> String {
    nearest.map(|n| format!(", did you mean {n:?}?")).unwrap_or_default()
}

fn list<'a>(names: impl Iterator<Item = &'a str> + Clone, what: &str) -> String {
    let count = names.clone().count();
    let shown: Vec<&str> = names.take(MOST_LISTED).collect();
    match count {
        0 => format!("no {what}"),
        _ if count > MOST_LISTED => format!("{} and {} more", shown.join(", "), count - MOST_LISTED),
        _ => shown.join(", "),
    }
}
