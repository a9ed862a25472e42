//! Validation in free run, the model file and the whole analysis, on campaigns that the model itself made.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use std::path::Path;

use common::{
    ANGLE_NOISE_DEG, PRESSURE_NOISE_BAR, campaign, check_report, diagnosis, dynamic, fit_at, layout, problem,
};
use identify::analysis::{Analysis, Depth, analyse, analyse_as, analyse_from};
use identify::declared::Declared;
use identify::diagnose::Verdict;
use identify::findings::Findings;
use identify::fit::Fit;
use identify::identification::{Characteristics, Identified, Loaded};
use identify::layout::Layout;
use identify::model_file::model_file;
use identify::predict::predict_rows;
use identify::prepare::Channel;
use identify::torque_form::TorqueForm;
use identify::uncertainty::Uncertainty;
use identify::validate::{prepare_validation, validate};
use model::effects::find;
use model::parameters::{NAMES, index};
use model::{ModelFile, Parameters};
use recordings::Role;

#[test]
fn the_true_model_s_error_is_the_noise_and_the_floor_says_so() {
    let truth = Parameters::example();
    let lag: (&str, &[f64]) = ("pump_lag", &[0.008]);
    let effect = Some((find(lag.0).unwrap(), lag.1.to_vec()));
    let dir = tempfile::tempdir().unwrap();
    let mut gappy = dynamic(&truth, effect, 30.0, 2);
    (3000..3400).for_each(|i| gappy.angle_deg[i] = f64::NAN);
    let fitted = dynamic(&truth, None, 3.0, 1);
    let loaded = campaign(dir.path(), &[("a.csv", Role::Identify, fitted), ("b.csv.gz", Role::Validate, gappy)]);
    let runs = prepare_validation(&loaded).unwrap();
    let found = validate(&loaded, runs, &fit_at(&truth, &[]), Some(&fit_at(&truth, &[lag])));
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].failure(), None);
    let compared = found[0].compared();
    let channels: Vec<Channel> = compared.iter().map(|c| c.before.channel).collect();
    assert_eq!(channels, [Channel::Angle, Channel::Pressure1, Channel::Pressure2]);
    for (c, noise) in compared.iter().zip([ANGLE_NOISE_DEG, PRESSURE_NOISE_BAR, PRESSURE_NOISE_BAR]) {
        let after = c.after.unwrap();
        assert!((after.rmse / noise - 1.0).abs() < 0.05, "{c:?}");
        assert!((c.noise_floor / noise - 1.0).abs() < 0.05, "{c:?}");
        assert!(after.largest > 3.0 * noise && after.largest < 6.0 * noise, "{c:?}");
        assert!(after.fit_percent.unwrap() > 90.0, "{c:?}");
        let missing = if after.channel == Channel::Angle { 400 } else { 0 };
        assert_eq!(after.samples, 15_000 - missing);
    }
    assert!(compared[0].before.rmse > 3.0 * ANGLE_NOISE_DEG, "without its lag the model is worse: {compared:?}");
}

#[test]
fn a_run_that_can_t_be_simulated_is_named_and_spoils_no_other() {
    let truth = Parameters::example();
    let dir = tempfile::tempdir().unwrap();
    let mut still = dynamic(&truth, None, 4.0, 3);
    still.voltage_v.fill(0.0);
    let runs = [
        ("a.csv", Role::Identify, dynamic(&truth, None, 4.0, 1)),
        ("moved.csv", Role::Validate, dynamic(&truth, None, 4.0, 2)),
        ("still.csv", Role::Validate, still),
    ];
    let loaded = campaign(dir.path(), &runs);
    let mut violent = truth;
    violent.pump.f1 = 60.0;
    let prepared = prepare_validation(&loaded).unwrap();
    let found = validate(&loaded, prepared, &fit_at(&truth, &[]), Some(&fit_at(&violent, &[])));
    let failure = found[0].failure().expect("a hundredfold pump empties a chamber");
    for word in ["moved.csv", "model with what was added ended", "pressure", "left out", "with the reference model its"]
    {
        assert!(failure.contains(word), "{failure}");
    }
    let other_way =
        validate(&loaded, prepare_validation(&loaded).unwrap(), &fit_at(&violent, &[]), Some(&fit_at(&truth, &[])));
    let failure = other_way[0].failure().unwrap();
    let (_, floors) = failure.split_once("with the model with what was added its largest error is ").expect(&failure);
    let floors: f64 = floors.split_whitespace().next().unwrap().parse().unwrap();
    assert!((0.9..1.1).contains(&floors), "the true model leaves the noise: {failure}");
    assert!(found[0].compared().is_empty());
    assert_eq!(found[1].failure(), None);
    assert_eq!(found[1].compared().len(), 3);
    let findings = Findings::of("c", &diagnosis(Verdict::None, &fit_at(&truth, &[])), &found);
    assert!(findings.validation.iter().all(|v| v.run == "still.csv"));
}

