//! The 1 kHz loop of the bench: it knows no plant, no protocol and no file, only the traits in [`traits`].
//!
//! | module | what |
//! |---|---|
//! | [`cycle`] | the tick as a table of contents, and the run around it |
//! | [`clock`] | where ticks come from |
//! | [`overrun`] | what follows a missed deadline |
//! | [`supervisor`] | limits, latched trips, the safe state |
//! | [`statistics`] | what is accounted per run |
//! | [`flight`] | the last ticks with their stage times, kept when something happens |
//! | [`fault`] | what may be made to go wrong at a device, as plain data |
//! | [`replay`] | a recorded run in the place of clock, device and people |
//! | [`publish`] | the loop's hand-over and the publication thread |
//! | [`subscribe`] | the other end: samples, gaps, loss certificate |
//! | [`loss`] | gap detection by the samples' numbers, without any transport |
//! | [`system`] | priority, memory and time of the operating system |
//! | [`command_channel`] | stop, emergency stop and confirmations from another process |
//! | [`service_channel`] | the same to the service that starts runs |
//! | [`confirmation`] | what people are asked for, and how their word reaches the loop |
//! | [`announce`] | what a run is, told before its first sample |
//! | [`relay`] | samples that were carried here from another machine |
//! | [`presence`] | whether anybody publishes |
//! | [`transport`] | the folder that the shared-memory services are listed in, and whose it is |
//! | `leftovers` | shared memory that killed processes left half made |
//! | [`link`] | names, sizes and errors of the shared-memory services |

pub mod announce;
pub mod clock;
pub mod command_channel;
pub mod confirmation;
pub mod cycle;
mod exchange;
pub mod fault;
pub mod flight;
mod flow;
mod leftovers;
pub mod link;
pub mod loss;
pub mod overrun;
pub mod presence;
pub mod publish;
pub mod relay;
pub mod replay;
mod rhythm;
mod sender;
pub mod service_channel;
pub mod statistics;
pub mod subscribe;
pub mod supervisor;
pub mod system;
pub mod traits;
pub mod transport;
pub mod types;

pub use clock::{Clock, Lockstep, RealTime, Wake};
pub use command_channel::{Answer, CommandClient, CommandServer, RunCommand, send_command};
pub use confirmation::{Amount, Confirmation, ConfirmationSlot, Refusal, Waiting};
pub use cycle::{LoopError, OpenLoop, Run, Stages, run};
pub use fault::{Fault, FaultKind};
pub use flight::{FlightLog, FlightRecorder, Incident};
pub use link::LinkError;
pub use loss::{LossCertificate, LossTracker, OutOfOrder};
pub use overrun::OverrunPolicy;
pub use publish::{Handover, Pace, Publication, Publish, Settled};
pub use relay::Relay;
pub use service_channel::{ServiceAnswer, ServiceCommand, ServiceServer, ServiceState, send_service_command};
pub use statistics::{Ended, RunReport, Statistics};
pub use subscribe::{Delivery, SampleSubscriber};
pub use supervisor::{Breach, Channel, Limits, LimitsError, Supervisor, Trip};
pub use traits::{
    ControlledPressure, Controller, Demand, Device, DeviceError, Operator, Reference, Step, Switches, Target,
};
pub use types::{
    BeyondRange, Command, Fixture, Input, Measurement, PERIOD_NS, SAMPLE_VERSION, SafeState, Sample, TargetKind, Tick,
    flags,
};
