//! From the parsed file to messages with codecs, with the checks that the parser does not make.

use super::codec::{Codec, FRAME_BYTES, Field, Kind};
use super::database::{Message, Signal};
use super::error::Problem;
use super::multiplexing::{self, Candidate, Condition, Extended};
use super::text::{INDEPENDENT, Place, Places, frame_id};
use crate::can::FrameId;
use can_dbc::{AttributeValue, ByteOrder, Dbc, NumericValue, SignalExtendedValueType, ValueType};
use std::collections::HashMap;

const CYCLE_TIME: &str = "GenMsgCycleTime";

/// What is wrong, and in which line.
type Wrong = (usize, Problem);

/// What other statements of the file say about a message.
#[derive(Default)]
struct Said<'a> {
    value_types: HashMap<&'a str, SignalExtendedValueType>,
    multiplexings: Vec<Extended<'a>>,
    cycle_time: Option<(&'a AttributeValue, usize)>,
}

/// The messages of the file.
pub(super) fn messages(dbc: &Dbc, places: &Places) -> Result<Vec<Message>, Wrong> {
    let mut said = said(dbc, places)?;
    let (mut messages, mut lines) = (Vec::<Message>::new(), Vec::new());
    for (message, (place, signal_lines)) in dbc.messages.iter().zip(&places.messages) {
        if place.id == INDEPENDENT {
            continue;
        }
        let at = |problem| (place.line, problem);
        let wrong_id = || at(Problem::Identifier { got: place.id.to_string() });
        let id = frame_id(place.id).ok_or_else(wrong_id)?;
        check_against_others(&messages, &lines, id, message, place.line).map_err(at)?;
        for (i, signal) in message.signals.iter().enumerate() {
            if let Some(first) = message.signals[..i].iter().position(|s| s.name == signal.name) {
                let (signal, first_line) = (format!("{}.{}", message.name, signal.name), signal_lines[first]);
                return Err((signal_lines[i], Problem::SameSignal { signal, first_line }));
            }
        }
        let said = said.remove(&place.id).unwrap_or_default();
        // Far above the length of any message in practice; compared alone.
        let length = usize::try_from(message.size).unwrap_or(usize::MAX);
        let (signals, unmapped) = if length <= FRAME_BYTES {
            (signals(message, length, signal_lines, &said)?, Vec::new())
        } else {
            (Vec::new(), message.signals.iter().map(|s| s.name.clone()).collect())
        };
        let default = dbc.attribute_default(CYCLE_TIME).map(|value| (value, place.line));
        let cycle_time_ms = match said.cycle_time.or(default) {
            Some((value, line)) => cycle_time_ms(value, &message.name).map_err(|problem| (line, problem))?,
            None => None,
        };
        let (name, sender) = (message.name.clone(), message.transmitter.clone());
        messages.push(Message { name, id, length, sender, cycle_time_ms, signals, unmapped });
        lines.push(place.line);
    }
    Ok(messages)
}

/// Sorts the statements about messages by the message's identifier as the file has it.
fn said<'a>(dbc: &'a Dbc, places: &Places) -> Result<HashMap<u64, Said<'a>>, Wrong> {
    let mut said: HashMap<u64, Said> = places.messages.iter().map(|(place, _)| (place.id, Said::default())).collect();
    let names: HashMap<(u64, &str), ()> = dbc
        .messages
        .iter()
        .zip(&places.messages)
        .flat_map(|(m, (place, _))| m.signals.iter().map(|s| ((place.id, s.name.as_str()), ())))
        .collect();
    let known = |keyword, place: &Place, signal: &str| {
        let got = || format!("signal {signal} of message {}", place.id);
        if names.contains_key(&(place.id, signal)) {
            Ok(())
        } else {
            Err((place.line, Problem::Reference { keyword, got: got() }))
        }
    };
    for (entry, place) in dbc.signal_extended_value_type_list.iter().zip(&places.value_types) {
        known("SIG_VALTYPE_", place, &entry.signal_name)?;
        if let Some(said) = said.get_mut(&place.id) {
            said.value_types.insert(&entry.signal_name, entry.signal_extended_value_type);
        }
    }
    for (entry, place) in dbc.extended_multiplex.iter().zip(&places.multiplexings) {
        known("SG_MUL_VAL_", place, &entry.signal_name)?;
        if let Some(said) = said.get_mut(&place.id) {
            said.multiplexings.push(Extended {
                signal: &entry.signal_name,
                multiplexor: &entry.multiplexor_signal_name,
                ranges: entry.mappings.iter().map(|m| (m.min_value, m.max_value)).collect(),
                line: place.line,
            });
        }
    }
    let cycle_times = dbc.attribute_values_message.iter().zip(&places.message_attributes);
    for (attribute, place) in cycle_times.filter(|(attribute, _)| attribute.name == CYCLE_TIME) {
        if let Some(said) = said.get_mut(&place.id) {
            said.cycle_time = Some((&attribute.value, place.line));
        }
    }
    Ok(said)
}

/// Identifier and name are the message's own.
fn check_against_others(
    others: &[Message],
    lines: &[usize],
    id: FrameId,
    message: &can_dbc::Message,
    line: usize,
) -> Result<(), Problem> {
    if let Some(k) = others.iter().position(|o| o.id == id) {
        let told = |name: &str, sender: &Option<String>, line: usize| {
            format!("{name} (sent by {}, line {line})", sender.as_deref().unwrap_or("no named node"))
        };
        let first = told(&others[k].name, &others[k].sender, lines[k]);
        return Err(Problem::SameId { id, first, second: told(&message.name, &message.transmitter, line) });
    }
    if let Some(k) = others.iter().position(|o| o.name == message.name) {
        return Err(Problem::SameMessage { name: message.name.clone(), first_line: lines[k] });
    }
    Ok(())
}

