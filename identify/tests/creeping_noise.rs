//! Noise with a memory that no filter of a sensor has: it is no effect, and hides none that is larger.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use common::{creeping, layout, problem, run};
use identify::diagnose::{Declared, Diagnosis, Verdict, diagnose_declared};
use identify::fit::{Effort, fit};
use identify::misfit;
use model::Parameters;
use model::effects::{Effect, find};

/// The diagnosis of a rig with these effects whose pressure sensors creep.
fn diagnosed(acting: &[(&'static dyn Effect, Vec<f64>)]) -> Diagnosis {
    let truth = Parameters::example();
    let problem = problem(&[7, 8, 9].map(|seed| creeping(run(&truth, acting.to_vec(), 20.0, seed), seed)));
    let layout = layout(&truth);
    let component = layout.vector_of(&truth);
    let base = fit(&problem, &layout, problem.point(component.clone()), Effort::default()).unwrap();
    let library = ["wall_creep", "stribeck_friction", "pressure_drift", "pump_lag", "cross_leakage", "tilt"]
        .map(|id| find(id).unwrap());
    let base = Declared { problem: &problem, fit: &base, component: &component };
    diagnose_declared(&library, &base, &|text| println!("{text}")).unwrap()
}

#[test]
fn noise_that_creeps_is_no_effect() {
    let found = diagnosed(&[]);
    let left = misfit::largest(&found.parts_after);
    assert!(left > 0.7, "it is more than noise that forgets itself: {left}");
    assert_eq!(found.verdict, Verdict::None);
    assert!(found.silent);
}

#[test]
fn an_effect_is_named_in_noise_that_creeps() {
    let found = diagnosed(&[(find("pump_lag").unwrap(), vec![0.02])]);
    let names: Vec<&str> = found.effects.iter().map(|a| a.effect.header().id).collect();
    assert_eq!((found.verdict, &names[..]), (Verdict::Attributed, &["pump_lag"][..]));
    assert!((found.after.point.theta.last().unwrap() / 0.02 - 1.0).abs() < 0.1);
}
