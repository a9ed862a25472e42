//! A rig file as a tree of keys with their lines, held against the list of keys. What is wrong is noted and taken out, and what
//! is missing gets a stand-in, so that the rest can still be checked.

use super::problems::{Problems, meant};
use super::schema::{Expects, Key, RIG};
use std::collections::{BTreeMap, BTreeSet};
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// A rig file whose keys and single values have been checked.
#[derive(Debug)]
pub(super) struct Document {
    /// Known keys with values in range, and stand-ins.
    pub(super) table: Table,
    /// Line of each key and table, by its path (`can.sensors.angle_deg.gain`, `can.heartbeat.0.message`).
    lines: BTreeMap<String, usize>,
    /// Paths whose value was taken out or is a stand-in.
    refused: BTreeSet<String>,
}

impl Document {
    /// Reads the text; what is wrong with single keys and values goes to `problems`. `None`: it is no TOML.
    pub(super) fn read(text: &str, problems: &mut Problems) -> Option<Document> {
        let line = |at: usize| text.as_bytes()[..at.min(text.len())].iter().filter(|byte| **byte == b'\n').count() + 1;
        let (root, errors) = DeTable::parse_recoverable(text);
        for error in &errors {
            problems.add(error.span().map_or(1, |span| line(span.start)), error.message());
        }
        if !errors.is_empty() {
            return None;
        }
        let mut reader = Reader { line: &line, problems, lines: BTreeMap::new(), refused: BTreeSet::new() };
        let table = reader.table(root.get_ref(), RIG, "", 1);
        let Reader { lines, refused, .. } = reader;
        Some(Document { table, lines, refused })
    }

    /// Line of a key, or of the table that lacks it.
    pub(super) fn line(&self, path: &str) -> usize {
        let mut path = path;
        loop {
            if let Some(line) = self.lines.get(path) {
                return *line;
            }
            match path.rsplit_once('.') {
                Some((table, _)) => path = table,
                None => return 0,
            }
        }
    }

    /// Whether the file has this key, even with a value that was refused.
    pub(super) fn has(&self, path: &str) -> bool {
        self.lines.contains_key(path)
    }

    /// Whether the value at this path, or one below it, was refused or is missing.
    pub(super) fn refused(&self, path: &str) -> bool {
        self.refused.iter().any(|p| p.strip_prefix(path).is_some_and(|rest| rest.is_empty() || rest.starts_with('.')))
    }
}

/// A path as people read it: `[can.sensors.angle_deg] gain`, `[[can.heartbeat]] 2, period_ms`.
pub(super) fn label(path: &str) -> String {
    let Some((table, key)) = path.rsplit_once('.') else { return path.to_owned() };
    match table.rsplit_once('.').map(|(array, index)| (array, index.parse::<usize>())) {
        Some((array, Ok(index))) => format!("[[{array}]] {}, {key}", index + 1),
        _ => format!("[{table}] {key}"),
    }
}

/// A path of a table as people read it: `[can.sensors]`, `[[can.heartbeat]] 2`.
pub(super) fn table_label(path: &str) -> String {
    match path.rsplit_once('.').map(|(array, index)| (array, index.parse::<usize>())) {
        Some((array, Ok(index))) => format!("[[{array}]] {}", index + 1),
        _ => format!("[{path}]"),
    }
}

struct Reader<'a> {
    line: &'a dyn Fn(usize) -> usize,
    problems: &'a mut Problems,
    lines: BTreeMap<String, usize>,
    refused: BTreeSet<String>,
}

