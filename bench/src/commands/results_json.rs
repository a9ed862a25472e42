//! What `identify --json` and `diagnose --json` print.

use super::results::Results;
use crate::failure::{Failure, Kind};
use identify::analysis::Analysis;
use serde_json::{Map, Value, json};

/// The results as one object: those of a diagnosis have every field of `findings.json`.
///
/// # Errors
/// A value that JSON does not know, which is a defect (1).
pub(super) fn as_json(results: &Results) -> Result<Value, Failure> {
    let Results { analysis, written, .. } = results;
    let mut object = match &analysis.findings {
        Some(findings) => match serde_json::to_value(findings).map_err(|e| Failure::of(Kind::Internal, &e))? {
            Value::Object(object) => object,
            _ => Map::new(),
        },
        None => identification(analysis),
    };
    let files: Vec<String> = written.iter().map(|file| file.display().to_string()).collect();
    object.insert("summary".to_owned(), json!(analysis.headline));
    object.insert("parameters".to_owned(), parameters(analysis));
    object.insert("written".to_owned(), json!(files));
    Ok(Value::Object(object))
}

/// What an identification without a diagnosis has.
fn identification(analysis: &Analysis) -> Map<String, Value> {
    let compared = analysis.validation.iter().flat_map(|run| {
        run.compared().into_iter().map(|c| {
            json!({
                "run": run.prepared.file,
                "channel": c.before.channel.column(),
                "rmse": c.before.rmse,
                "noise_floor": c.noise_floor,
            })
        })
    });
    let fields = [
        ("format", json!(1)),
        ("campaign", json!(analysis.campaign)),
        ("verdict", Value::Null),
        ("validation", compared.collect()),
    ];
    fields.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// Each parameter of the model with its standard error; `null` where the data do not determine it.
fn parameters(analysis: &Analysis) -> Value {
    let values = model::parameters::NAMES.into_iter().zip(analysis.model.parameters.to_vector());
    let of =
        |(name, value): (&str, f64)| (name.to_owned(), json!({"value": value, "std": analysis.model.std.get(name)}));
    Value::Object(values.map(of).collect())
}
