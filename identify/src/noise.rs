//! Sensor noise, estimated from the data alone.

/// Standard deviation of the white part of a series' noise: from second differences, which a slow signal hardly enters, in
/// windows of 64 samples, of which the median counts so that transients do not. `NaN` values are passed over. The step of a
/// quantised sensor is part of it where the noise dithers it. Of a sensor that is slower than the rows, so that hardly three rows in
/// succession have a value, the values themselves are taken in their succession.
pub fn white_std(values: &[f64]) -> Option<f64> {
    white_std_of_adjacent(values).or_else(|| from_differences(between_present(values).into_iter()))
}

/// The same of rows in succession alone: between others lies what is no noise, a new segment say.
pub fn white_std_of_adjacent(values: &[f64]) -> Option<f64> {
    from_differences(values.windows(3).map(|w| w[0] - 2.0 * w[1] + w[2]))
}

/// What second differences would be of the values that are there, if they were evenly spaced. Where a gap is longer than twice the usual one the
/// succession is broken.
fn between_present(values: &[f64]) -> Vec<f64> {
    let rows: Vec<usize> = (0..values.len()).filter(|&i| values[i].is_finite()).collect();
    let mut gaps: Vec<f64> = rows.windows(2).map(|w| (w[1] - w[0]) as f64).collect();
    let longest = 2.0 * median(&mut gaps);
    let difference = |w: &[usize]| {
        let (before, behind) = ((w[1] - w[0]) as f64, (w[2] - w[1]) as f64);
        let whole = before + behind;
        // what the outer two's straight line leaves at the middle one, and its variance in units of the noise's: 1.5 where the gaps are equal, 6 of a
        // second difference
        let left = values[w[1]] - (behind * values[w[0]] + before * values[w[2]]) / whole;
        let variance = 1.0 + (before * before + behind * behind) / (whole * whole);
        (before.max(behind) <= longest).then(|| left * (6.0 / variance).sqrt())
    };
    rows.windows(3).filter_map(difference).collect()
}

fn from_differences(differences: impl Iterator<Item = f64>) -> Option<f64> {
    const WINDOW: usize = 64;
    // second differences of white noise correlate by -2/3 and 1/6, so the mean square of 64 of them has 33 degrees of freedom: its
    // median lies 2 % below its mean
    const MEAN_OVER_MEDIAN: f64 = 1.0205;
    let mut windows = Vec::new();
    let mut sum = 0.0;
    let mut count = 0usize;
    for d in differences {
        if d.is_finite() {
            sum += d * d;
            count += 1;
            if count == WINDOW {
                windows.push(sum / count as f64 / 6.0);
                sum = 0.0;
                count = 0;
            }
        }
    }
    if windows.is_empty() {
        if count < 8 {
            return None;
        }
        windows.push(sum / count as f64 / 6.0);
    }
    let bias = if windows.len() > 1 { MEAN_OVER_MEDIAN } else { 1.0 };
    Some((bias * median(&mut windows)).sqrt())
}

/// Step of a quantised series: the least distance of two different values, if at most 2000 of them occur; 0 for a
/// continuous one.
pub fn step(values: &[f64]) -> f64 {
    let distinct = |values: &mut dyn Iterator<Item = f64>| {
        let mut sorted: Vec<f64> = values.filter(|v| v.is_finite()).collect();
        let all = sorted.len();
        sorted.sort_unstable_by(f64::total_cmp);
        sorted.dedup();
        (sorted, all)
    };
    // hardly a value comes twice: no need to look at all of them
    let (some, all) = distinct(&mut values.iter().copied().take(20_000));
    if all > 1000 && some.len() * 2 > all {
        return 0.0;
    }
    let (sorted, _) = distinct(&mut values.iter().copied());
    if sorted.len() > 20_000 || sorted.len() < 3 {
        return 0.0;
    }
    let mut gaps: Vec<f64> = sorted.windows(2).map(|w| w[1] - w[0]).collect();
    // rounding in a file moves each value a little: the typical gap, not the least
    median(&mut gaps)
}

