//! Identification, free-run validation and diagnosis, offline, from recordings.
pub mod figure;
