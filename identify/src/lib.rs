//! Identification, free-run validation and diagnosis, offline, from recordings.
pub mod component;
pub mod diagnose;
pub mod figure;
pub mod fit;
pub mod identification;
pub mod layout;
pub mod misfit;
pub mod noise;
pub mod predict;
pub mod prepare;
pub mod problem;
pub mod refit;
pub mod score;
pub mod significance;
