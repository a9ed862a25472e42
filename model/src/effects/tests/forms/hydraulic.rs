//! Forms of what chambers lose and take up.

use super::*;

#[test]
fn a_leak_goes_with_its_power_of_pressure_and_what_leaves_one_chamber_enters_the_other() {
    for m in [0.5, 0.7, 1.0] {
        let cross = |dp: f64| flow("cross_leakage", &[0.3, 1e-3, m, 2.0, 0.0], [2.0 + dp, 2.0], &[], &mut []);
        let [out, into] = cross(1.0);
        assert_eq!(out, -into);
        alike(out, -0.3);
        alike(cross(2.0)[0] / out, 2f64.powf(m));
        alike(cross(-1.0)[0], -out);
        let outside = |p: f64| flow("external_leakage", &[0.2, 0.05, m, 1e-3, 2.0, 0.0], [p, 1.0], &[], &mut []);
        alike(outside(1.0)[0], -0.2);
        alike(outside(1.0)[1], -0.05);
        alike(outside(4.0)[0] / outside(1.0)[0], 4f64.powf(m));
        assert_eq!(outside(0.0)[0], 0.0, "nothing leaves at ambient pressure");
    }
}

#[test]
fn a_leak_is_laminar_far_below_its_transition_and_the_more_gradual_the_smaller_s_is() {
    let cross = |dp: f64, s: f64| -flow("cross_leakage", &[0.3, 0.1, 0.5, s, 0.0], [2.0 + dp, 2.0], &[], &mut [])[0];
    let outside = |g: f64, s: f64| -flow("external_leakage", &[0.3, 0.0, 0.5, 0.1, s, 0.0], [g, 0.0], &[], &mut [])[0];
    for through in [&cross as &dyn Fn(f64, f64) -> f64, &outside] {
        for s in [0.7, 1.0, 2.0] {
            alike(through(1e-6, s) / through(5e-7, s), 2.0);
            assert!((through(4e4, s) / through(1e4, s) - 2.0).abs() < 1e-3);
        }
        assert!(through(0.1, 0.7) < through(0.1, 1.0) && through(0.1, 1.0) < through(0.1, 2.0));
    }
}

#[test]
fn a_lip_lets_nothing_pass_below_its_cracking_pressure_and_what_is_beyond_it_passes_as_through_a_gap() {
    let outside = |g: f64| -flow("external_leakage", &[0.2, 0.0, 1.0, 0.01, 2.0, 1.5], [g, 0.0], &[], &mut [])[0];
    assert_eq!((outside(0.0), outside(1.4)), (0.0, 0.0));
    alike(outside(3.5), 0.2 * 2.0);
    let cross = |dp: f64| -flow("cross_leakage", &[0.2, 0.01, 1.0, 2.0, 0.5], [2.0 + dp, 2.0], &[], &mut [])[0];
    assert_eq!((cross(0.4), cross(-0.4)), (0.0, 0.0));
    alike(cross(1.5), 0.2);
    alike(cross(-1.5), -0.2);
}

#[test]
fn a_wall_of_two_branches_takes_what_both_capacities_hold_each_in_its_time() {
    let (capacity, tau, share, ratio) = (0.4, 0.5, 0.3, 6.0);
    let k = [capacity, tau, share, ratio];
    let pressed = [2.0, 1.0];
    let (mut x, mut dx) = ([0.0; 4], [0.0; 4]);
    let first = flow("wall_creep", &k, pressed, &x, &mut dx);
    alike(first[0], -pressed[0] * (capacity / tau + share * capacity / (ratio * tau)));
    let (step, mut taken) = (1e-3, [0.0; 2]);
    for n in 0..60_000 {
        if n == 3_000 {
            // the slow branch after its time constant
            alike(x[2], pressed[0] * share * capacity * (1.0 - (-1f64).exp()));
        }
        let into = flow("wall_creep", &k, pressed, &x, &mut dx);
        for i in 0..2 {
            taken[i] -= step * into[i];
        }
        x.iter_mut().zip(dx).for_each(|(x, rate)| *x += step * rate);
    }
    for (taken, pressed) in taken.into_iter().zip(pressed) {
        alike(taken, pressed * capacity * (1.0 + share));
    }
}