#[test]
fn without_a_run_to_validate_nothing_is_computed() {
    let truth = Parameters::example();
    let dir = tempfile::tempdir().unwrap();
    let loaded = campaign(dir.path(), &[("a.csv", Role::Identify, dynamic(&truth, None, 3.0, 1))]);
    let error =
        analyse(&loaded, Depth::Diagnosis, &|text| panic!("{text} before the check")).err().unwrap().to_string();
    for word in ["campaign.toml", "role = \"validate\"", "got none of 1", "add a run"] {
        assert!(error.contains(word), "{word} is missing in: {error}");
    }
}

#[test]
fn the_model_file_simulates_the_same_bit_for_bit() {
    let truth = Parameters::example();
    let run = dynamic(&truth, None, 6.0, 7);
    let dir = tempfile::tempdir().unwrap();
    let loaded = campaign(dir.path(), &[("a.csv", Role::Identify, run.clone())]);
    let layout = layout(&truth).with(find("pump_lag").unwrap());
    let mut theta: Vec<f64> = layout.vector_of(&truth).iter().map(|v| v * (1.0 + 1e-3 / 3.0)).collect();
    theta.push(0.01 / 3.0);
    let problem = problem(&[run]);
    let fit = Fit { point: problem.point(theta), layout, cost: 1.0, converged: true };
    let undetermined = [("h1".to_string(), "it does not show here".to_string())].into();
    let identified = Identified {
        problem,
        fit: fit.clone(),
        linear: None,
        by_eq2: None,
        undetermined,
        component: truth,
        points: Characteristics::default(),
    };
    let uncertainty = Uncertainty::of(&identified.problem, &fit).unwrap();
    let file = model_file(&loaded, &identified, Some(Verdict::Attributed), &fit, &uncertainty);
    let read = ModelFile::parse(&file.to_toml(), "model.toml").unwrap();
    assert_eq!(read, file);

    let again = Layout {
        base: Vec::new(),
        effects: read.effect.iter().map(|e| find(&e.id).unwrap()).collect(),
        fixed: read.parameters.to_vector().to_vec(),
        u_max: read.parameters.pump.u_max,
        ..fit.layout.clone()
    };
    let effect_values = vec![read.effect[0].parameters["tau"]];
    let s = &identified.problem.stretches[0];
    let first = predict_rows(s, &fit.layout, &fit.point.theta, &[0.0; 3]).unwrap();
    let second = predict_rows(s, &again, &effect_values, &[0.0; 3]).unwrap();
    for (a, b) in first.iter().zip(&second) {
        assert_eq!(
            a[..3].iter().map(|v| v.to_bits()).collect::<Vec<_>>(),
            b[..3].iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        );
    }

    // what was free has a standard error, also l4 that follows from it; what was not has none
    assert!(read.std.contains_key("m3") && !read.std.contains_key("h1") && !read.std.contains_key("J"));
    assert!(read.source["not_determined"].contains("h1"));
    assert_eq!(read.source["fitted_runs"], "a.csv");
}

