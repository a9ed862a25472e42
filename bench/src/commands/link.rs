//! `bench link serve|connect`

use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::link::{connect, endpoint, serve};
use crate::progress::Progress;
use clap::Subcommand;
use std::net::{IpAddr, ToSocketAddrs};

/// Carry a run's samples, and if wanted commands, to another machine
///
/// `serve` stands on the rig's machine, `connect` on any other: there the run has an instance's name of its own, and `bench record`, `stop`,
/// `confirm` and every other subscriber work as on the rig's machine. Samples that the network does not carry are gaps there; the rig never
/// waits. The link is neither encrypted nor does it ask who is there: across a network that others use, lead it through SSH or
/// WireGuard (docs/NETWORK.md).
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    end: End,
}

#[derive(Debug, Subcommand)]
enum End {
    Serve(ServeArgs),
    Connect(ConnectArgs),
}

/// On the rig's machine: let other machines watch the runs of an instance
#[derive(Debug, clap::Args)]
struct ServeArgs {
    /// Instance to serve
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
    /// Address to listen on, HOST or HOST:PORT; may be repeated
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7447")]
    listen: Vec<String>,
    /// Let commands in: stop, emergency stop, confirm
    #[arg(long)]
    control: bool,
    /// Listen on an address that other machines can reach
    #[arg(long)]
    allow_remote: bool,
}

/// On another machine: make the runs of a rig there an instance here
#[derive(Debug, clap::Args)]
struct ConnectArgs {
    /// Address of the rig's end, HOST or HOST:PORT
    address: String,
    /// Instance over there
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    remote: String,
    /// Instance here
    #[arg(long, default_value = "remote", value_parser = super::instance)]
    instance: String,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let say = |text: &str| progress.say(text);
    match &args.end {
        End::Serve(ServeArgs { instance, listen, control, allow_remote }) => {
            let addresses = listen.iter().map(|a| endpoint(a)).collect::<Result<Vec<_>, _>>()?;
            if !allow_remote {
                addresses.iter().try_for_each(|address| loopback(address))?;
            }
            let settings = serve::Settings { instance: instance.clone(), listen: addresses, control: *control };
            let (switches, _driving) = interrupt::driving()?;
            serve::serve(&settings, &switches.stop, &say)
        }
        End::Connect(ConnectArgs { address, remote, instance }) => {
            let settings =
                connect::Settings { address: endpoint(address)?, remote: remote.clone(), instance: instance.clone() };
            let (switches, _driving) = interrupt::driving()?;
            connect::connect(&settings, &switches.stop, &say)
        }
    }
}

/// Whoever reaches the address sees what the rig does; that must be meant.
fn loopback(endpoint: &str) -> Result<(), Failure> {
    let address = endpoint.trim_start_matches("tcp/");
    let found = address.to_socket_addrs().map_err(|error| {
        let message =
            format!("--listen {address}: expected an address of this machine, got \"{error}\"; such as 127.0.0.1:7447");
        Failure::new(Kind::Input, message)
    })?;
    let ips: Vec<IpAddr> = found.map(|found| found.ip()).collect();
    if ips.iter().all(IpAddr::is_loopback) {
        return Ok(());
    }
    let message = format!(
        "--listen {address}: expected an address of this machine alone, such as 127.0.0.1, got one that other machines reach; the link asks \
         nobody who they are: add --allow-remote where the network is trusted, or lead it through SSH or WireGuard (docs/NETWORK.md)"
    );
    Err(Failure::new(Kind::Input, message))
}
