//! The confusion table, and what is asked of it.

use super::case::Case;
use super::judge::Outcome;
use super::plan::Kind;
use serde::Serialize;

/// So many of so many.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Share {
    /// Those that count.
    pub hits: usize,
    /// All.
    pub of: usize,
}

impl Share {
    /// Those of `cases` for which `hit` holds.
    pub fn of<'a>(cases: impl IntoIterator<Item = &'a Case>, hit: impl Fn(&Case) -> bool) -> Share {
        let mut share = Share { hits: 0, of: 0 };
        for case in cases {
            share.of += 1;
            share.hits += usize::from(hit(case));
        }
        share
    }

    /// Between 0 and 1; `None` of nothing.
    pub fn fraction(self) -> Option<f64> {
        (self.of > 0).then(|| self.hits as f64 / self.of as f64)
    }

    /// Wilson's 95 % interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927); all of 0..1 of nothing.
    pub fn wilson(self) -> (f64, f64) {
        const Z: f64 = 1.959_963_985;
        let Some(p) = self.fraction() else { return (0.0, 1.0) };
        let n = self.of as f64;
        let middle = p + Z * Z / (2.0 * n);
        let spread = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
        let scale = 1.0 + Z * Z / n;
        (((middle - spread) / scale).max(0.0), ((middle + spread) / scale).min(1.0))
    }
}

impl std::fmt::Display for Share {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Some(p) = self.fraction() else { return write!(f, "{:>3} of {:>3}", 0, 0) };
        let (low, high) = self.wilson();
        let percent = 100.0 * p;
        write!(f, "{:>3} of {:>3} = {percent:5.1} % ({:.1} .. {:.1} %)", self.hits, self.of, 100.0 * low, 100.0 * high)
    }
}

/// Cases by what they turned out to be: by kind, and singles by the strength that was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Row {
    None,
    /// Below 2 noise floors.
    Faint,
    /// 2 to 3.
    Weak,
    /// 3 to 4.
    Middle,
    /// 4 to 8.
    Clear,
    /// Above.
    Gross,
    /// Both show.
    Pair,
    /// One of the two does not: below 2.
    HalfPair,
    Outside,
    /// Of any kind: the recordings do not determine what their validation needs (it opens a bypass that they don't, say).
    Undetermined,
}

/// Largest validation error of the true effects, fitted, up to which a campaign determines what its validation needs; noise floors.
const PREDICTED: f64 = 2.0;

impl Row {
    const ALL: [(Row, &'static str); 10] = [
        (Row::None, "no effect"),
        (Row::Faint, "single below 2"),
        (Row::Weak, "single 2..3"),
        (Row::Middle, "single 3..4"),
        (Row::Clear, "single 4..8"),
        (Row::Gross, "single above 8"),
        (Row::Pair, "pair"),
        (Row::HalfPair, "pair, one below 2"),
        (Row::Outside, "outside"),
        (Row::Undetermined, "truth's form above 2"),
    ];

    fn of(case: &Case) -> Row {
        match case.kind {
            _ if case.figures.truth.is_some_and(|error| error > PREDICTED) => Row::Undetermined,
            Kind::None => Row::None,
            Kind::Pair if case.least_strength() < 2.0 => Row::HalfPair,
            Kind::Pair => Row::Pair,
            Kind::Outside => Row::Outside,
            Kind::Weak | Kind::Clear | Kind::Gross => match case.least_strength() {
                s if s < 2.0 => Row::Faint,
                s if s <= 3.0 => Row::Weak,
                s if s < 4.0 => Row::Middle,
                s if s <= 8.0 => Row::Clear,
                _ => Row::Gross,
            },
        }
    }
}

/// Columns of the table.
const OUTCOMES: [(&str, &[Outcome]); 8] = [
    ("right", &[Outcome::Right]),
    ("ambiguous with", &[Outcome::AmbiguousWith]),
    ("ambiguous without", &[Outcome::AmbiguousWithout]),
    ("one of two", &[Outcome::Partly]),
    ("missed", &[Outcome::Missed]),
    ("unrecognised", &[Outcome::NotRecognised, Outcome::WrongBalance]),
    ("look-alike", &[Outcome::LookAlike]),
    ("wrong", &[Outcome::WrongName, Outcome::FalseAlarm, Outcome::Failed]),
];

/// The confusion table, as rows of cells.
pub fn confusion(cases: &[Case]) -> Vec<Vec<String>> {
    let mut rows = vec![vec!["cases".to_owned(), "n".to_owned()]];
    rows[0].extend(OUTCOMES.iter().map(|(name, _)| (*name).to_owned()));
    for (row, name) in Row::ALL {
        let own: Vec<&Case> = cases.iter().filter(|c| Row::of(c) == row).collect();
        let mut cells = vec![name.to_owned(), own.len().to_string()];
        let count = |outcomes: &[Outcome]| own.iter().filter(|c| outcomes.contains(&c.outcome)).count().to_string();
        cells.extend(OUTCOMES.iter().map(|(_, outcomes)| count(outcomes)));
        rows.push(cells);
    }
    rows
}

/// What is asked of the diagnosis.
#[derive(Clone, Debug, Serialize)]
pub struct Target {
    /// What is counted.
    pub what: &'static str,
    /// How often it was seen.
    pub share: Share,
    /// Least (or greatest) fraction.
    pub bound: f64,
    /// `true`: at most `bound`.
    pub at_most: bool,
}

impl Target {
    /// Whether what was seen keeps the bound; nothing seen keeps any.
    pub fn holds(&self) -> bool {
        self.share.fraction().is_none_or(|p| if self.at_most { p <= self.bound } else { p >= self.bound })
    }

