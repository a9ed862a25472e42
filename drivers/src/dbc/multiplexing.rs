//! On which values of which multiplexors a signal depends: `M` and `m...` of the signals, `SG_MUL_VAL_` where there are several.

use super::codec::{Field, Gate, Kind, MOST_GATES};
use super::error::Problem;
use arrayvec::ArrayVec;
use can_dbc::MultiplexIndicator;

/// What of a signal matters here.
pub(super) struct Candidate<'a> {
    pub name: &'a str,
    pub indicator: MultiplexIndicator,
    pub field: Field,
    pub kind: Kind,
}

/// A `SG_MUL_VAL_`: the signal is in the frame with these raw values of the multiplexor, both ends included.
pub(super) struct Extended<'a> {
    pub signal: &'a str,
    pub multiplexor: &'a str,
    pub ranges: Vec<(u64, u64)>,
    pub line: usize,
}

/// What must hold for a signal to be in the frame: each of these multiplexors (by its place in the message) in one of its ranges.
/// The outermost multiplexor is first.
#[derive(Clone, Default)]
pub(super) struct Condition(Vec<Switch>);

impl Condition {
    /// Whether no frame can hold both.
    pub(super) fn excludes(&self, other: &Condition) -> bool {
        let apart = |a: &[(u64, u64)], b: &[(u64, u64)]| a.iter().all(|a| b.iter().all(|b| a.1 < b.0 || b.1 < a.0));
        self.0.iter().any(|(m, a)| other.0.iter().any(|(n, b)| m == n && apart(a, b)))
    }

    /// The multiplexor on which it depends directly.
    pub(super) fn multiplexor(&self) -> Option<usize> {
        self.0.last().map(|(multiplexor, _)| *multiplexor)
    }

    /// For the codec.
    pub(super) fn gates(
        &self,
        signals: &[Candidate],
        path: impl Fn() -> String,
    ) -> Result<ArrayVec<Gate, MOST_GATES>, Problem> {
        let got: usize = self.0.iter().map(|(_, ranges)| ranges.len()).sum();
        let mut gates = ArrayVec::new();
        if got > MOST_GATES {
            return Err(Problem::TooManyRanges { signal: path(), most: MOST_GATES, got });
        }
        for (multiplexor, ranges) in &self.0 {
            let multiplexor = signals[*multiplexor].field;
            for (i, (lowest, highest)) in ranges.iter().enumerate() {
                let or_next = i + 1 < ranges.len();
                gates.push(Gate { multiplexor, lowest: *lowest, highest: *highest, or_next });
            }
        }
        Ok(gates)
    }
}

/// The condition of each signal of a message, or the problem and the line; `lines` are the signals'.
pub(super) fn conditions(
    message: &str,
    signals: &[Candidate],
    lines: &[usize],
    extended: &[Extended],
) -> Result<Vec<Condition>, (usize, Problem)> {
    let mut parents = Vec::with_capacity(signals.len());
    for (i, signal) in signals.iter().enumerate() {
        parents.push(parent(message, signals, i, lines[i], extended, signal)?);
    }
    let path = |i: usize| format!("{message}.{}", signals[i].name);
    let mut conditions = Vec::with_capacity(signals.len());
    for i in 0..signals.len() {
        let mut condition = Condition::default();
        let mut at = i;
        while let Some((multiplexor, ranges)) = &parents[at] {
            condition.0.push((*multiplexor, ranges.clone()));
            at = *multiplexor;
            if condition.0.len() > signals.len() {
                let chain: Vec<&str> = condition.0.iter().take(4).map(|(m, _)| signals[*m].name).collect();
                return Err((lines[i], Problem::MultiplexorLoop { signal: path(i), chain: chain.join(", ") }));
            }
        }
        condition.0.reverse();
        conditions.push(condition);
    }
    Ok(conditions)
}

type Parent = Option<Switch>;
/// A multiplexor's place in the message, and its values.
type Switch = (usize, Vec<(u64, u64)>);