/// Standard deviation of values about their straight line over the index; 0 for fewer than 3.
pub fn spread_about_line(values: &[f64]) -> f64 {
    if values.len() < 3 {
        return 0.0;
    }
    let n = values.len() as f64;
    let middle = (n - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / n;
    let (mut tt, mut tv) = (0.0, 0.0);
    for (i, v) in values.iter().enumerate() {
        let t = i as f64 - middle;
        tt += t * t;
        tv += t * (v - mean);
    }
    let slope = tv / tt;
    let left = values.iter().enumerate().map(|(i, v)| (v - mean - slope * (i as f64 - middle)).powi(2));
    (left.sum::<f64>() / (n - 2.0)).sqrt()
}

/// Standard error of the mean of values whose noise remembers itself for up to a twentieth of them: from how the means of tenths of
/// them differ. 0 for fewer than 50, of which nothing is told so.
pub fn error_of_mean(values: &[f64]) -> f64 {
    const PARTS: usize = 10;
    let length = values.len() / PARTS;
    if length < 5 {
        return 0.0;
    }
    let means: Vec<f64> =
        values.chunks_exact(length).take(PARTS).map(|c| c.iter().sum::<f64>() / length as f64).collect();
    let all = means.iter().sum::<f64>() / PARTS as f64;
    let square = means.iter().map(|m| (m - all).powi(2)).sum::<f64>() / (PARTS - 1) as f64;
    (square / PARTS as f64).sqrt()
}

/// Median; reorders its argument. 0 for an empty one.
pub fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    let (_, m, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    *m
}

/// Mean of the finite values, and how many there are.
pub fn mean(values: impl IntoIterator<Item = f64>) -> (f64, usize) {
    let (mut sum, mut n) = (0.0, 0);
    for v in values {
        if v.is_finite() {
            sum += v;
            n += 1;
        }
    }
    (if n > 0 { sum / n as f64 } else { f64::NAN }, n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    #[test]
    fn noise_on_a_moving_quantised_signal_is_found() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
        let normal = Normal::new(0.0, 0.01).unwrap();
        let step = 360.0 / 16384.0;
        let series: Vec<f64> = (0..20000)
            .map(|i| {
                let t = i as f64 * 1e-3;
                let y = 30.0 * (t * 2.0).sin() + normal.sample(&mut rng);
                (y / step).round() * step
            })
            .collect();
        let expected = (0.01f64.powi(2) + step * step / 12.0).sqrt();
        let found = white_std(&series).unwrap();
        assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
        assert_eq!(white_std(&[1.0, 2.0]), None);
    }

    #[test]
    fn the_noise_of_a_sensor_that_is_slower_than_the_rows_is_found() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let normal = Normal::new(0.0, 0.01).unwrap();
        let series: Vec<f64> = (0..40_000).map(|i| 3.0 * (i as f64 * 1e-3).sin() + normal.sample(&mut rng)).collect();
        let thinned = |has: fn(usize) -> bool| -> Vec<f64> {
            series.iter().enumerate().map(|(i, v)| if has(i) { *v } else { f64::NAN }).collect()
        };
        // every other row, two of three, now every fourth and now every sixth, and none for a long time in between
        let sparse: [fn(usize) -> bool; 4] = [
            |i| i % 2 == 1,
            |i| !i.is_multiple_of(3),
            |i| i.is_multiple_of(10) || i % 10 == 4,
            |i| i.is_multiple_of(5) && i % 8_000 < 4_000,
        ];
        for (n, has) in sparse.into_iter().enumerate() {
            let values = thinned(has);
            assert_eq!(white_std_of_adjacent(&values), None);
            let found = white_std(&values).unwrap();
            assert!((found / 0.01 - 1.0).abs() < 0.08, "{n}: {found}");
        }
        // where rows in succession tell it they alone do
        let bursts = thinned(|i| i % 100 < 50);
        assert_eq!(white_std(&bursts), white_std_of_adjacent(&bursts));
    }

    #[test]
    fn the_error_of_a_mean_knows_the_noise_s_colour() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let normal = Normal::new(0.0, 1.0).unwrap();
        for kept in [0.0, 0.95f64] {
            let (mut last, mut true_square, mut told_square) = (0.0, 0.0, 0.0);
            for _ in 0..400 {
                let rest: Vec<f64> = (0..1000)
                    .map(|_| {
                        last = kept * last + (1.0 - kept * kept).sqrt() * normal.sample(&mut rng);
                        last
                    })
                    .collect();
                true_square += (rest.iter().sum::<f64>() / 1000.0).powi(2);
                told_square += error_of_mean(&rest).powi(2);
            }
            let ratio = (told_square / true_square).sqrt();
            assert!((0.85..1.15).contains(&ratio), "{kept}: {ratio}");
        }
        assert_eq!(error_of_mean(&[1.0; 49]), 0.0);
    }

    #[test]
    fn the_spread_about_a_line_is_the_noise_s_whatever_its_colour() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        let normal = Normal::new(0.0, 1.0).unwrap();
        let (mut last, kept) = (0.0, 0.9f64);
        let series: Vec<f64> = (0..20_000)
            .map(|i| {
                last = kept * last + (1.0 - kept * kept).sqrt() * normal.sample(&mut rng);
                5.0 + 1e-3 * i as f64 + last
            })
            .collect();
        assert!((spread_about_line(&series) - 1.0).abs() < 0.05);
        assert!(white_std(&series).unwrap() < 0.4, "second differences see its white part alone");
        assert_eq!(spread_about_line(&[1.0, 2.0]), 0.0);
        assert!(spread_about_line(&[1.0, 2.0, 3.0]) < 1e-12);
    }
}
