//! The monitor in a terminal: it subscribes to a running instance, takes what it gets, and shows it. The loop neither knows nor waits.
//!
//! | module | what |
//! |---|---|
//! | [`state`] | what was heard so far: run, newest sample, samples that were missed |
//! | [`history`] | the last minute of every quantity, lowest and highest value kept |
//! | [`timing`] | lateness and work of the last ticks |
//! | [`happenings`] | what happened, read off the samples' flags |
//! | [`description`] | what the service says of its run: name, steps in words, limits |
//! | [`view`] | the picture, from the state alone |
//! | [`snapshot`] | the state as JSON, for scripts |
//! | [`listener`] | samples and announcements from shared memory into the state |
//! | [`screen`] | the terminal: drawn, resized, given back |

pub mod description;
pub mod happenings;
pub mod history;
pub mod listener;
pub mod screen;
pub mod snapshot;
pub mod state;
pub mod timing;
pub mod view;
