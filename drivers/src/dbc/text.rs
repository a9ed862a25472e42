//! The text of a database: encoding, syntax, and the line of each statement, which `can-dbc` does not keep.

use super::error::{DbcError, Problem};
use crate::can::FrameId;
use can_dbc::Dbc;
use can_dbc_pest::{DbcParser, Error as PestError, Pair, Parser as _, Rule};
use pest::error::{ErrorVariant, LineColLocation};
use std::borrow::Cow;

/// Identifier of `VECTOR__INDEPENDENT_SIG_MSG`, where editors keep signals that are in no message.
pub(super) const INDEPENDENT: u64 = 0xC000_0000;
/// Bit 31 of an identifier in the file: 29 bits.
const EXTENDED: u64 = 1 << 31;
/// Longest piece of the file in a message.
const SHOWN_CHARS: usize = 40;

/// A statement about a message.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Identifier as the file has it.
    pub id: u64,
    /// From 1.
    pub line: usize,
}

/// Where the statements are, in the order in which [`Dbc`] has them.
#[derive(Default)]
pub(super) struct Places {
    /// With the lines of their signals.
    pub messages: Vec<(Place, Vec<usize>)>,
    pub value_types: Vec<Place>,
    pub multiplexings: Vec<Place>,
    pub message_attributes: Vec<Place>,
}

/// UTF-8 (with or without a byte-order mark), else Windows-1252, in which DBC files are by tradition. Every byte has a meaning there.
pub(super) fn decode(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text.strip_prefix('\u{FEFF}').unwrap_or(text)),
        Err(_) => can_dbc_pest::encodings::WINDOWS_1252.decode_without_bom_handling(bytes).0,
    }
}

/// The frame's identifier for one of the file; `None` for one that is neither 11 nor 29 bits.
pub(super) fn frame_id(id: u64) -> Option<FrameId> {
    match id {
        0..=0x7FF => FrameId::standard(id as u16),
        EXTENDED.. => FrameId::extended(u32::try_from(id - EXTENDED).ok()?),
        _ => None,
    }
}

/// Parses the text, and finds where its statements are.
pub(super) fn parse(text: &str, file: &str) -> Result<(Dbc, Places), DbcError> {
    let at = |line, problem| DbcError::File { file: file.to_owned(), line, problem };
    let pairs = DbcParser::parse(Rule::file, text).map_err(|e| syntax(text, file, &e))?;
    for pair in pairs.clone().flatten().filter(|p| p.as_rule() == Rule::message_id) {
        let id = pair.as_str().parse().ok().filter(|id| *id == INDEPENDENT || frame_id(*id).is_some());
        if id.is_none() {
            return Err(at(pair.line_col().0, Problem::Identifier { got: shown(pair.as_str()) }));
        }
    }
    // The parser would take it for a signal that is always there.
    if let Some(pair) =
        pairs.clone().flatten().find(|p| p.as_rule() == Rule::multiplexer_indicator && p.as_str() == "m")
    {
        let ((line, column), expected) = (pair.line_col(), "m and a value (m0, m1, ...) or M".to_owned());
        return Err(at(line, Problem::Syntax { column, expected, got: "m".to_owned() }));
    }
    let mut places = Places::default();
    let statements: Vec<Pair<Rule>> = pairs.flat_map(Pair::into_inner).collect();
    for statement in &statements {
        places.note(statement);
    }
    match Dbc::try_from(text) {
        Ok(dbc) => Ok((dbc, places)),
        // The parser does not say where: the first statement that fails by itself.
        Err(e) => {
            let failing = statements.iter().find_map(|s| Dbc::try_from(s.as_str()).err().map(|e| (s, e)));
            let (statement, e) = failing.map_or((None, e), |(statement, e)| (Some(statement), e));
            let line = statement.map_or(1, |s| s.line_col().0);
            let got = shown(statement.map_or(text, |s| s.as_str()));
            Err(at(line, Problem::Statement { got, reason: e.to_string() }))
        }
    }
}

impl Places {
    fn note(&mut self, statement: &Pair<Rule>) {
        let place = || {
            let id = statement.clone().into_inner().flatten().find(|p| p.as_rule() == Rule::message_id);
            // Every identifier of the file is a number by now.
            let id = id.and_then(|p| p.as_str().parse().ok()).unwrap_or(INDEPENDENT);
            Place { id, line: statement.line_col().0 }
        };
        match statement.as_rule() {
            Rule::message => {
                // A signal's text begins at the end of the line before it; its name stands in its line.
                let names = statement.clone().into_inner().flatten().filter(|p| p.as_rule() == Rule::signal_name);
                self.messages.push((place(), names.map(|p| p.line_col().0).collect()));
            }
            Rule::signal_value_type => self.value_types.push(place()),
            Rule::sg_mul_val => self.multiplexings.push(place()),
            Rule::attr_value if statement.clone().into_inner().any(|p| p.as_rule() == Rule::msg_var_val) => {
                self.message_attributes.push(place());
            }
            _ => {}
        }
    }
}

/// The parser's own error, in words.
fn syntax(text: &str, file: &str, e: &PestError<Rule>) -> DbcError {
    let (line, column) = match e.line_col {
        LineColLocation::Pos(at) | LineColLocation::Span(at, _) => at,
    };
    let rest = text.lines().nth(line - 1).map(|l| l.chars().skip(column - 1).collect::<String>()).unwrap_or_default();
    let got = match rest.trim() {
        "" if line >= text.lines().count() => "the end of the file".to_owned(),
        "" => "the end of the line".to_owned(),
        rest => format!("{:?}", shown(rest)),
    };
    let expected = match &e.variant {
        // At the start of a statement all of them are possible.
        ErrorVariant::ParsingError { positives, .. } if positives.is_empty() || positives.contains(&Rule::message) => {
            "a statement of a DBC file (BU_, BO_, SG_, CM_, BA_, VAL_, ...)".to_owned()
        }
        ErrorVariant::ParsingError { positives, .. } => {
            let names: Vec<String> = positives.iter().map(|r| format!("{r:?}").replace('_', " ")).collect();
            names.join(" or ")
        }
        ErrorVariant::CustomError { message } => message.clone(),
    };
    DbcError::File { file: file.to_owned(), line, problem: Problem::Syntax { column, expected, got } }
}

/// The first line of a piece of the file, cut where it is long.
fn shown(text: &str) -> String {
    let line = text.trim().lines().next().unwrap_or_default().trim_end();
    let mut cut: String = line.chars().take(SHOWN_CHARS).collect();
    if cut.len() < line.len() {
        cut.push_str("...");
    }
    cut
}
