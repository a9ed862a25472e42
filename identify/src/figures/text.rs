//! Numbers as a person reads them.

/// `value` with this many significant digits; in powers of ten where it is very large or small.
pub fn number(value: f64, digits: i32) -> String {
    if !value.is_finite() {
        return "-".into();
    }
    if value == 0.0 {
        return "0".into();
    }
    let magnitude = value.abs().log10().floor() as i32;
    if (-5..7).contains(&magnitude) {
        format!("{value:.*}", (digits - 1 - magnitude).max(0) as usize)
    } else {
        format!("{value:.*e}", (digits - 1) as usize)
    }
}

/// A value as exactly as its standard error allows: two digits of the error.
pub fn measured(value: f64, std: f64) -> String {
    if !(std.is_finite() && std > 0.0) || value == 0.0 {
        return number(value, 4);
    }
    let digits = value.abs().log10().floor() as i32 - std.log10().floor() as i32 + 2;
    number(value, digits.clamp(2, 12))
}

/// A p-value or probability.
pub fn chance(p: f64) -> String {
    if p >= 0.01 { format!("{p:.2}") } else { number(p, 1) }
}

/// A 95 % interval, `half` to either side, as exactly as the standard error allows.
pub fn interval(value: f64, std: f64, half: f64) -> String {
    if half.is_finite() { between([value - half, value + half], std) } else { "-".into() }
}

/// An interval by its ends, as exactly as the standard error allows.
pub fn between([from, to]: [f64; 2], std: f64) -> String {
    format!("{} .. {}", measured(from, std), measured(to, std))
}

/// The run's file without what says its format.
pub fn run_name(file: &str) -> &str {
    [".csv.gz", ".csv", ".mcap"].iter().find_map(|end| file.strip_suffix(end)).unwrap_or(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_follow_the_size_and_the_error() {
        assert_eq!(number(0.0123456, 3), "0.0123");
        assert_eq!(number(123456.0, 3), "123456");
        assert_eq!(number(-1.5e-9, 2), "-1.5e-9");
        assert_eq!(number(f64::NAN, 3), "-");
        assert_eq!(measured(6.81234, 0.0123), "6.812");
        assert_eq!(measured(0.00812, 0.0123), "0.0081");
        assert_eq!(measured(100.0, f64::INFINITY), "100.0");
        assert_eq!(interval(1.0, 0.1, 0.196), "0.80 .. 1.20");
        assert_eq!(chance(0.0005), "0.0005");
        assert_eq!(run_name("square_h.csv.gz"), "square_h");
    }
}
