//! Smoothing and differences without a shift in time.

/// Least-squares cubic over `half` samples to both sides, evaluated in its middle (Savitzky and Golay, Analytical Chemistry 36, 1964):
/// a low-pass without a shift. Near an end the outermost whole window is evaluated off its middle. At least 3 samples to both
/// sides, and a series of a window.
pub fn local_cubic(values: &[f64], half: usize) -> Vec<f64> {
    assert!(half >= 3 && values.len() > 2 * half, "a cubic needs a window of 7 samples at least, and a series as long");
    // moments of -half..half, odd ones vanish
    let moment = |power: i32| -> f64 { (1..=half).map(|i| 2.0 * (i as f64).powi(power)).sum() };
    let (s0, s2, s4, s6) = (2.0 * half as f64 + 1.0, moment(2), moment(4), moment(6));
    let (even, odd) = (s0 * s4 - s2 * s2, s2 * s6 - s4 * s4);
    let n = values.len();
    let at = |i: usize| {
        let middle = i.clamp(half, n - 1 - half);
        let mut sums = [0.0; 4];
        for (j, v) in values[middle - half..=middle + half].iter().enumerate() {
            let x = j as f64 - half as f64;
            let mut weighted = *v;
            for sum in &mut sums {
                *sum += weighted;
                weighted *= x;
            }
        }
        let c0 = (s4 * sums[0] - s2 * sums[2]) / even;
        let c2 = (s0 * sums[2] - s2 * sums[0]) / even;
        let c1 = (s6 * sums[1] - s4 * sums[3]) / odd;
        let c3 = (s2 * sums[3] - s4 * sums[1]) / odd;
        let x = i as f64 - middle as f64;
        c0 + x * (c1 + x * (c2 + x * c3))
    };
    (0..n).map(at).collect()
}

/// Central first and second differences over time, per second and per second squared; the outermost values are repeated.
pub fn differences(values: &[f64], step_s: f64) -> (Vec<f64>, Vec<f64>) {
    assert!(values.len() >= 3, "a second difference needs 3 samples");
    let inner = |i: usize| i.clamp(1, values.len() - 2);
    let first = |i: usize| (values[i + 1] - values[i - 1]) / (2.0 * step_s);
    let second = |i: usize| (values[i + 1] - 2.0 * values[i] + values[i - 1]) / (step_s * step_s);
    let rows = 0..values.len();
    (rows.clone().map(|i| first(inner(i))).collect(), rows.map(|i| second(inner(i))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_passes_to_the_ends() {
        let f = |x: f64| 2.0 - x + 3.0 * x * x - 0.4 * x * x * x;
        let series: Vec<f64> = (0..50).map(|i| f(f64::from(i) * 0.1)).collect();
        assert!(local_cubic(&series, 6).iter().zip(&series).all(|(a, b)| (a - b).abs() < 1e-9));
    }

    #[test]
    fn noise_is_less_behind_it_and_a_slow_wave_stays_in_phase() {
        let noise: Vec<f64> =
            (0..1000u32).map(|i| f64::from(i.wrapping_mul(2_654_435_761) >> 16 & 0xff) - 127.5).collect();
        let power = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>();
        assert!(power(&local_cubic(&noise, 15)) < 0.15 * power(&noise));
        let wave: Vec<f64> = (0..1000).map(|i| (f64::from(i) * 0.05).sin()).collect();
        let smooth = local_cubic(&wave, 15);
        let error: Vec<f64> = smooth.iter().zip(&wave).map(|(a, b)| a - b).collect();
        assert!(power(&error) < 1e-4 * power(&wave));
    }

    #[test]
    fn differences_of_a_parabola_are_exact() {
        let series: Vec<f64> = (0..20).map(|i| 3.0 * (f64::from(i) * 0.1).powi(2)).collect();
        let (first, second) = differences(&series, 0.1);
        assert!((1..19).all(|i| (first[i] - 0.6 * i as f64).abs() < 1e-9));
        assert!(second.iter().all(|a| (a - 6.0).abs() < 1e-9));
    }
}
