//! `bench foxglove [--instance NAME] [--listen ADDRESS:PORT]`

use crate::failure::{Failure, Kind};
use crate::foxglove_bridge::{Bridge, BridgeError};
use crate::interrupt;
use crate::progress::Progress;
use std::net::SocketAddr;

/// Show a run of another process in Foxglove, Lichtblick or PlotJuggler
///
/// A WebSocket server beside any run. It takes what it gets, never holds the run up and takes no orders; whoever reaches the address can
/// watch. Ends on Ctrl-C.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Instance to show
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
    /// Where to listen; port 0: any that is free
    #[arg(long, default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let (switches, _driving) = interrupt::driving()?;
    let mut bridge = Bridge::open(&args.instance, args.listen).map_err(|e| failure_of(&e))?;
    let address = SocketAddr::new(args.listen.ip(), bridge.port());
    progress.result(&format!("listening at ws://{address}: open it as a Foxglove WebSocket connection"));
    if !address.ip().is_loopback() {
        progress.say("not only this machine: whoever reaches this address can watch (nobody can command)");
    }
    progress.say(&format!("waiting for a run of instance {:?}; Ctrl-C ends", args.instance));
    bridge.serve(&switches.stop, &mut |text| progress.say(text)).map_err(|e| failure_of(&e))
}

fn failure_of(error: &BridgeError) -> Failure {
    let kind = match error {
        BridgeError::Link(_) => Kind::Device,
        BridgeError::Listen { .. } => Kind::Input,
        BridgeError::Channel(_) => Kind::Internal,
    };
    Failure::of(kind, error)
}
