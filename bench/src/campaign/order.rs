//! The order of a campaign by need: a flow needs the pump's map, a pressure or an angle an identified model.

use profiles::{Need, Protocol, Role, Script};

/// The paper's experiments from which together a model is identified that serves targets of pressure and angle: each
/// determines a part of it that the others do not, or not well. Runs of other protocols with role identify are used too where they
/// are recorded already.
pub const MODEL_FROM: [Protocol; 5] =
    [Protocol::TorqueMap, Protocol::VolumeMap, Protocol::PumpMap, Protocol::ClampSteps, Protocol::ConstantFlow];

/// What matters of a script for the order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Experiment {
    /// Name of the run.
    pub name: String,
    /// What it measures.
    pub protocol: Protocol,
    /// Only runs with role identify may be fitted.
    pub role: Role,
    /// What it needs of the runs before it.
    pub need: Need,
}

impl From<&Script> for Experiment {
    fn from(script: &Script) -> Self {
        let Script { name, protocol, role, .. } = script;
        Experiment { name: name.clone(), protocol: *protocol, role: *role, need: script.need() }
    }
}

/// A need that nothing serves.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name}: {}", explain(*need, missing))]
pub struct Unserved {
    /// The run that can't be served.
    pub name: String,
    /// What it needs.
    pub need: Need,
    /// Protocols, with role identify, that would serve it and are not among the runs that can begin before it. Never empty.
    pub missing: Vec<Protocol>,
}

fn explain(need: Need, missing: &[Protocol]) -> String {
    let list = |word: fn(&Protocol) -> String| missing.iter().map(word).collect::<Vec<_>>().join(", ");
    let protocols = list(|p| p.as_str().to_owned());
    let profiles = list(|p| p.as_str().replace('-', "_"));
    let (targets, wanted) = match need {
        Need::Nothing => ("voltages", "nothing"),
        Need::Pump => ("flows", "the pump's characteristic"),
        Need::Model => ("pressures or angles", "an identified model"),
    };
    format!(
        "asks for {targets}, expected {wanted} from an earlier run or from the rig file, got neither: no run of protocol \
         {protocols} with role \"identify\", that does not wait for this itself, is in the list; add profiles such as \
         {profiles} to the campaign, or name a model in the rig file ([controller] model)"
    )
}

/// What these runs together let a later one ask for.
pub fn gives<'a>(recorded: impl Iterator<Item = &'a Experiment> + Clone) -> Need {
    let measured = |protocol| recorded.clone().any(|run| run.role == Role::Identify && run.protocol == protocol);
    if MODEL_FROM.into_iter().all(measured) {
        Need::Model
    } else if measured(Protocol::PumpMap) {
        Need::Pump
    } else {
        Need::Nothing
    }
}

/// The order in which each run finds what it needs in the runs before it. `given`: what the rig file serves already. Whenever
/// a run can begin, the earliest of the list that can does: a list that is in a possible order stays as it is.
///
/// # Errors
/// The first run whose need nothing serves.
pub fn order(experiments: &[Experiment], given: Need) -> Result<Vec<usize>, Unserved> {
    let mut ordered = Vec::with_capacity(experiments.len());
    let mut left: Vec<usize> = (0..experiments.len()).collect();
    while !left.is_empty() {
        let known = gives(ordered.iter().map(|&i: &usize| &experiments[i])).max(given);
        let Some(at) = left.iter().position(|&i| experiments[i].need <= known) else {
            let Experiment { name, need, .. } = &experiments[left[0]];
            return Err(Unserved { name: name.clone(), need: *need, missing: missing(experiments, *need, given) });
        };
        ordered.push(left.remove(at));
    }
    Ok(ordered)
}

