//! Plant equations of the REC actuator, generic over the scalar type; parameters; the library of effects; integration.
mod characteristics;
pub mod effects;
pub mod integrate;
mod near;
pub mod parameters;
pub mod port;
pub mod rec;
pub mod scalar;
mod seeds;
mod sensitivity;
mod step;

pub use parameters::{ModelFile, Parameters};
