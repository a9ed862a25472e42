//! Fewer points for display, without losing what an eye would look for: the extremes of every stretch stay.

use identify::figure::{Mark, Series};

/// Upper bound of the values that a series keeps for display (breaks of a line not counted).
pub const MAX_POINTS: usize = 4000;

/// Values kept of each bucket at most: first, last, and the extremes of y; of x too where x does not ascend.
const KEPT_PER_BUCKET: (usize, usize) = (4, 6);

/// The values of one series as they are drawn, in their order. `None` in `y` breaks the line.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// Abscissa, finite.
    pub x: Vec<f64>,
    /// Ordinate, finite, or a break.
    pub y: Vec<Option<f64>>,
}

/// At most [`MAX_POINTS`] values of `series`. Values that are not finite in x or y can't be drawn: they break a line and
/// vanish from a cloud. Where `x` and `y` differ in length the shorter one counts.
pub fn for_display(series: &Series) -> Drawn {
    let finite: Vec<usize> = (0..series.x.len().min(series.y.len()))
        .filter(|&i| series.x[i].is_finite() && series.y[i].is_finite())
        .collect();
    let kept = if finite.len() <= MAX_POINTS { finite.clone() } else { extremes(series, &finite) };

    let mut drawn = Drawn { x: Vec::with_capacity(kept.len()), y: Vec::with_capacity(kept.len()) };
    let mut previous: Option<usize> = None;
    // Position within `finite` tells whether something between two kept values was not finite.
    let mut position = 0;
    let mut previous_position = 0;
    for i in kept {
        while finite[position] != i {
            position += 1;
        }
        if let Some(p) = previous
            && series.mark != Mark::Points
            && i - p != position - previous_position
        {
            drawn.x.push(series.x[p]);
            drawn.y.push(None);
        }
        drawn.x.push(series.x[i]);
        drawn.y.push(Some(series.y[i]));
        previous = Some(i);
        previous_position = position;
    }
    drawn
}

/// Indices of the first, the last and the extreme values of each of equally long stretches, ascending.
fn extremes(series: &Series, finite: &[usize]) -> Vec<usize> {
    let (x, y) = (&series.x, &series.y);
    let ascending = finite.windows(2).all(|w| x[w[0]] <= x[w[1]]);
    let buckets = MAX_POINTS / if ascending { KEPT_PER_BUCKET.0 } else { KEPT_PER_BUCKET.1 };
    let mut kept = Vec::with_capacity(MAX_POINTS);
    for b in 0..buckets {
        let bucket = &finite[b * finite.len() / buckets..(b + 1) * finite.len() / buckets];
        let (Some(&first), Some(&last)) = (bucket.first(), bucket.last()) else { continue };
        let extreme = |values: &[f64], sign: f64| {
            bucket.iter().copied().fold(first, |best, i| if sign * values[i] > sign * values[best] { i } else { best })
        };
        let mut chosen = vec![first, extreme(y, -1.0), extreme(y, 1.0), last];
        if !ascending {
            chosen.extend([extreme(x, -1.0), extreme(x, 1.0)]);
        }
        chosen.sort_unstable();
        chosen.dedup();
        kept.append(&mut chosen);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(mark: Mark, x: Vec<f64>, y: Vec<f64>) -> Series {
        Series { name: "s".into(), mark, group: 0, x, y }
    }

    fn ramp(n: usize) -> Vec<f64> {
        (0..n).map(|i| i as f64 * 1e-3).collect()
    }

    #[test]
    fn a_short_series_is_drawn_as_it_is() {
        let s = series(Mark::Line, vec![0.0, 2.0, 1.0], vec![5.0, 6.0, 7.0]);
        let drawn = for_display(&s);
        assert_eq!(drawn.x, s.x);
        assert_eq!(drawn.y, vec![Some(5.0), Some(6.0), Some(7.0)]);
    }

    #[test]
    fn every_single_spike_survives_wherever_it_stands() {
        let n = 60_000;
        for at in [0, 1, 59, 119, 120, 121, 30_017, n - 2, n - 1] {
            for spike in [9.0, -9.0] {
                let mut y: Vec<f64> = (0..n).map(|i| (i as f64 * 0.01).sin()).collect();
                y[at] = spike;
                let drawn = for_display(&series(Mark::Line, ramp(n), y));
                let found: Vec<f64> =
                    drawn.x.iter().zip(&drawn.y).filter(|(_, y)| **y == Some(spike)).map(|(x, _)| *x).collect();
                assert_eq!(found, vec![at as f64 * 1e-3], "spike {spike} at {at}");
                assert!(drawn.y.len() <= MAX_POINTS);
            }
        }
    }

    #[test]
    fn order_and_ends_stay() {
        let n = 100_000;
        let drawn = for_display(&series(Mark::Line, ramp(n), (0..n).map(|i| ((i * 7919) % 1000) as f64).collect()));
        assert!(drawn.x.windows(2).all(|w| w[0] < w[1]));
        assert_eq!(drawn.x.first(), Some(&0.0));
        assert_eq!(drawn.x.last(), Some(&((n - 1) as f64 * 1e-3)));
        assert!(drawn.y.iter().all(Option::is_some), "a series without gaps must not get one");
    }

    #[test]
    fn a_loop_keeps_its_extent_in_both_directions() {
        let n = 50_000;
        let angle = |i: usize| i as f64 / n as f64 * 200.0 * std::f64::consts::TAU;
        let mut x: Vec<f64> = (0..n).map(|i| angle(i).cos()).collect();
        x[12_345] = 4.0;
        x[43_210] = -4.0;
        let drawn = for_display(&series(Mark::Line, x, (0..n).map(|i| angle(i).sin()).collect()));
        assert!(drawn.x.contains(&4.0) && drawn.x.contains(&-4.0));
    }

    #[test]
    fn a_gap_breaks_a_line_also_when_it_is_shorter_than_a_bucket() {
        let n = 60_000;
        let mut y = ramp(n);
        y[31_000] = f64::NAN;
        y[40_000] = f64::INFINITY;
        let drawn = for_display(&series(Mark::Line, ramp(n), y));
        assert_eq!(drawn.y.iter().filter(|y| y.is_none()).count(), 2);
        let at = drawn.y.iter().position(Option::is_none).expect("there are two");
        assert!(drawn.x[at - 1] < 31.0 && drawn.x[at + 1] > 31.0);
        assert!(drawn.x.iter().all(|x| x.is_finite()));
    }

    #[test]
    fn missing_values_vanish_from_a_cloud_and_the_rest_stays() {
        let mut y = vec![f64::NAN; 100_000];
        for i in 0..50 {
            y[i * 2000 + 3] = i as f64;
        }
        let drawn = for_display(&series(Mark::Points, ramp(100_000), y));
        assert_eq!(drawn.y, (0..50).map(|i| Some(i as f64)).collect::<Vec<_>>());
    }

    #[test]
    fn nothing_to_draw_is_nothing() {
        assert_eq!(for_display(&series(Mark::Line, vec![], vec![])).x.len(), 0);
        assert_eq!(for_display(&series(Mark::Line, vec![f64::NAN; 5000], vec![1.0; 5000])).x.len(), 0);
    }
}
