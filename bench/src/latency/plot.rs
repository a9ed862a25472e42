//! Distributions side by side as bars of text: durations and counts both in logarithmic scale, so that the rare long ones
//! show beside the many short ones.

use crate::latency::statistics::Distribution;

/// Rows for a doubling of the duration.
const ROWS_PER_OCTAVE: i32 = 2;
/// Rows lie within these powers of 2 us: 62 ns to 17 s.
const OCTAVES: std::ops::Range<i32> = -4..24;
/// Longest bar, characters.
const BAR: usize = 22;

/// Lines of a plot. `columns` holds names and distributions; one without a duration shows no bars.
pub fn histogram(title: &str, columns: &[(&str, &Distribution)]) -> Vec<String> {
    let edges_us: Vec<f64> = (OCTAVES.start * ROWS_PER_OCTAVE..=OCTAVES.end * ROWS_PER_OCTAVE)
        .map(|k| 2_f64.powf(f64::from(k) / f64::from(ROWS_PER_OCTAVE)))
        .collect();
    let last = edges_us.len() - 2;
    let rows: Vec<Vec<u64>> = (0..=last)
        .map(|row| {
            // Nothing is left out at either end.
            let from_us = if row == 0 { 0.0 } else { edges_us[row] };
            let to_us = if row == last { f64::INFINITY } else { edges_us[row + 1] };
            columns.iter().map(|(_, distribution)| distribution.count_within(from_us, to_us)).collect()
        })
        .collect();
    let filled = |row: &Vec<u64>| row.iter().any(|count| *count > 0);
    let (Some(first), Some(end)) = (rows.iter().position(filled), rows.iter().rposition(filled)) else {
        return Vec::new();
    };
    let most = rows.iter().flatten().copied().max().unwrap_or(1);

    let head: String = columns.iter().map(|(name, _)| format!("  {name:<width$}", width = BAR + 9)).collect();
    let mut lines = vec![format!("{title:<19}{}", head.trim_end())];
    for (row, counts) in rows.iter().enumerate().take(end + 1).skip(first) {
        let cells: String = counts.iter().map(|count| cell(*count, most)).collect();
        let line = format!("{:>8} ..{:>8}{cells}", short(edges_us[row]), short(edges_us[row + 1]));
        lines.push(line.trim_end().to_owned());
    }
    lines
}

fn cell(count: u64, most: u64) -> String {
    if count == 0 {
        return " ".repeat(BAR + 11);
    }
    let share = (count as f64).ln_1p() / (most as f64).ln_1p();
    let length = ((share * BAR as f64).round() as usize).clamp(1, BAR);
    format!("  {:<BAR$} {count:<8}", "█".repeat(length))
}

/// Three digits.
fn short(us: f64) -> String {
    let decimals = if us < 9.995 { 2 } else { usize::from(us < 99.95) };
    format!("{us:.decimals$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_us(values: &[(u64, u64)]) -> Distribution {
        let mut distribution = Distribution::default();
        values.iter().for_each(|(us, times)| distribution.record_times_ns(us * 1000, *times));
        distribution
    }

    #[test]
    fn every_duration_stands_in_its_row_and_column() {
        let (loop_us, bare_us) = (of_us(&[(17, 1000), (3000, 2)]), of_us(&[(12, 10)]));
        let lines = histogram("lateness, us", &[("loop", &loop_us), ("bare loop", &bare_us)]);
        assert!(lines[0].starts_with("lateness, us") && lines[0].contains("loop") && lines[0].ends_with("bare loop"));
        assert_eq!(lines[1].split_whitespace().collect::<Vec<_>>()[..3], ["11.3", "..", "16.0"]);
        assert!(lines[1].ends_with("  10") && lines[1].contains("  ████████  "), "{:?}", lines[1]);
        assert!(lines[2].ends_with(&format!("16.0 ..    22.6  {} 1000", "█".repeat(BAR))), "{:?}", lines[2]);
        let last = &lines[lines.len() - 1];
        assert!(last.trim_start().starts_with("2896 ..    4096") && last.ends_with(" 2"), "{last:?}");
        assert_eq!(lines.len(), 1 + 17, "rows without a duration stand between the others");
        let columns = |line: &str| line.chars().position(|c| c == '█');
        assert_eq!(columns(&lines[2]).map(|at| at + BAR + 11), columns(&lines[1]));
    }

    #[test]
    fn the_ends_hold_what_is_beyond_them() {
        let mut distribution = Distribution::default();
        distribution.record_ns(0);
        distribution.record_ns(u64::MAX / 2);
        let lines = histogram("", &[("", &distribution)]);
        assert_eq!(lines.iter().filter(|line| line.ends_with(" 1")).count(), 2, "{lines:?}");
        assert_eq!(histogram("nothing", &[("loop", &Distribution::default())]), Vec::<String>::new());
    }
}
