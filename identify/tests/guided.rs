//! Starts that are found where the simulation follows what was measured.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use common::{dynamic, layout, problem, run};
use identify::diagnose::{Declared, Verdict, diagnose_declared};
use identify::fit::{Effort, Fit, fit};
use identify::guide::Guide;
use identify::guided::{Guided, Led};
use identify::problem::Problem;
use identify::score::Scene;
use model::Parameters;
use model::effects::find;

#[test]
fn a_guided_lever_stays_where_the_rig_s_was() {
    let truth = Parameters::example();
    let friction = find("stribeck_friction").unwrap();
    let problem = problem(&[dynamic(&truth, Some((friction, vec![1.5, 0.2, 0.02])), 20.0, 7)]);
    let layout = layout(&truth);
    let point = problem.point(layout.vector_of(&truth));
    let cost = |lever_s: f64| {
        let guided = problem.guided(Guide { lever_s, pressure_s: 3.0 * lever_s }).unwrap();
        guided.cost(&layout, &point) / problem.targets() as f64
    };
    let (tight, loose, free) = (cost(0.03), cost(0.1), problem.cost(&layout, &point) / problem.targets() as f64);
    assert!(1.5 < tight && tight < loose && 3.0 * loose < free, "{tight} {loose} {free}");
}

#[test]
fn friction_that_a_free_run_can_not_find_is_led_to() {
    let truth = Parameters::example();
    let friction = find("stribeck_friction").unwrap();
    let values = vec![1.5, 0.2, 0.02];
    let problem = problem(&[dynamic(&truth, Some((friction, values.clone())), 20.0, 7)]);
    let layout = layout(&truth);
    // all other parameters have bent to where the friction is least missed
    let bent = fit(&problem, &layout, problem.point(layout.vector_of(&truth)), Effort::default()).unwrap();
    let with = layout.with(friction);
    let targets = problem.targets() as f64;
    let led = Guided::new(&problem, &layout, &bent.point.theta, &layout.vector_of(&truth)).unwrap();
    let Led { theta, cost } = led.led(friction, f64::INFINITY).unwrap();
    let found = fit(&problem, &with, problem.point(theta), Effort::default()).unwrap();
    assert!(found.cost < 1.1 * targets, "{} of {}", found.cost / targets, bent.cost / targets);
    for (v, k) in found.point.theta[with.first_of(0)..].iter().zip(values) {
        assert!((v / k - 1.0).abs() < 0.05, "{v} for {k}");
    }
    let mut point = bent.point.clone();
    point.theta.extend(friction.header().starts[0]);
    let free = fit(&problem, &with, point, Effort::default()).unwrap();
    assert!(free.cost > 50.0 * targets, "a free run finds it as well: {}", free.cost / targets);
    // what is not there leads nowhere
    let lag = find("pump_lag").unwrap();
    assert!(led.led(lag, f64::INFINITY).is_none());
    // nor does what stays far behind another one
    assert!((led.cost_of(&found) / cost - 1.0).abs() < 0.3, "{} {cost}", led.cost_of(&found));
    assert!(led.led(friction, cost).is_some() && led.led(friction, 0.01 * cost).is_none());
    assert!(led.takes_away(friction) > 0.5 && led.takes_away(lag) < 0.1);
}

#[test]
fn where_little_is_missing_only_what_shows_is_led() {
    let truth = Parameters::example();
    let (friction, lag) = (find("stribeck_friction").unwrap(), find("pump_lag").unwrap());
    let problem = problem(&[dynamic(&truth, Some((friction, vec![0.8, 0.2, 0.02])), 20.0, 7)]);
    let layout = layout(&truth);
    let known = layout.vector_of(&truth);
    let fitted = fit(&problem, &layout, problem.point(known.clone()), Effort::default()).unwrap();
    let led = Guided::new(&problem, &layout, &fitted.point.theta, &known).unwrap();
    assert!(!led.shows(), "{}", led.cost_of(&fitted) / problem.targets() as f64);
    assert!(led.led(friction, f64::INFINITY).is_some());
    assert!(led.led(lag, f64::INFINITY).is_none());
}

