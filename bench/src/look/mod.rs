//! What recordings hold, for people: `bench info` and `bench ls`.

pub mod curve;
pub mod listing;
pub mod page;
pub mod plot;
pub mod summary;
pub mod words;
