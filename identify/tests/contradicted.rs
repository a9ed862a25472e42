//! Runs that were not fitted decide nothing. Where they don't agree with what explains the others, the report says so.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use common::{campaign, creeping, dynamic};
use identify::analysis::{Depth, analyse};
use identify::diagnose::Verdict;
use model::Parameters;
use model::effects::find;
use recordings::Role;

#[test]
fn a_validation_that_contradicts_is_said_and_one_that_agrees_is_not() {
    let truth = Parameters::example();
    for (lag_s, contradicts) in [(0.0, false), (0.008, true)] {
        let dir = tempfile::tempdir().unwrap();
        let lag = (lag_s > 0.0).then(|| (find("pump_lag").unwrap(), vec![lag_s]));
        let runs = [
            ("a.csv", Role::Identify, dynamic(&truth, None, 20.0, 31)),
            ("b.csv", Role::Identify, dynamic(&truth, None, 20.0, 32)),
            ("c.csv", Role::Validate, dynamic(&truth, lag, 15.0, 33)),
        ];
        let loaded = campaign(dir.path(), &runs);
        let analysis = analyse(&loaded, Depth::Diagnosis, &|_| ()).unwrap();
        assert_eq!(analysis.diagnosis.as_ref().unwrap().verdict, Verdict::None);
        let said = analysis.headline.iter().find(|line| line.contains("validation contradicts"));
        assert_eq!(said.is_some(), contradicts, "{:?}", analysis.headline);
        assert!(said.is_none_or(|line| line.contains("c.csv") && line.contains("role identify")), "{said:?}");
    }
}

#[test]
fn noise_that_creeps_excuses_no_validation_that_is_off_by_far_more() {
    let truth = Parameters::example();
    let lag = Some((find("pump_lag").unwrap(), vec![0.03]));
    let dir = tempfile::tempdir().unwrap();
    let runs = [
        ("a.csv", Role::Identify, creeping(dynamic(&truth, None, 20.0, 31), 31)),
        ("b.csv", Role::Identify, creeping(dynamic(&truth, None, 20.0, 32), 32)),
        ("c.csv", Role::Validate, dynamic(&truth, lag, 15.0, 33)),
    ];
    let analysis = analyse(&campaign(dir.path(), &runs), Depth::Diagnosis, &|_| ()).unwrap();
    let found = analysis.diagnosis.as_ref().unwrap();
    assert!(found.verdict == Verdict::None && found.silent, "{:?}", found.verdict);
    let says = |what: &str| analysis.headline.iter().any(|line| line.contains(what));
    assert!(says("noise that creeps, most likely") && says("validation contradicts"), "{:?}", analysis.headline);
}