impl Reader<'_> {
    fn table(&mut self, table: &DeTable<'_>, keys: &[Key], path: &str, own_line: usize) -> Table {
        let below = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
        let mut out = Table::new();
        for (name, value) in table {
            let (path, line) = (below(name.get_ref()), (self.line)(name.span().start));
            let Some(key) = keys.iter().find(|key| key.name == name.get_ref()) else {
                let named = if value.get_ref().is_table() { table_label(&path) } else { label(&path) };
                let names: Vec<&str> = keys.iter().map(|key| key.name).collect();
                let nearest = meant(name.get_ref(), names.iter().copied());
                self.problems.add(line, format!("{named}: unknown key{nearest}; there is {}", names.join(", ")));
                continue;
            };
            self.lines.insert(path.clone(), line);
            match self.value(value, &key.expects, &path, line) {
                Ok(value) => {
                    out.insert(key.name.to_owned(), value);
                }
                Err(got) => {
                    self.problems
                        .add(line, format!("{}: expected {}, got {got}", label(&path), key.expects.describe()));
                    self.refused.insert(path);
                }
            }
        }
        for key in keys.iter().filter(|key| key.required) {
            if out.contains_key(key.name) {
                continue;
            }
            let path = below(key.name);
            if !self.refused.contains(&path) {
                let named = if matches!(key.expects, Expects::Table(_)) { table_label(&path) } else { label(&path) };
                self.problems.add(own_line, format!("{named}: missing; expected {}", what(&key.expects)));
            }
            out.insert(key.name.to_owned(), stand_in(&key.expects));
            self.refused.insert(path);
        }
        out
    }

    /// The value, or what came instead.
    fn value(
        &mut self,
        value: &Spanned<DeValue<'_>>,
        expects: &Expects,
        path: &str,
        line: usize,
    ) -> Result<Value, String> {
        let number = |text: &str| text.replace('_', "").parse::<f64>().ok();
        let got = |value: &DeValue<'_>| match value {
            DeValue::String(text) => format!("{:?}", text.as_ref()),
            DeValue::Integer(integer) => integer.to_string(),
            DeValue::Float(float) => float.to_string(),
            DeValue::Boolean(flag) => flag.to_string(),
            DeValue::Array(_) => "an array".to_owned(),
            DeValue::Table(_) => "a table".to_owned(),
            DeValue::Datetime(date) => date.to_string(),
        };
        let refusal = || got(value.get_ref());
        match (expects, value.get_ref()) {
            (Expects::Text, DeValue::String(text)) if !text.trim().is_empty() => Ok(Value::String(text.to_string())),
            (Expects::Word(words), DeValue::String(text)) if words.contains(&text.as_ref()) => {
                Ok(Value::String(text.to_string()))
            }
            (Expects::Flag, DeValue::Boolean(flag)) => Ok(Value::Boolean(*flag)),
            (Expects::Number(range, _), DeValue::Integer(_) | DeValue::Float(_)) => {
                let parsed = match value.get_ref() {
                    DeValue::Integer(integer) => whole(integer.as_str(), integer.radix()).map(|whole| whole as f64),
                    DeValue::Float(float) => number(float.as_str()),
                    _ => None,
                };
                parsed.filter(|number| range.holds(*number)).map(Value::Float).ok_or_else(refusal)
            }
            (Expects::Whole(low, high), DeValue::Integer(integer)) => whole(integer.as_str(), integer.radix())
                .filter(|whole| (low..=high).contains(&whole))
                .map(Value::Integer)
                .ok_or_else(refusal),
            (Expects::Table(keys), DeValue::Table(table)) => Ok(Value::Table(self.table(table, keys, path, line))),
            (Expects::Tables(keys), DeValue::Array(tables)) => {
                let mut out = vec![];
                for (index, element) in tables.iter().enumerate() {
                    let DeValue::Table(table) = element.get_ref() else {
                        return Err(format!("an array with {}", got(element.get_ref())));
                    };
                    let (path, line) = (format!("{path}.{index}"), (self.line)(element.span().start));
                    self.lines.insert(path.clone(), line);
                    out.push(Value::Table(self.table(table, keys, &path, line)));
                }
                Ok(Value::Array(out))
            }
            _ => Err(refusal()),
        }
    }
}

fn whole(text: &str, radix: u32) -> Option<i64> {
    i64::from_str_radix(&text.replace('_', ""), radix).ok()
}

/// For a key that is missing.
fn what(expects: &Expects) -> String {
    match expects {
        Expects::Table(keys) => {
            let names: Vec<&str> = keys.iter().filter(|key| key.required).map(|key| key.name).collect();
            format!("a table with {}", names.join(", "))
        }
        _ => expects.describe(),
    }
}

/// What stands for a required value until the file has it: nothing that a sound file can have.
fn stand_in(expects: &Expects) -> Value {
    match expects {
        Expects::Text | Expects::Word(_) => Value::String(String::new()),
        Expects::Flag => Value::Boolean(false),
        Expects::Number(..) => Value::Float(f64::NAN),
        Expects::Whole(low, _) => Value::Integer(*low),
        Expects::Tables(_) => Value::Array(vec![]),
        Expects::Table(keys) => {
            let entry = |key: &Key| (key.name.to_owned(), stand_in(&key.expects));
            Value::Table(keys.iter().filter(|key| key.required).map(entry).collect())
        }
    }
}