#[test]
fn an_effect_comes_in_at_the_expense_of_what_has_taken_it_up() {
    let truth = Parameters::example();
    let problem = problem(&[dynamic(&truth, None, 20.0, 7)]);
    let tight = problem.guided(Guide { lever_s: 0.03, pressure_s: 0.1 }).unwrap();
    let layout = layout(&truth);
    let fitted = fit(&tight, &layout, tight.point(layout.vector_of(&truth)), Effort::default()).unwrap();
    let scene = Scene::new(&tight, &fitted).unwrap();
    // friction, which the losses of eq. (16) imitate; an offset of an angle, which nothing does
    for (id, values, most) in [("pressure_friction", [0.02, 0.02].as_slice(), 0.05), ("angle_offset", &[0.5], 1.0)] {
        let effect = find(id).unwrap();
        let with = layout.with(effect);
        let mut plain = fitted.point.clone();
        plain.theta.extend(values);
        let taken_back = scene.taken_back(&with, values).unwrap();
        assert_eq!(taken_back.theta[with.first_of(0)..], *values, "the effect itself stays");
        let more = |point| tight.cost(&with, point) - fitted.cost;
        assert!(more(&plain) > 100.0, "{id}: {}", more(&plain));
        assert!(more(&taken_back) < most * more(&plain), "{id}: {} of {}", more(&taken_back), more(&plain));
    }
}

const RUBS: [f64; 3] = [1.5, 0.2, 0.02];

/// Three runs of a rig with a gross friction peak, base values that it has not bent, and a fit without it.
fn rubbing() -> (Problem, Vec<f64>, Fit) {
    let truth = Parameters::example();
    let friction = find("stribeck_friction").unwrap();
    let problem = problem(&[7, 8, 9].map(|seed| dynamic(&truth, Some((friction, RUBS.to_vec())), 16.0, seed)));
    let layout = layout(&truth);
    let component = layout.vector_of(&truth);
    let bent = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
    (problem, component, bent)
}

#[test]
fn a_gross_friction_is_named_and_nothing_beside_it() {
    let (problem, component, bent) = rubbing();
    let library: Vec<_> =
        ["elastic_hysteresis", "stribeck_friction", "pressure_friction", "backlash", "end_stop", "cross_leakage"]
            .map(|id| find(id).unwrap())
            .to_vec();
    let base = Declared { problem: &problem, fit: &bent, component: &component };
    let found = diagnose_declared(&library, &base, &|text| println!("{text}")).unwrap();
    let names: Vec<&str> = found.effects.iter().map(|a| a.effect.header().id).collect();
    assert_eq!((found.verdict, names), (Verdict::Attributed, vec!["stribeck_friction"]));
    let after = found.after.point.theta;
    for (v, k) in after[after.len() - 3..].iter().zip(RUBS) {
        assert!((v / k - 1.0).abs() < 0.05, "{v} for {k}");
    }
}

/// Names that a diagnosis gives to a gross friction peak beside a lag of both pressure sensors.
fn named_beside_a_lag(tau_s: f64) -> Vec<&'static str> {
    let truth = Parameters::example();
    let (friction, lag) = (find("stribeck_friction").unwrap(), find("pressure_lag").unwrap());
    let effects = || vec![(friction, RUBS.to_vec()), (lag, vec![tau_s, tau_s])];
    let problem = problem(&[7, 8, 9].map(|seed| run(&truth, effects(), 16.0, seed)));
    let layout = layout(&truth);
    let component = layout.vector_of(&truth);
    let bent = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
    let library = ["stribeck_friction", "pressure_friction", "backlash", "pressure_lag"].map(|id| find(id).unwrap());
    let base = Declared { problem: &problem, fit: &bent, component: &component };
    let found = diagnose_declared(&library, &base, &|text| println!("{text}")).unwrap();
    let mut names: Vec<&str> = found.effects.iter().map(|a| a.effect.header().id).collect();
    names.sort_unstable();
    assert!(found.after.cost < 1.1 * problem.targets() as f64, "{names:?}: {}", found.after.cost);
    names
}

