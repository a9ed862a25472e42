//! The text of a database: encoding, syntax, and the line of each statement, which `can-dbc` does not keep.

use super::error::{DbcError, Problem};
use crate::can::FrameId;
use can_dbc::Dbc;
use can_dbc_pest::{DbcParser, Error as PestError, Pair, Parser as _, Rule};
use pest::Position;
use pest::error::InputLocation;
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
    let pairs = DbcParser::parse(Rule::file, text).map_err(|e| syntax(text, file, e))?;
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
    let is_number = |p: &Pair<Rule>| matches!(p.as_rule(), Rule::start_bit | Rule::signal_size | Rule::message_size);
    if let Some(pair) = pairs.clone().flatten().filter(is_number).find(|p| p.as_str().parse::<u64>().is_err()) {
        let ((line, column), expected) = (pair.line_col(), format!("a whole number 0..={}", u64::MAX));
        return Err(at(line, Problem::Syntax { column, expected, got: shown(pair.as_str()) }));
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

/// The parser's own error, in words. Its first account knows rules alone, which begin before the fault; parsed again with details it
/// also knows the characters that could have stood there.
fn syntax(text: &str, file: &str, first: PestError<Rule>) -> DbcError {
    pest::set_error_detail(true);
    let detailed = DbcParser::parse(Rule::file, text).err().unwrap_or(first);
    pest::set_error_detail(false);
    let attempts = detailed.parse_attempts();
    let at_rule = match detailed.location {
        InputLocation::Pos(at) | InputLocation::Span((at, _)) => at,
    };
    let at = attempts.as_ref().map_or(at_rule, |a| a.max_position.max(at_rule));
    let (before, rest) = text.split_at_checked(at).unwrap_or((text, ""));
    let (line, column) = Position::new(text, before.len()).map_or((1, 1), |p| p.line_col());
    let got = match rest.lines().next().unwrap_or_default().trim() {
        "" if rest.trim().is_empty() => "the end of the file".to_owned(),
        "" => "the end of the line".to_owned(),
        rest => format!("{:?}", shown(rest)),
    };
    let attempts = attempts.filter(|a| a.max_position == before.len());
    let tokens: Vec<String> = attempts.iter().flat_map(|a| a.expected_tokens()).map(|t| t.to_string()).collect();
    let expected = expected(&tokens);
    DbcError::File { file: file.to_owned(), line, problem: Problem::Syntax { column, expected, got } }
}

/// What could have stood there, without blanks and comments, which may stand nearly everywhere.
fn expected(tokens: &[String]) -> String {
    let mut words: Vec<String> = Vec::new();
    for token in tokens {
        let word = match token.as_str() {
            " " | "\t" | "//" => continue,
            // The parser's word for any character, or an end.
            "BUILTIN_RULE" => continue,
            "0..9" => "a digit".to_owned(),
            "a..z" | "A..Z" => "a letter".to_owned(),
            "\n" | "\r" | "\r\n" => "the end of the line".to_owned(),
            // The start of a statement, where all of them are possible.
            "BO_" => return "a statement of a DBC file (BU_, BO_, SG_, CM_, BA_, VAL_, ...)".to_owned(),
            other => format!("{other:?}"),
        };
        if !words.contains(&word) {
            words.push(word);
        }
    }
    let name = ["\"_\"", "a digit", "a letter"].map(str::to_owned);
    if name.iter().all(|w| words.contains(w)) {
        words.retain(|w| !name.contains(w));
        words.push("a name".to_owned());
    }
    if words.is_empty() { "another character".to_owned() } else { words.join(" or ") }
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
