//! The model in free run beside a recorded run.

use model::effects::{self, EffectSet};
use model::integrate::{Integrator, SimulationError};
use model::parameters::AddedEffect;
use model::rec::{self, Circuit, Input, Lever, STATES, state};
use model::{ModelFile, effects::Effect};
use recordings::{Plane, Recording};

/// Longest inner step, s. The shortest time constant is that of the losses near zero velocity, 1..2 ms.
const INNER_STEP_S: f64 = 0.25e-3;

/// Why a run could not be simulated.
#[derive(Debug, thiserror::Error)]
pub enum FreeRunError {
    /// The first sample is no state.
    #[error("row 1, {column}: expected a value, because the simulation starts from the first sample, got none")]
    Start {
        /// The empty column.
        column: &'static str,
    },
    /// An effect that the library does not have.
    #[error("effect {id:?}: expected an effect of the library, got an unknown id; known are {known}")]
    UnknownEffect {
        /// What the model file says.
        id: String,
        /// All ids.
        known: String,
    },
    /// A parameter of an effect is missing.
    #[error("effect {id:?}: expected its parameter {parameter:?}, got none; its parameters are {all}")]
    MissingParameter {
        /// The effect.
        id: String,
        /// The parameter.
        parameter: &'static str,
        /// All of the effect's, with their units.
        all: String,
    },
    /// A parameter that the effect does not have, which would do nothing.
    #[error("effect {id:?}: expected its parameters {all}, got {parameter:?} as well")]
    UnknownParameter {
        /// The effect.
        id: String,
        /// The parameter.
        parameter: String,
        /// All of the effect's, with their units.
        all: String,
    },
    /// The model left the range in which it holds.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
}

/// The effects of `model.toml` with their parameters.
pub fn added_effects(model: &ModelFile) -> Result<EffectSet<f64>, FreeRunError> {
    Ok(EffectSet::new(STATES, effects_of(model)?))
}