#[test]
fn l4_is_known_as_well_as_the_losses_from_which_it_follows() {
    let truth = Parameters::example();
    let problem = problem(&[dynamic(&truth, None, 12.0, 8)]);
    let mut layout = layout(&truth);
    let fit = |layout: &Layout| {
        let point = problem.point(layout.vector_of(&truth));
        let cost = problem.cost(layout, &point);
        Fit { layout: layout.clone(), point, cost, converged: true }
    };
    let partly = Uncertainty::of(&problem, &fit(&layout)).unwrap();
    assert_eq!(partly.of_parameter(index::L4), None, "l1 is not determined, so l4 is not");
    layout.base.push(index::L1);
    let known = Uncertainty::of(&problem, &fit(&layout)).unwrap();
    let std = known.of_parameter(index::L4).expect("all of l1, l2, l3, a are free");
    assert!(std > 0.0 && std < truth.losses.l4, "{std}");
    assert!(known.determined().iter().any(|(p, name, _)| *p == index::L4 && *name == NAMES[index::L4]));
    // l4 = l1 a + l2 + l3/a: no more uncertain than its parts would be if they all pulled one way
    let l = truth.losses;
    let parts = [(index::L1, l.a), (index::L2, 1.0), (index::L3, 1.0 / l.a), (index::A, l.l1 - l.l3 / (l.a * l.a))];
    let most: f64 = parts.iter().map(|(p, slope)| slope.abs() * known.of_parameter(*p).unwrap()).sum();
    assert!(std < most && std > 0.01 * most, "{std} {most}");
}

fn small_campaign(dir: &Path) -> Loaded {
    let truth = Parameters::example();
    let runs = [
        ("a.csv", Role::Identify, dynamic(&truth, None, 20.0, 11)),
        ("b.csv", Role::Identify, dynamic(&truth, None, 20.0, 12)),
        ("c.csv", Role::Validate, dynamic(&truth, None, 15.0, 13)),
    ];
    campaign(dir, &runs)
}

/// The report for programs says what the tables say, and nothing that is no number.
fn check_twin(analysis: &Analysis, file: &Path) {
    let text = std::fs::read_to_string(file).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["summary"].as_array().unwrap().len(), analysis.headline.len());
    for p in json["parameters"].as_array().unwrap() {
        let name = p["name"].as_str().unwrap();
        let open = analysis.identified.undetermined.contains_key(name);
        assert_eq!(open, !p["why"].is_null(), "{name}");
        if let (Some(std), Some(value)) = (p["std"].as_f64(), p["value"].as_f64()) {
            assert!(!open && std > 0.0, "{name}");
            let (low, high) = (p["interval"][0].as_f64().unwrap(), p["interval"][1].as_f64().unwrap());
            assert!(low < value - 1.95 * std && high > value + 1.95 * std, "{name}: {low} {value} {high}, {std}");
        }
    }
    let names = json["correlation"]["names"].as_array().unwrap();
    for (i, row) in json["correlation"]["matrix"].as_array().unwrap().iter().enumerate() {
        assert_eq!(row.as_array().unwrap().len(), names.len());
        assert!((row[i].as_f64().unwrap() - 1.0).abs() < 1e-9);
    }
    let rank = &json["rank"];
    let open = rank["open"].as_array().unwrap();
    assert_eq!(rank["rank"].as_u64().unwrap() as usize + open.len(), rank["parameters"].as_array().unwrap().len());
    let of_a2 = |d: &serde_json::Value| d.as_array().unwrap().iter().any(|part| part[0] == "a2");
    assert!(open.iter().any(of_a2), "a2 is told from h1 and h3 by no data: {rank}");
    for check in json["checks"].as_array().unwrap() {
        assert!(["holds", "fails", "open"].contains(&check["outcome"].as_str().unwrap()), "{check}");
        assert!(!check["meaning"].as_str().unwrap().is_empty());
    }
    for w in json["residual_analysis"].as_array().unwrap() {
        assert!(w["p_white"].as_f64().unwrap() > 1e-4, "nothing but noise is left: {}", w["channel"]);
    }
}