#[test]
fn air_goes_into_solution_by_a_share_per_bar_of_pressure_and_comes_back() {
    let k = [0.8, 0.3, 0.2, 5.0];
    let gauge_bar = [2.0, 0.0];
    let (mut x, mut dx) = ([0.0; 2], [0.0; 2]);
    let flowing = flow("trapped_air", &k, gauge_bar, &x, &mut dx);
    alike(dx[0], 0.8 * 0.2 * 2.0 / 5.0);
    // what dissolves leaves room for oil, as much as the free air took
    alike(flowing[0], -dx[0] * AMBIENT_BAR / (AMBIENT_BAR + 2.0));
    assert_eq!((dx[1], flowing[1]), (0.0, 0.0), "at ambient pressure nothing dissolves");
    for _ in 0..60_000 {
        flow("trapped_air", &k, gauge_bar, &x, &mut dx);
        x.iter_mut().zip(&dx).for_each(|(x, d)| *x += 1e-3 * d);
    }
    alike(x[0], 0.8 * 0.2 * 2.0);
    let capacity = |x: &[f64]| {
        let mut h = HydraulicPort::at(1.0, gauge_bar.map(|p| AMBIENT_BAR + p));
        let before = h.capacity_ml_bar;
        general("trapped_air").act_value(&k, x, &mut [0.0; 2], &mut Port::Hydraulic(&mut h));
        [h.capacity_ml_bar[0] - before[0], h.capacity_ml_bar[1] - before[1]]
    };
    alike(capacity(&x)[0] / capacity(&[0.0; 2])[0], 1.0 - 0.2 * 2.0);
    assert_eq!(capacity(&[0.9, 0.0])[0], 0.0, "no less than no air is free");
    // back at ambient pressure it comes out again, and drives oil out
    assert!(flow("trapped_air", &k, [0.0; 2], &x, &mut dx)[0] > 0.0 && dx[0] < 0.0);
}

/// What slope, bend and closure add to the displacements at these absolute pressures and this angle.
fn grown(k: [f64; 5], pressure_bar: [f64; 2], angle_rad: f64) -> [f64; 2] {
    let mut h = HydraulicPort { angle_rad, stored_slope_ml_rad: [0.7, -0.4], ..HydraulicPort::at(1.0, pressure_bar) };
    h.displacement_ml_rad = [0.0; 2];
    general("displacement_pressure").act_value(&k, &[], &mut [], &mut Port::Hydraulic(&mut h));
    h.displacement_ml_rad
}

#[test]
fn a_displacement_that_saturates_grows_most_at_its_middle_and_no_further_than_its_bound() {
    let (slope, q, m) = (0.8, 0.6, 3.5);
    let of = |p: f64| grown([0.0, slope, 0.0, q, m], [p, 2.5], 0.0);
    assert_eq!(of(2.5), [0.0; 2], "where eq. (14) is taken to hold");
    let steepness = |p: f64| (of(p + 1e-4)[0] - of(p - 1e-4)[0]) / 2e-4;
    alike(steepness(m), slope);
    for off in [0.5, 1.0, 2.0] {
        alike(steepness(m + off), steepness(m - off));
        alike(steepness(m + off), slope * (1.0 - (q * off).tanh().powi(2)));
    }
    assert!(steepness(m + 2.0 / q) < 0.1 * slope && of(60.0)[0] < slope * 2.0 / q);
    // the chambers are each other's mirror image
    let (k, angle_rad) = ([0.3, slope, 0.5, q, m], 0.2);
    let (one, other) = (grown(k, [4.0, 1.5], angle_rad), grown(k, [1.5, 4.0], -angle_rad));
    alike(one[0] - 0.3 * 0.7, -(other[1] + 0.3 * 0.4));
    alike(one[1] + 0.3 * 0.4, -(other[0] - 0.3 * 0.7));
    // the series meets the quotient
    let near = |q: f64| grown([0.0, slope, 0.0, q, 2.5], [3.5, 2.5], 0.0)[0];
    assert!((near(0.999e-2) - near(1.001e-2)).abs() < 2e-7 && near(1e-3) < near(0.0));
}
