//! Local polynomials: a series with its derivatives, without a shift in time.

/// A smoothed series with its derivatives.
#[derive(Clone, Debug)]
pub struct Smoothed {
    /// In the series' unit.
    pub value: Vec<f64>,
    /// Per second.
    pub first: Vec<f64>,
    /// Per second squared.
    pub second: Vec<f64>,
}

/// Least-squares cubic over `half` samples to both sides, evaluated in its middle (Savitzky and Golay, Analytical Chemistry 36, 1964);
/// near an end the outermost whole window is evaluated off its middle. At least 3 samples to both sides, and a series of a window.
pub fn local_cubic(values: &[f64], step_s: f64, half: usize) -> Smoothed {
    assert!(half >= 3 && values.len() > 2 * half, "a cubic needs a window of 7 samples at least, and a series as long");
    // moments of -half..half, odd ones vanish
    let moment = |power: i32| -> f64 { (1..=half).map(|i| 2.0 * (i as f64).powi(power)).sum() };
    let (s0, s2, s4, s6) = (2.0 * half as f64 + 1.0, moment(2), moment(4), moment(6));
    let (even, odd) = (s0 * s4 - s2 * s2, s2 * s6 - s4 * s4);
    let n = values.len();
    let mut out = Smoothed { value: vec![0.0; n], first: vec![0.0; n], second: vec![0.0; n] };
    for i in 0..n {
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
        out.value[i] = c0 + x * (c1 + x * (c2 + x * c3));
        out.first[i] = (c1 + x * (2.0 * c2 + 3.0 * x * c3)) / step_s;
        out.second[i] = (2.0 * c2 + 6.0 * x * c3) / (step_s * step_s);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_passes_with_its_derivatives_to_the_ends() {
        let step = 0.01;
        let f = |t: f64| 2.0 - t + 3.0 * t * t - 4.0 * t * t * t;
        let series: Vec<f64> = (0..50).map(|i| f(i as f64 * step)).collect();
        let smooth = local_cubic(&series, step, 6);
        for i in 0..50 {
            let t = i as f64 * step;
            assert!((smooth.value[i] - f(t)).abs() < 1e-9);
            assert!((smooth.first[i] - (-1.0 + 6.0 * t - 12.0 * t * t)).abs() < 1e-7, "{i}");
            assert!((smooth.second[i] - (6.0 - 24.0 * t)).abs() < 1e-5, "{i}");
        }
    }
}