#[test]
fn the_third_order_of_the_torque_is_found_where_it_acts_and_refused_where_not() {
    for (c1, asked_for) in [(-15.0, true), (0.0, false)] {
        let truth = Parameters::example();
        let effect = (c1 != 0.0).then(|| (find("torque_cubic").unwrap(), vec![c1, 0.0, 0.0]));
        let dir = tempfile::tempdir().unwrap();
        let runs = [
            ("a.csv", Role::Identify, dynamic(&truth, effect.clone(), 20.0, 21)),
            ("b.csv", Role::Identify, dynamic(&truth, effect.clone(), 20.0, 22)),
            ("c.csv", Role::Validate, dynamic(&truth, effect, 12.0, 23)),
        ];
        let loaded = campaign(dir.path(), &runs);
        let analysis = analyse_as(&loaded, Depth::Identification, TorqueForm::ThirdOrder, &|_| ()).unwrap();
        check_report(&analysis);
        let comparison = analysis.report.torque_form.as_ref().expect("it was asked for");
        assert_eq!(comparison.is_asked_for(), asked_for, "{comparison:?}");
        assert_eq!(comparison.validation.len(), 3);
        let said = if asked_for { "the data ask for it" } else { "the data do not ask for it" };
        assert!(analysis.headline.iter().any(|l| l.contains(said)), "{:?}", analysis.headline);
        assert_eq!(analysis.model.effect[0].id, "torque_cubic");
        let (value, std) = comparison.terms[0];
        assert!(((value - c1) / std).abs() < 4.0, "{value} +- {std}, true {c1}");
    }
}

#[test]
fn a_campaign_without_component_experiments_says_what_it_leaves_open() {
    let dir = tempfile::tempdir().unwrap();
    let loaded = small_campaign(dir.path());
    let analysis = analyse(&loaded, Depth::Identification, &|_| ()).unwrap();
    check_report(&analysis);
    assert!(analysis.findings.is_none());
    assert!(!analysis.identified.undetermined.is_empty(), "40 s of motion can't tell all 18 parameters");
    let start = analysis.identified.component.to_vector();
    let values = analysis.model.parameters.to_vector();
    for name in analysis.identified.undetermined.keys() {
        let p = NAMES.iter().position(|n| n == name).unwrap();
        assert!(!analysis.model.std.contains_key(name), "{name} has no standard error");
        assert_eq!(values[p], start[p], "{name} keeps the value it started from");
        assert!(analysis.model.source["not_determined"].contains(name.as_str()));
        assert!(
            analysis.headline.iter().any(|line| line.contains("not determined") && line.starts_with(name.as_str()))
        );
        let row = analysis
            .tables
            .iter()
            .flat_map(|t| &t.rows)
            .find(|r| r[0] == *name && r.contains(&"not determined".into()));
        assert!(row.is_some_and(|r| r.contains(&"-".into())), "{name} is never printed as if known: {row:?}");
    }
    for run in &analysis.validation {
        for c in run.compared() {
            assert!(c.before.rmse < 1.3 * c.noise_floor, "{c:?}");
        }
    }
    let out = dir.path().join("deep/analysis");
    let written = analysis.write(&out).unwrap();
    assert_eq!(written, [out.join("model.toml"), out.join("report.json")]);
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), 2, "nothing half-written stays");
    check_twin(&analysis, &written[1]);
    assert_eq!(ModelFile::read(&written[0]).unwrap(), analysis.model);
    let again = analyse(&loaded, Depth::Identification, &|_| ()).unwrap();
    assert_eq!(again.model.to_toml(), analysis.model.to_toml(), "the same recordings give the same bytes");
}

#[test]
fn declared_effects_are_fitted_with_the_base_model_and_no_longer_found() {
    let truth = Parameters::example();
    let lag = find("pump_lag").unwrap();
    let run = |seed| dynamic(&truth, Some((lag, vec![0.012])), 20.0, seed);
    let dir = tempfile::tempdir().unwrap();
    let runs =
        [("a.csv", Role::Identify, run(41)), ("b.csv", Role::Identify, run(42)), ("c.csv", Role::Validate, run(43))];
    let loaded = campaign(dir.path(), &runs);
    let declared = Declared { parameters: truth, effects: vec![(lag, vec![0.006])] };
    for depth in [Depth::Identification, Depth::Diagnosis] {
        let form = TorqueForm::SecondEquation;
        let analysis = analyse_from(&loaded, depth, form, Some(&declared), &|_| ()).unwrap();
        check_report(&analysis);
        assert_eq!(analysis.model.effect.len(), 1, "{:?}", analysis.headline);
        let tau = analysis.model.effect[0].parameters["tau"];
        assert!((tau - 0.012).abs() < 2e-4, "{tau}");
        for compared in analysis.validation[0].compared() {
            assert!(compared.before.rmse < 1.1 * compared.noise_floor, "{compared:?}");
        }
        assert!(analysis.diagnosis.is_none_or(|d| d.verdict == Verdict::None && d.effects.is_empty()));
    }
}