/// The signals of a message of at most 8 bytes.
fn signals(message: &can_dbc::Message, length: usize, lines: &[usize], said: &Said) -> Result<Vec<Signal>, Wrong> {
    let path = |signal: &can_dbc::Signal| format!("{}.{}", message.name, signal.name);
    let mut candidates = Vec::with_capacity(message.signals.len());
    for (signal, line) in message.signals.iter().zip(lines) {
        let (field, kind) = place(signal, length, said, || path(signal)).map_err(|problem| (*line, problem))?;
        candidates.push(Candidate { name: &signal.name, indicator: signal.multiplexer_indicator, field, kind });
    }
    let conditions = multiplexing::conditions(&message.name, &candidates, lines, &said.multiplexings)?;
    check_overlap(message, &candidates, &conditions, lines)?;
    let mut signals = Vec::with_capacity(candidates.len());
    for (i, signal) in message.signals.iter().enumerate() {
        let at = |problem| (lines[i], problem);
        let (factor, offset) = (signal.factor, signal.offset);
        if factor == 0.0 || !factor.is_finite() || !offset.is_finite() {
            return Err(at(Problem::Scale { signal: path(signal), factor, offset }));
        }
        let (mut minimum, mut maximum) = (number(signal.min), number(signal.max));
        if minimum > maximum {
            return Err(at(Problem::Limits { signal: path(signal), minimum, maximum }));
        }
        let gates = conditions[i].gates(&candidates, || path(signal)).map_err(at)?;
        let codec = Codec::new(&signal.name, candidates[i].field, candidates[i].kind, (factor, offset), &gates);
        if minimum == 0.0 && maximum == 0.0 {
            (minimum, maximum) = codec.range();
        }
        let multiplexor = conditions[i].multiplexor().map(|m| candidates[m].name.to_owned());
        let (name, unit) = (signal.name.clone(), signal.unit.clone());
        signals.push(Signal { name, unit, minimum, maximum, multiplexor, codec });
    }
    Ok(signals)
}

/// Where the bits are and what they mean.
fn place(
    signal: &can_dbc::Signal,
    length: usize,
    said: &Said,
    path: impl Fn() -> String,
) -> Result<(Field, Kind), Problem> {
    let (start, width) = (signal.start_bit, signal.size);
    let kind = match (said.value_types.get(signal.name.as_str()), signal.value_type) {
        (Some(SignalExtendedValueType::IEEEfloat32Bit), _) => Kind::Float,
        (Some(SignalExtendedValueType::IEEEdouble64bit), _) => Kind::Double,
        (_, ValueType::Signed) => Kind::Signed,
        (_, ValueType::Unsigned) => Kind::Unsigned,
    };
    if !(1..=64).contains(&width) {
        return Err(Problem::Width { signal: path(), got: width });
    }
    match kind {
        Kind::Float if width != 32 => return Err(Problem::FloatWidth { signal: path(), expected: 32, got: width }),
        Kind::Double if width != 64 => return Err(Problem::FloatWidth { signal: path(), expected: 64, got: width }),
        _ => {}
    }
    let big_endian = signal.byte_order == ByteOrder::BigEndian;
    let order = if big_endian { "big-endian" } else { "little-endian" };
    match Field::new(start, width, big_endian).filter(|f| f.bytes() <= length) {
        Some(field) => Ok((field, kind)),
        None => Err(Problem::BeyondMessage { signal: path(), length, start, width, order }),
    }
}

/// No bit belongs to two signals of the same frame.
fn check_overlap(
    message: &can_dbc::Message,
    signals: &[Candidate],
    conditions: &[Condition],
    lines: &[usize],
) -> Result<(), Wrong> {
    for second in 0..signals.len() {
        for first in 0..second {
            let common = signals[first].field.bits() & signals[second].field.bits();
            if common == 0 || conditions[first].excludes(&conditions[second]) {
                continue;
            }
            let path = |i: usize| format!("{}.{}", message.name, signals[i].name);
            let (byte, bit) = (common.trailing_zeros() / 8, common.trailing_zeros() % 8);
            let (first, first_line, line) = (path(first), lines[first], lines[second]);
            return Err((line, Problem::Overlap { first, first_line, second: path(second), byte, bit }));
        }
    }
    Ok(())
}

fn cycle_time_ms(value: &AttributeValue, message: &str) -> Result<Option<f64>, Problem> {
    let time_ms = match value {
        AttributeValue::Uint(time) => *time as f64,
        AttributeValue::Int(time) => *time as f64,
        AttributeValue::Double(time) => *time,
        AttributeValue::String(_) => f64::NAN,
    };
    if !time_ms.is_finite() || time_ms < 0.0 {
        let got = match value {
            AttributeValue::String(text) => format!("{text:?}"),
            _ => time_ms.to_string(),
        };
        return Err(Problem::CycleTime { message: message.to_owned(), got });
    }
    Ok((time_ms > 0.0).then_some(time_ms))
}

fn number(value: NumericValue) -> f64 {
    match value {
        NumericValue::Uint(v) => v as f64,
        NumericValue::Int(v) => v as f64,
        NumericValue::Double(v) => v,
    }
}
