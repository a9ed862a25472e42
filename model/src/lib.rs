//! Plant equations of the REC actuator, generic over the scalar type; parameters; the library of effects; integration.
pub mod effects;
pub mod integrate;
pub mod parameters;
pub mod port;
pub mod rec;
pub mod scalar;

pub use parameters::{ModelFile, Parameters};
