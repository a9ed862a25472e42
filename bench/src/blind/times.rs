//! How long a verdict took, by the kind of case.

use super::case::Case;
use super::plan::Kind;

/// The table of identification and diagnosis together, s of the wall's time, as rows of cells: one for each kind that `cases` hold.
/// Cases that ran at the same time share the machine.
pub fn times(cases: &[Case]) -> Vec<Vec<String>> {
    let head = ["identified and diagnosed", "n", "median s", "90th of 100 s", "longest s"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for kind in Kind::ALL {
        let own = cases.iter().filter(|c| c.kind == kind);
        let mut seconds: Vec<f64> = own.map(|c| c.seconds.identify + c.seconds.diagnose).collect();
        seconds.sort_by(f64::total_cmp);
        let Some(longest) = seconds.last() else { continue };
        let figures = [quantile(&seconds, 50), quantile(&seconds, 90), *longest];
        let mut row = vec![kind.as_str().to_owned(), seconds.len().to_string()];
        row.extend(figures.map(|s| format!("{s:.0}")));
        rows.push(row);
    }
    rows
}

/// The least of `sorted` (ascending, at least one) that `percent` of them do not exceed: the nearest rank.
fn quantile(sorted: &[f64], percent: usize) -> f64 {
    sorted[(sorted.len() * percent).div_ceil(100).saturating_sub(1)]
}

#[cfg(test)]
mod tests {
    use super::super::case::tests::case;
    use super::super::case::{Figures, Seconds};
    use super::*;

    #[test]
    fn a_kind_has_its_own_row_and_the_recording_does_not_count() {
        let of = |kind, diagnose| Case {
            kind,
            seconds: Seconds { record: 100.0, measure: 100.0, identify: 1.0, diagnose },
            ..case(Vec::new(), &[], Figures::default())
        };
        let mut cases: Vec<Case> = (1..=10).rev().map(|s| of(Kind::Pair, f64::from(s))).collect();
        cases.push(of(Kind::None, 41.0));
        let rows = times(&cases);
        assert_eq!(rows[1..], [vec!["none", "1", "42", "42", "42"], vec!["pair", "10", "6", "10", "11"]]);
    }
}
