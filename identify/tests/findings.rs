//! What the findings, the model file and the report say of a diagnosis, by verdict.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use std::path::Path;

use common::{campaign, check_report, diagnosis, dynamic, fit_at, layout, problem};
use identify::analysis::{Analysis, conclude};
use identify::diagnose::{Added, Ranked, Verdict};
use identify::findings::{Candidate, Findings, ranking};
use identify::fit::Fit;
use identify::identification::{Characteristics, Identified};
use identify::misfit::Part;
use identify::prepare::Channel;
use identify::uncertainty::Known;
use identify::validate::{ValidatedRun, prepare_validation};
use model::Parameters;
use model::effects::empirical::EMPIRICAL;
use model::effects::find;
use recordings::Role;

fn added(id: &str, values: &[f64], std: &[f64]) -> Added {
    let effect = find(id).or_else(|| EMPIRICAL.iter().copied().find(|e| e.header().id == id)).unwrap();
    let known = std.iter().map(|&std| Known { std, half_interval: 2.0 * std }).collect();
    Added { effect, probability: 0.98, equivalent: Vec::new(), values: values.to_vec(), known }
}

#[test]
fn findings_have_the_contract_s_keys_in_its_order() {
    let truth = Parameters::example();
    let mut d = diagnosis(Verdict::Attributed, &fit_at(&truth, &[]));
    d.effects = vec![added("cross_leakage", &[0.12, 0.01], &[0.004, f64::INFINITY])];
    d.ranking = vec![Ranked { id: "cross_leakage".into(), probability: 0.98 }];
    let validation: Vec<ValidatedRun> = Vec::new();
    let text = Findings::of("c", &d, &validation).to_json();
    let order = [
        "format",
        "campaign",
        "verdict",
        "effects",
        "id",
        "balance",
        "probability",
        "equivalent",
        "parameters",
        "k",
        "value",
        "std",
        "unit",
        "interval",
        "d",
        "ranking",
        "balances",
        "torque",
        "p_value",
        "flow",
        "pump",
        "sensor",
        "validation",
        "next_experiment",
    ];
    let mut from = 0;
    for key in order {
        let at = text[from..].find(&format!("\"{key}\":")).unwrap_or_else(|| panic!("{key} is not next in {text}"));
        from += at;
    }
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["format"], 1);
    assert_eq!(json["effects"][0]["parameters"]["k"]["unit"], "ml/(s sqrt(bar))");
    assert_eq!(json["effects"][0]["parameters"]["k"]["std"], 0.004);
    let interval = &json["effects"][0]["parameters"]["k"]["interval"];
    let [from, to] = [0, 1].map(|end| interval[end].as_f64().expect("an interval has two ends"));
    assert!((from - 0.112).abs() < 1e-12 && (to - 0.128).abs() < 1e-12, "{interval}");
    assert_eq!(interval.as_array().map(Vec::len), Some(2));
    let shape = json["effects"][0]["parameters"]["d"]["std"].as_f64().expect("no null where a number belongs");
    assert!(shape.is_finite() && shape > 0.0);
    assert!(json["next_experiment"].is_null());
    assert_eq!(text.matches("null").count(), 1, "{text}");
    assert_eq!(text, Findings::of("c", &d, &validation).to_json());
}

#[test]
fn what_the_data_do_not_ask_for_is_no_finding() {
    let truth = Parameters::example();
    let values = [0.3, 0.0];
    let mut after = fit_at(&truth, &[("tilt", &values)]);
    after.layout.held.insert(after.layout.first_of(0) + 1);
    let mut d = diagnosis(Verdict::Attributed, &after);
    d.effects = vec![added("tilt", &values, &[0.01, f64::INFINITY])];
    let findings = Findings::of("c", &d, &[]);
    let names: Vec<&str> = findings.effects[0].parameters.0.iter().map(|p| p.0).collect();
    assert_eq!(names, [find("tilt").unwrap().header().parameters[0].name]);
}

