//! Fault injection: what each kind does at the boundary, that it ends and is told, and what the loop makes of it.
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../counting/mod.rs"]
mod counting;

mod all_kinds;
mod each_kind;
mod loop_with_faults;
mod played;