#[test]
fn a_lag_beside_a_gross_friction_is_named() {
    assert_eq!(named_beside_a_lag(0.006), ["pressure_lag", "stribeck_friction"]);
}

#[test]
fn a_gross_friction_beside_a_lag_that_shows_first_is_led_to_although_the_lag_leads_nowhere() {
    assert_eq!(named_beside_a_lag(0.025), ["pressure_lag", "stribeck_friction"]);
}

#[test]
fn frictions_that_stand_in_each_other_s_place_change_places_where_the_guide_lets_go() {
    let truth = Parameters::example();
    let friction = find("stribeck_friction").unwrap();
    let values = [1.1, 0.06, 0.006];
    let problem = problem(&[17, 18].map(|seed| dynamic(&truth, Some((friction, values.to_vec())), 12.0, seed)));
    let with = layout(&truth).with(friction);
    let mut known = layout(&truth).vector_of(&truth);
    known.extend(values);
    let a = with.names().iter().position(|n| n == "a").unwrap();
    let w_s = with.first_of(0) + 2;
    // which velocity belongs to which of them
    let mut swapped = known.clone();
    (swapped[a], swapped[w_s]) = (known[w_s], known[a]);
    let tight = problem.guided(Guide { lever_s: 0.03, pressure_s: 0.1 }).unwrap();
    let there = |theta: &[f64]| fit(&tight, &with, tight.point(theta.to_vec()), Effort::default()).unwrap();
    let (right, wrong) = (there(&known), there(&swapped));
    assert!(right.cost + 20.0 < wrong.cost, "a minimum of its own: {} {}", right.cost, wrong.cost);
    let from = &wrong.point.theta;
    let starts = Guided::new(&problem, &with, from, from).unwrap().let_go();
    let free = |theta: &Vec<f64>| fit(&problem, &with, problem.point(theta.clone()), Effort::default()).unwrap();
    let costs: Vec<f64> = starts.iter().map(|theta| free(theta).cost / problem.targets() as f64).collect();
    assert!(costs[0] > 1.2, "the guide lets go of the wrong one as well: {costs:?}");
    assert!(costs.iter().any(|cost| *cost < 1.1), "{costs:?}");
}

#[test]
fn what_no_name_explains_lies_where_terms_lead_that_follow_what_was_measured() {
    let truth = Parameters::example();
    // an encoder whose error is a wave over its own angle
    let shown = |seed: u64| {
        let mut r = dynamic(&truth, None, 16.0, seed);
        r.angle_deg.iter_mut().for_each(|angle| *angle += 4.0 * (10.0 * angle.to_radians()).sin());
        r
    };
    let problem = problem(&[7, 8, 9].map(shown));
    let layout = layout(&truth);
    let component = layout.vector_of(&truth);
    let bent = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
    let library = ["torque_cubic", "backlash", "pump_lag", "cross_leakage"].map(|id| find(id).unwrap());
    let base = Declared { problem: &problem, fit: &bent, component: &component };
    let found = diagnose_declared(&library, &base, &|text| println!("{text}")).unwrap();
    let names: Vec<&str> = found.effects.iter().map(|a| a.effect.header().id).collect();
    let targets = problem.targets() as f64;
    assert!(bent.cost > 500.0 * targets, "gross: {}", bent.cost / targets);
    assert_eq!((found.verdict, &names[..]), (Verdict::Unrecognised, &["empirical_sensor"][..]));
    assert!(
        found.after.cost < 2.0 * targets,
        "terms of the fifth order follow the wave: {}",
        found.after.cost / targets
    );
}