    /// One line.
    pub fn line(&self) -> String {
        let sign = if self.at_most { "at most" } else { "at least" };
        let verdict = match (self.share.of, self.holds()) {
            (0, _) => "no case",
            (_, true) => "holds",
            (_, false) => "MISSED",
        };
        format!("{:44} {:34} {sign} {:.0} %: {verdict}", self.what, self.share.to_string(), 100.0 * self.bound)
    }
}

/// The targets with what was seen.
pub fn targets(cases: &[Case]) -> Vec<Target> {
    let right = |c: &Case| c.outcome == Outcome::Right;
    let of = |row: &'static [Row]| cases.iter().filter(move |c| row.contains(&Row::of(c)));
    let weak_not_right = || of(&[Row::Weak]).filter(|c| c.outcome != Outcome::Right);
    let target = |what, share, bound, at_most| Target { what, share, bound, at_most };
    vec![
        target("false alarms without effect", Share::of(of(&[Row::None]), |c| !right(c)), 0.01, true),
        target("right class, 4 noise floors or more", Share::of(of(&[Row::Clear, Row::Gross]), right), 0.95, false),
        target("right class, 2 to 3 noise floors", Share::of(of(&[Row::Weak]), right), 0.70, false),
        target(
            "of the others of 2 to 3: ambiguous or none",
            Share::of(weak_not_right(), |c| {
                matches!(c.outcome, Outcome::AmbiguousWith | Outcome::AmbiguousWithout | Outcome::Missed)
            }),
            0.5,
            false,
        ),
        target("pairs, both named", Share::of(of(&[Row::Pair]), right), 0.80, false),
        target("outside: unrecognised, right balance", Share::of(of(&[Row::Outside]), right), 0.90, false),
        target(
            "named: error within 1.1 times the truth's form",
            Share::of(cases.iter().filter(|c| c.named_right()), |c| c.figures.as_good()),
            1.0,
            false,
        ),
    ]
}

/// Structured residual from which an effect counts as seen in the runs that may be fitted: as large as the noise.
const SEEN: f64 = 1.0;

/// The targets that ask for names, or for none, of the cases alone whose effects are seen in the runs that may be fitted. An effect that acts in the
/// validation only (a stop that no other run comes to, say) is in nobody's reach; it counts in [`targets`] all the same.
pub fn seen(cases: &[Case]) -> Vec<(&'static str, Share)> {
    let right = |c: &Case| c.outcome == Outcome::Right;
    let of = |row: &'static [Row]| {
        let seen = cases.iter().filter(|c| c.least_left().is_some_and(|left| left >= SEEN));
        Share::of(seen.filter(move |c| row.contains(&Row::of(c))), right)
    };
    vec![
        ("right class, 4 noise floors or more", of(&[Row::Clear, Row::Gross])),
        ("right class, 2 to 3 noise floors", of(&[Row::Weak])),
        ("pairs, both named", of(&[Row::Pair])),
        ("outside: unrecognised, right balance", of(&[Row::Outside])),
    ]
}

/// How often the 95 % interval of a parameter holds its true value: of effects that are named right, act in the library's own form and are found in it.
/// Where a file has standard errors alone the interval is the one that they would give of as many data as one likes.
pub fn covered(cases: &[Case]) -> Share {
    const Z: f64 = 1.959_963_985;
    let mut share = Share { hits: 0, of: 0 };
    for case in cases.iter().filter(|c| c.outcome == Outcome::Right) {
        for acting in case.acting.iter().filter(|a| a.form == a.id) {
            for (name, truth) in &acting.parameters {
                let own = format!("{}.{name}", acting.id);
                let found = case.figures.values.iter().find(|(name, _, _)| *name == own);
                if let Some((_, value, Some(std))) = found
                    && *std > 0.0
                {
                    let interval = case.figures.intervals.iter().find(|(name, _, _)| *name == own);
                    let (from, to) = interval.map_or((value - Z * std, value + Z * std), |(_, from, to)| (*from, *to));
                    share.of += 1;
                    share.hits += usize::from(from <= *truth && *truth <= to);
                }
            }
        }
    }
    share
}

