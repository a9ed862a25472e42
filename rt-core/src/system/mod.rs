//! What the operating system gives the loop: time, priority, memory.

pub mod time;
