//! A curve in a terminal, in braille: each character holds 2 x 4 points.

use super::curve::Curve;

/// The rows of the plot from the top, `width` characters wide, without axes. Empty where there is nothing to draw.
pub fn braille(curve: &Curve, width: usize, height: usize) -> Vec<String> {
    let stretches = curve.stretches();
    let there = || stretches.iter().filter(|stretch| stretch.low.is_finite() && stretch.high.is_finite());
    let low = there().map(|stretch| stretch.low).fold(f64::INFINITY, f64::min);
    let high = there().map(|stretch| stretch.high).fold(f64::NEG_INFINITY, f64::max);
    if low > high || width == 0 || height == 0 {
        return Vec::new();
    }
    let (columns, lines) = (2 * width, 4 * height);
    let begin_s = stretches[0].begin_s;
    let span_s = (stretches[stretches.len() - 1].begin_s - begin_s).max(f64::MIN_POSITIVE);
    let span = if high > low { high - low } else { 1.0 };
    // Both are in [0, 1].
    let column = |time_s: f64| ((time_s - begin_s) / span_s * (columns - 1) as f64).round() as usize;
    let line = |value: f64| ((high - value) / span * (lines - 1) as f64).round() as usize;
    let mut dots = vec![vec![0u8; width]; height];
    for stretch in there() {
        let x = column(stretch.begin_s).min(columns - 1);
        for y in line(stretch.high)..=line(stretch.low).min(lines - 1) {
            dots[y / 4][x / 2] |= DOTS[y % 4][x % 2];
        }
    }
    let character =
        |dots: &u8| char::from_u32(0x2800 + u32::from(*dots)).expect("the braille block has 256 characters");
    dots.iter().map(|row| row.iter().map(character).collect()).collect()
}

/// Bits of a braille character by line and column.
const DOTS: [[u8; 2]; 4] = [[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]];

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(values: impl Iterator<Item = f64>) -> Curve {
        let mut curve = Curve::default();
        values.enumerate().for_each(|(i, value)| curve.push(i as f64, value));
        curve
    }

    #[test]
    fn a_ramp_goes_from_the_lower_left_to_the_upper_right() {
        assert_eq!(braille(&curve((0..8).map(f64::from)), 4, 2), ["⠀⠀⡠⠊", "⡠⠊⠀⠀"]);
    }

    #[test]
    fn what_does_not_change_is_a_line_and_nothing_is_nothing() {
        let line = braille(&curve([2.5; 100].into_iter()), 10, 2);
        assert!(line[0].chars().all(|c| c == '⠉') && line[1].chars().all(|c| c == '⠀'), "{line:?}");
        assert!(braille(&curve(std::iter::empty()), 10, 2).is_empty());
        assert!(braille(&curve([f64::NAN; 9].into_iter()), 10, 2).is_empty());
        assert_eq!(braille(&curve([1.0].into_iter()), 3, 1).len(), 1);
    }
}