/// How often the fit that stands for the verdict ends as low as the one from the true values on: of cases that are named right and whose effects act in the
/// library's own form. Where it does not, something held it up.
pub fn at_the_minimum(cases: &[Case]) -> Share {
    /// Share of the cost: the fit from the true values is not brought further to its own minimum.
    const ABOVE: f64 = 2e-4;
    let mut share = Share { hits: 0, of: 0 };
    for case in cases.iter().filter(|c| c.outcome == Outcome::Right && c.kind != Kind::Outside) {
        let own = !case.acting.is_empty() && case.acting.iter().all(|a| a.form == a.id);
        if let (true, Some(after), Some(truth)) = (own, case.figures.cost_after, case.figures.cost_truth) {
            share.of += 1;
            share.hits += usize::from(after <= (1.0 + ABOVE) * truth);
        }
    }
    share
}

#[cfg(test)]
mod tests {
    use super::super::case::Figures;
    use super::super::case::tests::{acting, case};
    use super::*;

    #[test]
    fn an_interval_counts_where_the_effect_has_the_form_that_it_was_given() {
        let of = |form: &str, value: f64, std: Option<f64>, half: Option<f64>| {
            let mut acting = acting("tilt", 5.0, 1.0);
            acting.form = form.to_owned();
            acting.parameters.insert("c".to_owned(), 1.0);
            let values = vec![("tilt.c".to_owned(), value, std)];
            let intervals = half.map(|h| ("tilt.c".to_owned(), value - h, value + h)).into_iter().collect();
            let figures = Figures { values, intervals, ..Figures::default() };
            Case { outcome: Outcome::Right, ..case(vec![acting], &["tilt"], figures) }
        };
        let cases = [
            of("tilt", 1.1, Some(0.06), None),
            of("tilt", 1.1, Some(0.04), None),
            of("another", 1.1, Some(0.04), None),
            // a shape that was held
            of("tilt", 1.1, None, None),
            // few data: Student's interval
            of("tilt", 1.1, Some(0.04), Some(0.11)),
            of("tilt", 1.1, Some(0.04), Some(0.09)),
        ];
        assert_eq!(covered(&cases), Share { hits: 2, of: 4 });
    }

    #[test]
    fn a_fit_that_something_held_up_is_above_the_one_from_the_true_values() {
        let of = |form: &str, cost_after: f64| {
            let mut acting = acting("tilt", 5.0, 1.0);
            acting.form = form.to_owned();
            let figures = Figures { cost_after: Some(cost_after), cost_truth: Some(1.0), ..Figures::default() };
            Case { outcome: Outcome::Right, kind: Kind::Clear, ..case(vec![acting], &["tilt"], figures) }
        };
        let cases = [of("tilt", 0.99), of("tilt", 1.0001), of("tilt", 1.001), of("another", 1.3)];
        assert_eq!(at_the_minimum(&cases), Share { hits: 2, of: 3 });
    }

    #[test]
    fn what_the_fitted_runs_do_not_show_counts_in_the_targets_alone() {
        let of = |left: Option<f64>, outcome: Outcome| {
            let mut acting = acting("tilt", 5.0, 1.0);
            acting.left = left;
            Case { outcome, kind: Kind::Clear, ..case(vec![acting], &["tilt"], Figures::default()) }
        };
        let cases = [
            of(Some(3.0), Outcome::Right),
            of(Some(0.3), Outcome::Missed),
            of(None, Outcome::Missed),
            of(Some(1.0), Outcome::Missed),
        ];
        assert_eq!(targets(&cases)[1].share, Share { hits: 1, of: 4 });
        assert_eq!(seen(&cases)[0].1, Share { hits: 1, of: 2 });
    }

    #[test]
    fn intervals_are_wilsons() {
        // Newcombe, Stat. Med. 17 (1998) 857, table I
        let near = |share: Share, low: f64, high: f64| {
            let (a, b) = share.wilson();
            assert!((a - low).abs() < 6e-5 && (b - high).abs() < 6e-5, "{share:?}: {a} {b}");
        };
        near(Share { hits: 81, of: 263 }, 0.2553, 0.3662);
        near(Share { hits: 15, of: 148 }, 0.0624, 0.1605);
        near(Share { hits: 0, of: 20 }, 0.0, 0.1611);
        near(Share { hits: 1, of: 29 }, 0.0061, 0.1718);
        assert_eq!(Share { hits: 0, of: 0 }.wilson(), (0.0, 1.0));
    }

    #[test]
    fn a_bound_is_kept_from_its_own_side() {
        let target = |hits, bound, at_most| Target { what: "x", share: Share { hits, of: 100 }, bound, at_most };
        assert!(target(1, 0.01, true).holds() && !target(2, 0.01, true).holds());
        assert!(target(95, 0.95, false).holds() && !target(94, 0.95, false).holds());
        assert!(target(94, 0.95, false).line().contains("MISSED"));
    }
}
