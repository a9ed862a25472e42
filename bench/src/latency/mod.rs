//! `bench latency`: how late the loop wakes up and how long its parts take, beside a loop that does nothing else.
//!
//! | module | what |
//! |---|---|
//! | [`slices`] | which slices there are, and in which order |
//! | [`real_loop`] | a slice of the real loop |
//! | [`bare`] | a slice of the bare loop, or of cyclictest |
//! | [`subscriber`] | subscribers in processes of their own |
//! | [`measurement`] | one slice after the other |
//! | [`statistics`] | distributions, medians over slices, ratios |
//! | [`output`] | table, histogram in the terminal, JSON |

pub mod bare;
pub mod measurement;
pub mod output;
mod plot;
pub mod real_loop;
pub mod slices;
pub mod statistics;
pub mod subscriber;