/// The multiplexor on which signal `i` depends directly, and its values.
fn parent(
    message: &str,
    signals: &[Candidate],
    i: usize,
    line: usize,
    extended: &[Extended],
    signal: &Candidate,
) -> Result<Parent, (usize, Problem)> {
    let path = || format!("{message}.{}", signal.name);
    let by_file = extended.iter().filter(|e| e.signal == signal.name);
    let has_own = by_file.clone().next().is_some();
    let value = match signal.indicator {
        MultiplexIndicator::MultiplexedSignal(value) | MultiplexIndicator::MultiplexorAndMultiplexedSignal(value) => {
            Some(value)
        }
        // Some editors leave out the m... of a multiplexor that SG_MUL_VAL_ says to be multiplexed itself.
        MultiplexIndicator::Multiplexor if has_own => None,
        MultiplexIndicator::Multiplexor => return Ok(None),
        MultiplexIndicator::Plain => {
            return match by_file.map(|e| e.line).next() {
                Some(line) => Err((line, Problem::NotMultiplexed { signal: path() })),
                None => Ok(None),
            };
        }
    };
    let mut found: Option<(Switch, usize)> = None;
    for entry in by_file {
        let Some(multiplexor) = signals.iter().position(|s| s.name == entry.multiplexor) else {
            let got = format!("{message}.{}", entry.multiplexor);
            return Err((entry.line, Problem::Reference { keyword: "SG_MUL_VAL_", got }));
        };
        match &mut found {
            Some(((first, ranges), _)) if *first == multiplexor => ranges.extend(&entry.ranges),
            Some(((first, _), _)) => {
                let (first, second) = (signals[*first].name.to_owned(), entry.multiplexor.to_owned());
                return Err((entry.line, Problem::TwoMultiplexors { signal: path(), first, second }));
            }
            None => found = Some(((multiplexor, entry.ranges.clone()), entry.line)),
        }
    }
    let ((multiplexor, ranges), line) = match (found, value) {
        (Some(found), _) => found,
        (None, None) => return Ok(None),
        (None, Some(value)) => {
            let mut switches = (0..signals.len()).filter(|k| {
                *k != i
                    && !matches!(
                        signals[*k].indicator,
                        MultiplexIndicator::Plain | MultiplexIndicator::MultiplexedSignal(_)
                    )
            });
            match (switches.next(), switches.next()) {
                (None, _) => return Err((line, Problem::NoMultiplexor { signal: path() })),
                (Some(only), None) => ((only, vec![(value, value)]), line),
                (Some(a), Some(b)) => {
                    let (first, second) = (signals[a].name.to_owned(), signals[b].name.to_owned());
                    return Err((line, Problem::TwoMultiplexors { signal: path(), first, second }));
                }
            }
        }
    };
    let switch = &signals[multiplexor];
    let name = || format!("{message}.{}", switch.name);
    let not = |got| Err((line, Problem::NotAMultiplexor { signal: path(), multiplexor: name(), got }));
    match (switch.indicator, switch.kind) {
        (MultiplexIndicator::Plain | MultiplexIndicator::MultiplexedSignal(_), _) => return not("a signal without M"),
        (_, Kind::Float | Kind::Double) => return not("an IEEE float"),
        _ => {}
    }
    let largest = switch.field.mask();
    if let Some((low, high)) = ranges.iter().find(|(low, high)| low > high || *high > largest) {
        let got = if low == high { low.to_string() } else { format!("{low}-{high}") };
        return Err((line, Problem::MultiplexorValue { signal: path(), multiplexor: name(), largest, got }));
    }
    Ok(Some((multiplexor, joined(ranges))))
}

/// The same values in as few ranges as can be, in ascending order.
fn joined(mut ranges: Vec<(u64, u64)>) -> Vec<(u64, u64)> {
    ranges.sort_unstable();
    let mut joined: Vec<(u64, u64)> = Vec::with_capacity(ranges.len());
    for (low, high) in ranges {
        match joined.last_mut() {
            Some(last) if low <= last.1.saturating_add(1) => last.1 = last.1.max(high),
            _ => joined.push((low, high)),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_joined_where_they_touch() {
        assert_eq!(
            joined(vec![(7, 9), (0, 2), (3, 3), (9, 12), (u64::MAX, u64::MAX)]),
            [(0, 3), (7, 12), (u64::MAX, u64::MAX)]
        );
    }

    #[test]
    fn conditions_exclude_one_another_over_a_multiplexor_they_share() {
        let on = |pairs: &[(usize, (u64, u64))]| Condition(pairs.iter().map(|(m, r)| (*m, vec![*r])).collect());
        assert!(on(&[(0, (1, 1))]).excludes(&on(&[(0, (2, 5))])));
        assert!(on(&[(0, (1, 1)), (3, (0, 4))]).excludes(&on(&[(0, (0, 3)), (3, (5, 5))])));
        assert!(!on(&[(0, (1, 3))]).excludes(&on(&[(0, (3, 5))])));
        assert!(!on(&[(0, (1, 1))]).excludes(&on(&[(1, (2, 2))])));
        assert!(!on(&[]).excludes(&on(&[(0, (2, 2))])));
    }
}
