//! Validation in free run, the model file, the findings and the whole analysis, on campaigns that the model itself made.

#![allow(clippy::unwrap_used, reason = "a test may end where something is not as expected")]

mod common;

use std::path::Path;

use common::{ANGLE_NOISE_DEG, PRESSURE_NOISE_BAR, campaign, dynamic, layout, problem};
use identify::analysis::{Analysis, Depth, analyse, analyse_as, conclude};
use identify::diagnose::{Added, Diagnosis, Ranked, Verdict};
use identify::findings::{Candidate, Findings, ranking};
use identify::fit::Fit;
use identify::identification::{Characteristics, Identified, Loaded};
use identify::layout::Layout;
use identify::model_file::model_file;
use identify::predict::predict_rows;
use identify::prepare::Channel;
use identify::problem::Point;
use identify::torque_form::TorqueForm;
use identify::uncertainty::Uncertainty;
use identify::validate::{ValidatedRun, prepare_validation, validate};
use model::effects::empirical::EMPIRICAL;
use model::effects::{Balance, find};
use model::parameters::{NAMES, index};
use model::{ModelFile, Parameters};
use recordings::Role;

fn fit_at(truth: &Parameters, effects: &[(&str, &[f64])]) -> Fit {
    let mut layout = Layout::base(truth);
    let mut theta = layout.vector_of(truth);
    for (id, values) in effects {
        layout = layout.with(find(id).unwrap());
        theta.extend_from_slice(values);
    }
    Fit { layout, point: Point { theta, initial: Vec::new() }, cost: 1.0, converged: true }
}

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
    for word in ["moved.csv", "pressure", "left out"] {
        assert!(failure.contains(word), "{failure}");
    }
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

fn diagnosis(verdict: Verdict, after: &Fit) -> Diagnosis {
    Diagnosis {
        verdict,
        effects: Vec::new(),
        ranking: Vec::new(),
        balances: Balance::ALL.into_iter().map(|b| (b, 0.0005)).collect(),
        after: after.clone(),
        parts_before: Vec::new(),
        parts_after: Vec::new(),
        explained: 1.0,
        next_experiment: None,
    }
}

fn added(id: &str, values: &[f64], std: &[f64]) -> Added {
    let effect = find(id).or_else(|| EMPIRICAL.iter().copied().find(|e| e.header().id == id)).unwrap();
    Added { effect, probability: 0.98, equivalent: Vec::new(), values: values.to_vec(), std: std.to_vec() }
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

fn check_report(analysis: &Analysis) {
    let mut ids: Vec<&str> = analysis.figures.iter().map(|f| f.id.as_str()).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), analysis.figures.len(), "every figure has an anchor of its own");
    for f in &analysis.figures {
        assert!(f.series.iter().all(|s| s.x.len() == s.y.len()), "{}", f.id);
        assert!(f.series.iter().any(|s| s.y.iter().any(|v| v.is_finite())), "{} shows nothing", f.id);
    }
    for t in &analysis.tables {
        assert!(t.rows.iter().all(|r| r.len() == t.columns.len()), "{}: {:?}", t.title, t.rows);
    }
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

/// A campaign with a pump lag as it stands after a diagnosis with this verdict.
fn diagnosed(dir: &Path, verdict: Verdict, id: &str, values: &[f64]) -> Analysis {
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
    let analysis = diagnosed(dir.path(), Verdict::Attributed, "pump_lag", &[0.012]);
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
    let analysis = diagnosed(dir.path(), Verdict::Unrecognised, "empirical_pump", &vec![0.02; terms]);
    check_report(&analysis);
    assert!(analysis.model.effect.is_empty());
    let truth = Parameters::example();
    assert_eq!(
        analysis.model.parameters.torque, truth.torque,
        "without its terms only the reference model stands for itself"
    );
    assert_eq!(analysis.findings.as_ref().unwrap().effects[0].id, "unrecognised");
    let curve = analysis.figures.iter().flat_map(|f| &f.series).find(|s| s.name == "empirical_pump adds");
    assert!(curve.is_some_and(|s| s.y.iter().any(|v| v.abs() > 1e-3)), "the term is shown as a curve");
}

#[test]
fn candidates_that_can_t_be_told_apart_are_claimed_nowhere() {
    let dir = tempfile::tempdir().unwrap();
    let analysis = diagnosed(dir.path(), Verdict::Ambiguous, "pump_lag", &[0.012]);
    check_report(&analysis);
    assert!(analysis.model.effect.is_empty() && analysis.findings.as_ref().unwrap().effects.is_empty());
    assert!(analysis.headline[0].contains("can't tell"));
}
