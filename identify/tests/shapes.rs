//! Effects whose shapes a fit can't follow down a slope, and whose sizes trade places with them.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use common::{dynamic, layout, problem};
use identify::fit::{Effort, Fit, fit};
use identify::identification::covariance_of;
use identify::{forms, shapes};
use model::Parameters;
use model::effects::find;

#[test]
fn a_shape_far_from_its_place_is_found_by_trial() {
    let truth = Parameters::example();
    for (id, sealed, start) in
        [("elastic_hysteresis", [1.5, 0.3], [0.1, 0.02]), ("pressure_friction", [1.0, 0.1], [0.1, 0.002])]
    {
        let effect = find(id).unwrap();
        let problem = problem(&[dynamic(&truth, Some((effect, sealed.to_vec())), 20.0, 51)]);
        let with = layout(&truth).with(effect);
        let mut point = problem.point(layout(&truth).vector_of(&truth));
        point.theta.extend(start);
        let targets = problem.targets() as f64;
        let in_its_shape = fit(&problem, &shapes::held(&with), point, Effort::default()).unwrap();
        let stuck = Fit { layout: with, ..in_its_shape };
        assert!(stuck.cost > 1.3 * targets, "{id}: no size leads there: {}", stuck.cost / targets);
        let found = shapes::search(&problem, stuck, Effort::default());
        assert!(found.cost < 1.1 * targets, "{id}: {}", found.cost / targets);
        let values = &found.point.theta[found.layout.first_of(0)..];
        for (v, s) in values.iter().zip(sealed) {
            assert!((v / s - 1.0).abs() < 0.1, "{id}: {values:?}");
        }
        assert!(found.layout.held.is_empty(), "{id}: the shapes are free again");
    }
}

/// Of an all but laminar leak k/sqrt(d) is known: that there is a leak is certain, what k and d are is not.
#[test]
fn a_size_that_trades_places_with_its_shape_is_certain_once_that_is_held() {
    let truth = Parameters::example();
    let leak = find("cross_leakage").unwrap();
    let values = vec![2.0, 15.0];
    let problem = problem(&[dynamic(&truth, Some((leak, values.clone())), 20.0, 51)]);
    let with = layout(&truth).with(leak);
    let mut point = problem.point(layout(&truth).vector_of(&truth));
    point.theta.extend(&values);
    let at = fit(&problem, &with, point, Effort::default()).unwrap();
    let k = at.layout.first_of(0);
    let std = |fit: &Fit| covariance_of(&problem, fit).unwrap()[(k, k)].sqrt();
    let (free, held) = (std(&at), std(&Fit { layout: shapes::held(&at.layout), ..at.clone() }));
    assert!(held < 0.05 * at.point.theta[k], "{held} of {}", at.point.theta[k]);
    assert!(free > 5.0 * held, "{free} {held}");
}

/// A wall that creeps in two steps is fitted as one, air that dissolves as air that stays, a hysteresis of several elements that bend late as Dahl's,
/// a pump with a dead time and a ramp as one with a lag, a valve that overlaps as one that doesn't, oil that swings in the line as oil that follows, a sensor that
/// swings as one that is slow; what has the library's form stays in it, and so does what was
/// there before.
#[test]
fn an_effect_takes_its_general_form_where_it_needs_one() {
    takes("wall_creep", &[0.3, 0.5], &[&[0.4, 0.15, 0.8, 8.0], &[0.4, 0.4]]);
    takes("trapped_air", &[3.0, 3.0], &[&[8.0, 6.0, 0.25, 1.5], &[8.0, 6.0]]);
    takes("elastic_hysteresis", &[0.3, 0.15], &[&[0.4, 0.12, 2.0, 0.8, 0.7, 0.5, 4.0], &[0.8, 0.12]]);
    takes("brake_valve_lag", &[0.02, 0.02], &[&[0.06, 0.04, 0.35, 0.0], &[0.06, 0.04]]);
    takes("bypass_valve_lag", &[0.02, 0.02], &[&[0.06, 0.04, 0.0, 0.75], &[0.06, 0.04]]);
    takes("pump_lag", &[0.01], &[&[0.014, 0.6, 0.15], &[0.02]]);
    takes("line_inertance", &[0.03], &[&[0.03, 0.002, 0.0], &[0.1]]);
    takes("pressure_lag", &[0.02, 0.02], &[&[0.05, 0.04, 0.5, 0.0], &[0.3, 0.25, 0.06, 0.6], &[0.05, 0.03]]);
}

/// Fits the library's form of an effect, from `start`, to each sealed one: that of its general form where it has more parameters.
fn takes(id: &str, start: &[f64], sealed: &[&[f64]]) {
    let truth = Parameters::example();
    let plain = find(id).unwrap();
    for values in sealed {
        let bent = values.len() > plain.header().parameters.len();
        let effect = if bent { plain.refined().unwrap().effect } else { plain };
        let problem = problem(&[dynamic(&truth, Some((effect, values.to_vec())), 20.0, 51)]);
        let mut point = problem.point(layout(&truth).vector_of(&truth));
        point.theta.extend(start);
        let found = fit(&problem, &layout(&truth).with(plain), point, Effort::default()).unwrap();
        let targets = problem.targets() as f64;
        let kept = forms::refined(&problem, found.clone(), &[], forms::FOLLOWED, Effort::default(), forms::CLEARLY);
        assert_eq!(kept.point.theta, found.point.theta, "what was not added is left alone");
        let refined =
            forms::refined(&problem, found.clone(), &[id], forms::FOLLOWED, Effort::default(), forms::CLEARLY);
        assert!(refined.cost < 1.1 * targets, "{values:?}: {} from {}", refined.cost / targets, found.cost / targets);
        let own = &refined.point.theta[refined.layout.first_of(0)..];
        assert_eq!(own.len(), values.len(), "{own:?}");
        if bent {
            assert!(found.cost > 1.15 * targets, "the library's form is not enough: {}", found.cost / targets);
        }
        // two branches share what they do in ways that are nearly alike, three elements in ways that can't be told apart: there the error alone counts
        let within = match own.len() {
            ..=4 => 0.2,
            5..=6 => 0.5,
            _ => continue,
        };
        for (v, k) in own.iter().zip(*values) {
            assert!((v - k).abs() < within * k.abs().max(0.05), "{own:?}");
        }
    }
}
