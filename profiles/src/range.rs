//! What a variable of a `for_each` walks through: a list, or values at equal distances.

use crate::error::ScriptError;
use crate::raw::{RawRange, RawValues};
use crate::values::Reader;
use toml::Spanned;

/// More values than this are taken for a mistake.
const MOST_VALUES: f64 = 10_000.0;
/// A last step that misses the end by less than this part of a step reaches it.
const SLACK: f64 = 1e-6;

impl Reader<'_> {
    /// The values of the variable `name`, in their order.
    pub fn values(&self, name: &str, raw: &Spanned<RawValues>) -> Result<Vec<f64>, ScriptError> {
        match raw.get_ref() {
            RawValues::List(list) => list
                .iter()
                .map(|value| match *value.get_ref() {
                    finite if finite.is_finite() => Ok(finite),
                    other => {
                        let what = format!("`{name}` must hold finite numbers, got {other}");
                        Err(self.source.error(value.span().start, what))
                    }
                })
                .collect(),
            RawValues::Range(range) => self.range(name, range, raw.span().start),
        }
    }

    fn range(&self, name: &str, raw: &RawRange, place: usize) -> Result<Vec<f64>, ScriptError> {
        let (from, to) = (self.number("from", &raw.from)?, self.number("to", &raw.to)?);
        let way = to - from;
        let error = |what: String| Err(self.source.error(place, format!("`{name}`: {what}")));
        if way == 0.0 {
            return error(format!("`from` and `to` must differ, got {from} twice: write [{from}] for one value"));
        }
        match (&raw.step, &raw.count) {
            (Some(step), None) => {
                let step = self.within("step", step, f64::MIN_POSITIVE, f64::MAX)?;
                let steps = (way.abs() / step).round();
                if steps >= MOST_VALUES {
                    return error(format!(
                        "{from} .. {to} by {step} are more than {MOST_VALUES} values: take a larger `step`"
                    ));
                }
                let last = from + (steps * step).copysign(way);
                if steps < 1.0 || (last - to).abs() > SLACK * step {
                    let steps = (way.abs() / step).floor();
                    let (short, long) =
                        (from + (steps * step).copysign(way), from + ((steps + 1.0) * step).copysign(way));
                    return error(format!(
                        "from {from} by steps of {step} never comes to {to}: set `to` to {} or {}, or another `step`",
                        decimal(short, step),
                        decimal(long, step)
                    ));
                }
                Ok((0..=steps as u32).map(|k| decimal(from + (f64::from(k) * step).copysign(way), step)).collect())
            }
            (None, Some(count)) => match *count.get_ref() {
                number if number < 2 || f64::from(number) > MOST_VALUES => {
                    let what = format!("`{name}`: `count` must lie within 2 .. {MOST_VALUES}, got {number}");
                    Err(self.source.error(count.span().start, what))
                }
                number => {
                    let last = f64::from(number - 1);
                    // Exact at both ends.
                    Ok((0..number).map(f64::from).map(|k| (from * (last - k) + to * k) / last).collect())
                }
            },
            _ => error("a range needs one of `step` (above 0) and `count` beside `from` and `to`".to_owned()),
        }
    }
}

/// The number that somebody would have written on a way in such steps: 0.3, not 0.1 + 0.2, and 0, not what is left of 0.3 less 0.3.
fn decimal(value: f64, step: f64) -> f64 {
    const DECIMALS: f64 = 1e9;
    let rounded = (value * DECIMALS).round() / DECIMALS;
    // Also where the value is too large to have such decimals, and not minus 0.
    if (rounded - value).abs() <= value.abs().max(step) * 1e-12 { rounded + 0.0 } else { value }
}

#[cfg(test)]
mod tests {
    use super::decimal;

    #[test]
    fn steps_give_the_decimals_that_one_would_have_written() {
        assert_eq!(decimal(0.1 + 2.0 * 0.1, 0.1), 0.3);
        assert_eq!(decimal(0.3 - 3.0 * 0.1, 0.1).to_bits(), 0.0_f64.to_bits());
        assert_eq!(decimal(1e300, 1e299), 1e300);
        assert_eq!(decimal(1.0 / 3.0, 0.1), 1.0 / 3.0);
    }
}
