//! The options of every command that drives a rig: whose time it runs in.

use crate::runner::Mode;
use rt_core::system::Request;

/// Virtual time unless said otherwise
#[derive(Debug, clap::Args)]
pub struct TimeArgs {
    /// Real time at 1 kHz in a thread of its own; without it virtual time, as fast as it goes
    #[arg(long)]
    pub realtime: bool,
    /// End with exit code 2 when the system refuses anything that real time needs
    #[arg(long, requires = "realtime")]
    require_rt: bool,
    /// Priority of the loop, SCHED_FIFO
    #[arg(long, default_value_t = 80, value_parser = clap::value_parser!(u8).range(2..=98))]
    priority: u8,
    /// Processors for the loop and its publication, such as 3 or 2,3
    #[arg(long, value_delimiter = ',')]
    cpu: Vec<usize>,
}

impl TimeArgs {
    /// What they ask for.
    pub fn mode(&self) -> Mode {
        if !self.realtime {
            return Mode::Lockstep;
        }
        let cpus = (!self.cpu.is_empty()).then(|| self.cpu.clone());
        let request = Request { priority: self.priority, cpus, ..Request::default() };
        Mode::RealTime { request, required: self.require_rt }
    }
}
