//! Rivals and the runs that separate them; a model that carries an effect from the start.

#![allow(clippy::unwrap_used, reason = "a test that can't go on fails")]

mod common;

use common::{dynamic, layout, problem};
use identify::declared::Declared;
use identify::design::{Prior, Rival, separation, would_give};
use identify::diagnose::{self, diagnose_declared};
use identify::fit::{Effort, Fit, fit};
use identify::problem::Problem;
use model::Parameters;
use model::effects::find;
use recordings::{Plane, Protocol};

/// The campaign's runs, and a fit of it with these effects.
fn rival(campaign: &Problem, truth: &Parameters, effects: &[(&'static str, &[f64])]) -> Rival {
    let mut own = layout(truth);
    let mut theta = own.vector_of(truth);
    for (id, values) in effects {
        own.effects.push(find(id).unwrap());
        theta.extend_from_slice(values);
    }
    let fit: Fit = fit(campaign, &own, campaign.point(theta), Effort::default()).unwrap();
    Rival { ids: effects.iter().map(|e| e.0).collect(), probability: 0.5, fit }
}

#[test]
fn what_a_refit_takes_up_separates_nothing_and_what_it_can_t_does() {
    let truth = Parameters::example();
    let campaign = problem(&[dynamic(&truth, None, 12.0, 1)]);
    let plain = rival(&campaign, &truth, &[]);
    let prior = Prior::of(&campaign, &plain).unwrap();
    let run = |seconds: f64| {
        would_give(&campaign, Protocol::RandomSteps, Plane::Horizontal, &dynamic(&truth, None, seconds, 9)).unwrap()
    };
    let own = separation(&prior, &prior, &run(10.0)).unwrap();
    assert!(own.z < 1e-6 && own.noise_floors < 1e-6, "{own:?}");

    // a base parameter off by half of what the campaign leaves open is no other hypothesis: D^2 <= d' H d = 1/4
    let mut moved = plain.clone();
    let pieces = campaign.linearise(&plain.fit.layout, &plain.fit.point).unwrap();
    let information = campaign.normal(&pieces, plain.fit.layout.len(), &plain.fit.point).matrix;
    moved.fit.point.theta[1] += 0.5 / information[(1, 1)].sqrt();
    let moved_prior = Prior::of(&campaign, &moved).unwrap();
    let taken_up = separation(&moved_prior, &prior, &run(10.0)).unwrap();
    assert!(taken_up.z < 0.3, "{taken_up:?}");

    // an effect of the same size in noise floors is one
    let leaking = rival(&campaign, &truth, &[("cross_leakage", &[0.4, 0.5])]);
    let mut other = leaking.clone();
    let n = other.fit.layout.base.len();
    other.fit.point.theta[n] = 0.6;
    let other = Prior::of(&campaign, &other).unwrap();
    let apart = separation(&other, &prior, &run(10.0)).unwrap();
    assert!(apart.z > 1.0 && apart.z > 2.0 * taken_up.z, "{apart:?} {taken_up:?}");
    let longer = separation(&other, &prior, &run(40.0)).unwrap();
    assert!(longer.z > 1.5 * apart.z, "four times as long, {longer:?} after {apart:?}");
}

#[test]
fn a_declared_effect_is_identified_with_the_base() {
    let truth = Parameters::example();
    let (effect, values) = (find("pump_lag").unwrap(), vec![0.05]);
    let campaign = problem(&[dynamic(&truth, Some((effect, values.clone())), 16.0, 3)]);
    let base = rival(&campaign, &truth, &[]).fit;
    let declared = Declared { parameters: truth, effects: vec![(effect, vec![0.02])] };
    assert!(declared.open().iter().all(|e| e.header().id != "pump_lag"));
    let refitted = declared.refit(&campaign, &base, Effort::default()).unwrap();
    let found = &refitted.point.theta[base.point.theta.len()..];
    for (found, value) in found.iter().zip(&values) {
        assert!((found - value).abs() < 0.002, "{found} for {value}");
    }
    assert!(refitted.cost < 1.2 * campaign.targets() as f64, "{} of {}", refitted.cost, campaign.targets());
    assert!(base.cost > 1.5 * campaign.targets() as f64, "it mattered: {}", base.cost);
}

#[test]
fn an_effect_that_no_run_provokes_is_said_to_be_out_of_reach() {
    use identify::judged::{not_judged, said};
    use identify::score::Scene;
    let truth = Parameters::example();
    let library = [find("brake_valve_lag").unwrap(), find("pump_lag").unwrap()];
    let hidden = |seconds: f64, misfit: f64, seen: &[(&'static str, f64)]| {
        let campaign = problem(&[dynamic(&truth, None, seconds, 1)]);
        let plain = rival(&campaign, &truth, &[]);
        let scene = Scene::new(&campaign, &plain.fit).unwrap();
        not_judged(&library, &campaign, &scene, misfit, seen)
    };
    // its first 5 s leave both valves alone
    let short = hidden(5.0, 1.0, &[]);
    assert_eq!(short.iter().map(|h| h.id).collect::<Vec<_>>(), ["brake_valve_lag"]);
    assert!(short[0].shows < 0.5 && short[0].needed.contains("pump-map"), "{:?}", short[0]);
    assert!(said(&short).unwrap().contains("brake_valve_lag"));
    assert!(hidden(20.0, 1.0, &[]).is_empty() && said(&[]).is_none());
    // what a part of the runs shows need not be looked for in all of them
    assert!(hidden(5.0, 1.0, &[("brake_valve_lag", 4.1)]).is_empty());
    assert_eq!(hidden(5.0, 1.0, &[("brake_valve_lag", 3.9)]).len(), 1, "not enough of it");
    assert_eq!(hidden(5.0, 4.0, &[("brake_valve_lag", 4.1)]).len(), 1, "beside a misfit of twice the noise");
}

#[test]
fn a_diagnosis_says_what_each_candidate_would_show() {
    let truth = Parameters::example();
    let library = [find("brake_valve_lag").unwrap(), find("pump_lag").unwrap()];
    let campaign = problem(&[dynamic(&truth, None, 5.0, 1)]);
    let plain = rival(&campaign, &truth, &[]);
    let component = plain.fit.point.theta.clone();
    let declared = diagnose::Declared { problem: &campaign, fit: &plain.fit, component: &component };
    let found = diagnose_declared(&library, &declared, &|_| ()).unwrap();
    let shows = |id: &str| found.shows.iter().find(|(own, _)| *own == id).map_or(0.0, |(_, shows)| *shows);
    assert!(shows("brake_valve_lag") < 4.0 && shows("pump_lag") > 40.0, "{:?}", found.shows);
}
