//! The 1 kHz loop of the bench: it knows no plant, no protocol and no file, only the traits in [`traits`].
//!
//! | module | what |
//! |---|---|
//! | [`cycle`] | the tick as a table of contents, and the run around it |
//! | [`clock`] | where ticks come from |
//! | [`supervisor`] | limits, latched trips, the safe state |
//! | [`statistics`] | what is accounted per run |
//! | [`publish`] | the loop's hand-over and the publication thread |
//! | [`subscribe`] | the other end: samples, gaps, loss certificate |
//! | [`loss`] | gap detection by tick number, without any transport |
//! | [`link`] | names, sizes and errors of the shared-memory services |

pub mod clock;
pub mod cycle;
mod flow;
pub mod link;
pub mod loss;
pub mod publish;
pub mod statistics;
pub mod subscribe;
pub mod supervisor;
pub mod traits;
pub mod types;

pub use clock::{Clock, Lockstep, Wake};
pub use cycle::{LoopError, Stages, run};
pub use link::LinkError;
pub use loss::{LossCertificate, LossTracker, OutOfOrder};
pub use publish::{Handover, Pace, Publication, Publish, Settled};
pub use statistics::{Ended, RunReport, Statistics};
pub use subscribe::{Delivery, SampleSubscriber};
pub use supervisor::{Breach, Channel, Limits, LimitsError, Supervisor, Trip};
pub use traits::{Controller, Device, DeviceError, Reference, Step, Target};
pub use types::{Command, Fixture, Measurement, PERIOD_NS, SAMPLE_VERSION, Sample, Tick, flags};