/// Protocols that would serve the need and that no run of the list has with role identify; a run that needs itself what it is to give
/// does not count.
fn missing(experiments: &[Experiment], need: Need, given: Need) -> Vec<Protocol> {
    let wanted: &[Protocol] = match need {
        Need::Nothing => &[],
        Need::Pump => &[Protocol::PumpMap],
        Need::Model => &MODEL_FROM,
    };
    let gives = |protocol| if protocol == Protocol::PumpMap { Need::Pump } else { Need::Model };
    let serves = |run: &Experiment| run.role == Role::Identify && (run.need < gives(run.protocol) || run.need <= given);
    let listed = |protocol| experiments.iter().any(|run| run.protocol == protocol && serves(run));
    wanted.iter().copied().filter(|protocol| !listed(*protocol)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use profiles::BUILTIN;
    use proptest::prelude::*;

    fn experiment() -> impl Strategy<Value = Experiment> {
        let protocol = prop_oneof![
            3 => prop::sample::select(MODEL_FROM.to_vec()),
            1 => prop::sample::select(vec![Protocol::SquareWave, Protocol::RandomSteps]),
        ];
        let role = prop_oneof![4 => Just(Role::Identify), 1 => Just(Role::Validate)];
        let need = prop_oneof![4 => Just(Need::Nothing), 2 => Just(Need::Pump), 1 => Just(Need::Model)];
        (protocol, role, need).prop_map(|(protocol, role, need)| Experiment {
            name: format!("{}_{}", protocol.as_str(), need.as_str()),
            protocol,
            role,
            need,
        })
    }

    fn given() -> impl Strategy<Value = Need> {
        prop_oneof![4 => Just(Need::Nothing), 1 => Just(Need::Pump), 1 => Just(Need::Model)]
    }

    /// Whether each run finds what it needs in those before it, said without the function under test.
    fn possible(runs: &[&Experiment], given: Need) -> bool {
        (0..runs.len()).all(|i| {
            let fitted = |p: Protocol| runs[..i].iter().any(|r| r.protocol == p && r.role == Role::Identify);
            match runs[i].need {
                Need::Nothing => true,
                Need::Pump => given != Need::Nothing || fitted(Protocol::PumpMap),
                Need::Model => given == Need::Model || MODEL_FROM.iter().all(|p| fitted(*p)),
            }
        })
    }

    fn permutations(n: usize) -> Vec<Vec<usize>> {
        if n == 0 {
            return vec![vec![]];
        }
        let shorter = permutations(n - 1);
        shorter.iter().flat_map(|p| (0..n).map(|at| [&p[..at], &[n - 1], &p[at..]].concat())).collect()
    }

    proptest! {
        #[test]
        fn every_run_once_each_after_what_it_needs(list in prop::collection::vec(experiment(), 0..14), given in given()) {
            if let Ok(ordered) = order(&list, given) {
                let mut sorted = ordered.clone();
                sorted.sort_unstable();
                prop_assert_eq!(sorted, (0..list.len()).collect::<Vec<_>>());
                let runs: Vec<&Experiment> = ordered.iter().map(|&i| &list[i]).collect();
                prop_assert!(possible(&runs, given), "{:?}", runs);
            }
        }

        #[test]
        fn a_possible_order_is_left_alone(list in prop::collection::vec(experiment(), 0..14), given in given()) {
            if let Ok(ordered) = order(&list, given) {
                let again: Vec<Experiment> = ordered.iter().map(|&i| list[i].clone()).collect();
                prop_assert_eq!(order(&again, given), Ok((0..list.len()).collect()));
            }
            if possible(&list.iter().collect::<Vec<_>>(), given) {
                prop_assert_eq!(order(&list, given), Ok((0..list.len()).collect()));
            }
        }

        #[test]
        fn a_run_is_overtaken_only_while_it_waits(list in prop::collection::vec(experiment(), 0..14), given in given()) {
            if let Ok(ordered) = order(&list, given) {
                for (at, &later) in ordered.iter().enumerate() {
                    let before: Vec<&Experiment> = ordered[..at].iter().map(|&i| &list[i]).collect();
                    for &waiting in ordered[at..].iter().filter(|&&w| w < later) {
                        let run = [&before[..], &[&list[waiting]]].concat();
                        prop_assert!(!possible(&run, given), "{} could have gone before {}", waiting, later);
                    }
                }
            }
        }

        #[test]
        fn a_list_is_refused_only_where_no_order_is_possible(list in prop::collection::vec(experiment(), 0..6), given in given()) {
            let any = permutations(list.len())
                .into_iter()
                .any(|p| possible(&p.iter().map(|&i| &list[i]).collect::<Vec<_>>(), given));
            let ordered = order(&list, given);
            prop_assert_eq!(any, ordered.is_ok());
            if let Err(unserved) = ordered {
                // The remedy works: with the missing runs, which need nothing, the list has an order.
                let added = unserved.missing.iter().map(|protocol| Experiment {
                    name: "added".to_owned(), protocol: *protocol, role: Role::Identify, need: Need::Nothing,
                });
                prop_assert!(!unserved.missing.is_empty());
                let completed: Vec<Experiment> = list.iter().cloned().chain(added).collect();
                let still = order(&completed, given).err().map(|u| u.name);
                prop_assert!(still != Some(unserved.name), "{:?}", completed);
            }
        }
    }

    #[test]
    fn the_built_in_experiments_are_in_a_possible_order_and_find_it_from_any_other() {
        let scripts: Vec<Script> =
            BUILTIN.iter().map(|(file, text)| Script::parse(text, file).expect("built in")).collect();
        let list: Vec<Experiment> = scripts.iter().map(Experiment::from).collect();
        assert_eq!(order(&list, Need::Nothing), Ok((0..list.len()).collect()));
        let backwards: Vec<Experiment> = list.iter().rev().cloned().collect();
        let names: Vec<&str> = order(&backwards, Need::Nothing)
            .expect("the pump map is there")
            .into_iter()
            .map(|i| backwards[i].name.as_str())
            .collect();
        let place = |name: &str| names.iter().position(|n| *n == name);
        assert!(place("pump_map") < place("constant_flow"), "{names:?}");
        assert_eq!(names.first(), Some(&"random_b"), "what needs nothing stays where it was put: {names:?}");
    }

    #[test]
    fn an_impossible_need_is_named_with_the_remedy() {
        let flow = Experiment {
            name: "strokes".into(),
            protocol: Protocol::ConstantFlow,
            role: Role::Identify,
            need: Need::Pump,
        };
        let unserved = order(std::slice::from_ref(&flow), Need::Nothing).expect_err("nobody measures the pump");
        let text = unserved.to_string();
        for part in ["strokes", "flows", "pump-map", "pump_map", "[controller] model"] {
            assert!(text.contains(part), "{text}");
        }
        assert_eq!(order(&[flow], Need::Pump), Ok(vec![0]));
    }
}