#[test]
fn each_verdict_lists_what_it_may() {
    let truth = Parameters::example();
    let fit = fit_at(&truth, &[]);
    let verdict = |verdict, effects: Vec<Added>| {
        let mut d = diagnosis(verdict, &fit);
        d.effects = effects;
        d.next_experiment = (verdict == Verdict::Ambiguous).then(|| "a vertical run".to_string());
        serde_json::from_str::<serde_json::Value>(&Findings::of("c", &d, &[]).to_json()).unwrap()
    };
    let none = verdict(Verdict::None, Vec::new());
    assert_eq!((&none["verdict"], none["effects"].as_array().unwrap().len()), (&"none".into(), 0));
    let ambiguous = verdict(Verdict::Ambiguous, vec![added("pump_lag", &[0.01], &[0.001])]);
    assert_eq!(ambiguous["effects"].as_array().unwrap().len(), 0, "nothing is claimed");
    assert_eq!(ambiguous["next_experiment"], "a vertical run");
    let terms = EMPIRICAL[1].header().parameters.len();
    let unknown =
        verdict(Verdict::Unrecognised, vec![added("empirical_flow", &vec![0.01; terms], &vec![0.001; terms])]);
    assert_eq!(unknown["effects"][0]["id"], "unrecognised");
    assert_eq!(unknown["effects"][0]["balance"], "flow");
    assert_eq!(unknown["effects"][0]["parameters"].as_object().unwrap().len(), terms);
}

#[test]
fn a_set_s_probability_counts_for_each_of_its_members() {
    let set = |id: &str, probability| Ranked { id: id.into(), probability };
    let found = ranking(&[set("tilt+pump_lag", 0.6), set("tilt", 0.3), set("backlash", 0.1)]);
    let ids: Vec<&str> = found.iter().map(|c| c.id.as_str()).collect();
    assert_eq!(ids, ["tilt", "pump_lag", "backlash"]);
    assert!((found[0].probability - 0.9).abs() < 1e-12);
    assert_eq!(ranking(&[set("tilt", f64::NAN)]), [Candidate { id: "tilt".into(), probability: 0.0 }]);
}

/// A campaign with a pump lag as it stands after a diagnosis with this verdict that leaves this.
fn diagnosed(dir: &Path, verdict: Verdict, id: &str, values: &[f64], left: &[Part]) -> Analysis {
    with_left(dir, verdict, id, values, (left, false))
}

/// [`diagnosed`], where the library's score test may have said nothing of what is left.
fn with_left(dir: &Path, verdict: Verdict, id: &str, values: &[f64], (left, silent): (&[Part], bool)) -> Analysis {
    let truth = Parameters::example();
    let lag = Some((find("pump_lag").unwrap(), vec![0.012]));
    let fitted = dynamic(&truth, lag.clone(), 10.0, 1);
    let runs = [("a.csv", Role::Identify, fitted.clone()), ("b.csv", Role::Validate, dynamic(&truth, lag, 10.0, 2))];
    let loaded = campaign(dir, &runs);
    let problem = problem(&[fitted]);
    let layout = layout(&truth);
    let point = problem.point(layout.vector_of(&truth));
    let fit = Fit { cost: problem.cost(&layout, &point), layout: layout.clone(), point, converged: true };
    let found = added(id, values, &vec![1e-3; values.len()]);
    let with = layout.with(found.effect);
    let mut point = fit.point.clone();
    point.theta.extend_from_slice(values);
    let after = Fit { cost: problem.cost(&with, &point), layout: with, point, converged: true };
    let mut d = diagnosis(verdict, &after);
    d.ranking = vec![Ranked { id: id.to_string(), probability: 1.0 }];
    d.effects.push(found);
    d.parts_after = left.to_vec();
    d.silent = silent;
    let identified = Identified {
        problem,
        fit,
        linear: None,
        by_eq2: None,
        undetermined: Default::default(),
        component: truth,
        points: Characteristics::default(),
    };
    conclude(&loaded, prepare_validation(&loaded).unwrap(), identified, Some(d)).unwrap()
}

#[test]
fn an_attributed_effect_is_in_the_model_the_findings_and_the_report() {
    let dir = tempfile::tempdir().unwrap();
    let analysis = diagnosed(dir.path(), Verdict::Attributed, "pump_lag", &[0.012], &[]);
    check_report(&analysis);
    let findings = analysis.findings.as_ref().unwrap();
    assert_eq!(analysis.model.effect.len(), 1);
    assert_eq!(analysis.model.effect[0].parameters["tau"], 0.012);
    assert_eq!(findings.effects[0].parameters.0[0].1.value, 0.012);
    assert_eq!(findings.validation.len(), 3);
    assert!(findings.validation[0].rmse_after < 0.5 * findings.validation[0].rmse_before);
    assert!(analysis.headline[0].contains("pump_lag"));
    let shown = |name: &str| analysis.figures.iter().flat_map(|f| &f.series).any(|s| s.name.contains(name));
    assert!(shown("reference model") && shown("with pump_lag"));

    let out = dir.path().join("analysis");
    assert_eq!(analysis.write(&out).unwrap(), ["model.toml", "report.json", "findings.json"].map(|f| out.join(f)));
    assert_eq!(std::fs::read_to_string(out.join("findings.json")).unwrap(), findings.to_json());
    let error = analysis.write(&out.join("model.toml")).unwrap_err().to_string();
    assert!(error.contains("model.toml") && error.contains("--out"), "{error}");
}