/// An effect with values in the order of its header.
pub type Valued = (&'static dyn Effect, Vec<f64>);

/// An effect of a model file in the form to which its parameters belong.
pub fn valued(added: &AddedEffect) -> Result<Valued, FreeRunError> {
    let id = || added.id.clone();
    let effect = effects::find_form(&added.id, |name| added.parameters.contains_key(name)).ok_or_else(|| {
        let known = effects::LIBRARY.iter().map(|e| e.header().id).collect::<Vec<_>>().join(", ");
        FreeRunError::UnknownEffect { id: id(), known }
    })?;
    let parameters = effect.header().parameters;
    let all = || parameters.iter().map(|p| format!("{} ({})", p.name, p.unit)).collect::<Vec<_>>().join(", ");
    if let Some(parameter) = added.parameters.keys().find(|name| parameters.iter().all(|p| p.name != *name)) {
        return Err(FreeRunError::UnknownParameter { id: id(), parameter: parameter.clone(), all: all() });
    }
    // a file of before a general form got a parameter holds the form without it
    let neutral = |at: usize| {
        let plain = effects::find(&added.id)?;
        let own = at.checked_sub(plain.header().parameters.len())?;
        plain.refined().map(|form| form.neutral[own])
    };
    let values = parameters.iter().enumerate().map(|(at, p)| {
        let missing = || FreeRunError::MissingParameter { id: id(), parameter: p.name, all: all() };
        added.parameters.get(p.name).copied().or_else(|| neutral(at)).ok_or_else(missing)
    });
    Ok((effect, values.collect::<Result<_, _>>()?))
}

/// Those of a model file, one by one.
pub fn effects_of(model: &ModelFile) -> Result<Vec<Valued>, FreeRunError> {
    model.effect.iter().map(valued).collect()
}

/// Simulates the free lever from the run's first sample, at rest, with the run's voltage and valves. Angle and pressures of
/// the result are what the model's sensors would show at the run's times; torque and volume are empty.
pub fn free_run(
    model: &ModelFile,
    effects: &EffectSet<f64>,
    run: &Recording,
    plane: Plane,
) -> Result<Recording, FreeRunError> {
    let k = model.parameters.to_vector();
    let first = |column, values: &[f64]| {
        values.first().copied().filter(|v| v.is_finite()).ok_or(FreeRunError::Start { column })
    };
    let mut x = vec![0.0; STATES + effects.states];
    x[state::ANGLE] = first("angle_deg", &run.angle_deg)?.to_radians();
    x[state::PRESSURE1] = first("pressure1_bar", &run.pressure1_bar)?;
    x[state::PRESSURE2] = first("pressure2_bar", &run.pressure2_bar)?;
    let input = |i: usize| Input {
        voltage_v: run.voltage_v[i],
        brake_open: run.brake_open[i],
        bypass_open: run.bypass_open[i],
        vertical: plane == Plane::Vertical,
        lever: Lever::Free,
        circuit: Circuit::Pump,
    };
    rec::rest_states(&input(0), &k, effects, &mut x);

    let rows = run.len();
    let mut out = Recording {
        angle_deg: Vec::with_capacity(rows),
        pressure1_bar: Vec::with_capacity(rows),
        pressure2_bar: Vec::with_capacity(rows),
        torque_nm: vec![f64::NAN; rows],
        volume_ml: vec![f64::NAN; rows],
        ..run.clone()
    };
    let integrator = Integrator::new(INNER_STEP_S);
    let mut scratch = vec![0.0; x.len()];
    for i in 0..rows {
        let now = run.time_s[i];
        let [angle_deg, pressure1_bar, pressure2_bar] = rec::shown(effects, now, &x, &mut scratch);
        out.angle_deg.push(angle_deg);
        out.pressure1_bar.push(pressure1_bar);
        out.pressure2_bar.push(pressure2_bar);
        if i + 1 < rows {
            integrator.advance(&input(i), &k, effects, now, run.time_s[i + 1] - now, &mut x)?;
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::Parameters;

    fn with_contact(parameters: &[(&str, f64)]) -> ModelFile {
        let mut file = ModelFile::plain(Parameters::example());
        let parameters = parameters.iter().map(|(name, value)| (name.to_string(), *value)).collect();
        file.effect.push(AddedEffect { id: "end_stop".into(), parameters });
        file
    }

    #[test]
    fn further_parameters_make_it_the_general_form() {
        let form = |parameters: &[(&str, f64)]| effects_of(&with_contact(parameters)).map(|mut all| all.remove(0));
        let (plain, values) = form(&[("k1", 10.0), ("k2", 12.0), ("phi_c", 30.0)]).expect("the library's form");
        assert_eq!((plain.header().parameters.len(), &values[..]), (3, &[10.0, 12.0, 30.0][..]));
        let (general, values) =
            form(&[("n", 1.5), ("e", 0.0), ("c", 0.0), ("b", 0.02), ("k1", 10.0), ("k2", 12.0), ("phi_c", 30.0)])
                .expect("the general form");
        assert_eq!((general.header().id, &values[..]), ("end_stop", &[10.0, 12.0, 30.0, 1.5, 0.0, 0.0, 0.02][..]));
        let (older, values) = form(&[("n", 1.5), ("k1", 10.0), ("k2", 12.0), ("phi_c", 30.0)]).expect("before b");
        assert_eq!((older.header().parameters.len(), &values[..]), (7, &[10.0, 12.0, 30.0, 1.5, 0.0, 0.0, 0.02][..]));
        let error = form(&[("n", 1.5), ("k1", 10.0), ("k2", 10.0)]).expect_err("an angle is missing").to_string();
        assert!(error.contains("\"phi_c\"") && error.contains("n (1)"), "{error}");
        let error = form(&[("N", 1.5), ("k1", 10.0), ("k2", 10.0), ("phi_c", 30.0)])
            .expect_err("no such parameter")
            .to_string();
        assert!(error.contains("got \"N\" as well"), "{error}");
    }
}
