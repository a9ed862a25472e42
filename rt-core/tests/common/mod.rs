//! What the tests of the loop share. Each test binary uses a part of it.
#![allow(dead_code, reason = "each test binary uses a part of it")]
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

pub mod logger;
pub mod world;