#[test]
fn terms_without_a_name_are_no_part_of_the_model_file_but_are_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let terms = EMPIRICAL[2].header().parameters.len();
    let analysis = diagnosed(dir.path(), Verdict::Unrecognised, "empirical_pump", &vec![0.02; terms], &[]);
    check_report(&analysis);
    assert!(analysis.model.effect.is_empty());
    let truth = Parameters::example();
    assert_eq!(
        analysis.model.parameters.torque, truth.torque,
        "without its terms only the reference model stands for itself"
    );
    assert_eq!(analysis.findings.as_ref().unwrap().effects[0].id, "unrecognised");
    assert!(says_confined(&analysis), "terms that make the validation worse are said to");
    let curve = analysis.figures.iter().flat_map(|f| &f.series).find(|s| s.name == "empirical_pump adds");
    assert!(curve.is_some_and(|s| s.y.iter().any(|v| v.abs() > 1e-3)), "the term is shown as a curve");
}

#[test]
fn terms_without_a_name_that_carry_over_are_not_said_to_be_confined() {
    let dir = tempfile::tempdir().unwrap();
    let terms = EMPIRICAL[2].header().parameters;
    // what the voltage was a moment ago: a pump lag, to first order
    let values: Vec<f64> = terms.iter().map(|p| if p.name == "past_voltage_fast" { 14.0 } else { 0.0 }).collect();
    let analysis = diagnosed(dir.path(), Verdict::Unrecognised, "empirical_pump", &values, &[]);
    let better = analysis.findings.as_ref().unwrap().validation.iter().all(|v| v.rmse_after < v.rmse_before);
    assert!(better && !says_confined(&analysis), "{:?}", analysis.headline);
}

#[test]
fn terms_of_no_size_are_said_to_tell_the_balance_alone() {
    let dir = tempfile::tempdir().unwrap();
    let terms = EMPIRICAL[2].header().parameters.len();
    let said = |size: f64| {
        let dir = dir.path().join(size.to_string());
        std::fs::create_dir(&dir).unwrap();
        let analysis = diagnosed(&dir, Verdict::Unrecognised, "empirical_pump", &vec![size; terms], &[]);
        check_report(&analysis);
        analysis.headline[0].contains("pump balance") && analysis.headline[0].contains("of no size in the model")
    };
    assert!(said(0.0) && !said(0.02));
}

fn says_confined(analysis: &Analysis) -> bool {
    analysis.headline.iter().any(|line| line.contains("do not hold beyond the runs they were fitted to"))
}

#[test]
fn candidates_that_can_t_be_told_apart_are_claimed_nowhere() {
    let dir = tempfile::tempdir().unwrap();
    let analysis = diagnosed(dir.path(), Verdict::Ambiguous, "pump_lag", &[0.012], &[]);
    check_report(&analysis);
    assert!(analysis.model.effect.is_empty() && analysis.findings.as_ref().unwrap().effects.is_empty());
    assert!(analysis.headline[0].contains("can't tell"));
}

#[test]
fn what_a_named_effect_leaves_is_said_where_it_is_more_than_noise() {
    let left = |channel, structured, significance| Part {
        run: 0,
        protocol: None,
        free: true,
        channel,
        structured,
        samples: 1e4,
        significance,
    };
    let said_of = |verdict: Verdict, silent: bool, left: &[Part]| {
        let dir = tempfile::tempdir().unwrap();
        let analysis = with_left(dir.path(), verdict, "pump_lag", &[0.012], (left, silent));
        analysis.headline.iter().find(|line| line.contains("of a.csv")).cloned()
    };
    let said = |left: &[Part]| said_of(Verdict::Attributed, false, left);
    let (small, noise) = (left(Channel::Angle, 0.04, 50.0), left(Channel::Pressure1, 9.0, 4.0));
    assert_eq!(said(&[small.clone(), noise.clone()]), None);
    let all = [small, noise, left(Channel::Pressure2, 2.25, 6.0)];
    for verdict in [Verdict::Attributed, Verdict::None] {
        for (silent, expected) in [(false, "Not all is explained"), (true, "noise that creeps")] {
            let line = said_of(verdict, silent, &all).unwrap();
            assert!(line.contains(expected) && line.contains("pressure2_bar of a.csv"), "{line}");
            assert!(line.contains("1.50 noise floors"), "{line}");
            assert_eq!(said_of(verdict, silent, &all[..2]), None);
        }
    }
}
