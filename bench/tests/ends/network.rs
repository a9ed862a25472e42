//! Two network namespaces and a bad network between them: packets of two TUN devices, passed on by this process late, or not at all. It needs
//! root, but no kernel module for the purpose.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::fd::AsRawFd;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Address of the rig's side, in every network: each has namespaces of its own.
pub const RIG: &str = "10.77.0.1";

/// What the network does to packets, changed while it is used.
#[derive(Default)]
struct Weather {
    over: AtomicBool,
    /// Nothing gets through.
    black: AtomicBool,
    passed: AtomicU64,
    dropped: AtomicU64,
}

pub struct Network {
    /// The rig's namespace, and the other one.
    pub sides: [String; 2],
    devices: [String; 2],
    weather: Arc<Weather>,
    threads: Vec<JoinHandle<()>>,
}

impl Network {
    /// A network that delays each packet and loses this share of them. `None`: it can't be had here, which is said.
    pub fn new(delay: Duration, loss: f64) -> Option<Network> {
        match Self::attempt(delay, loss) {
            Ok(network) => Some(network),
            Err(why) => {
                // SAFETY: a plain system call.
                let root = unsafe { libc::geteuid() } == 0;
                let required = root && std::env::var("REC_BENCH_PEERS").is_ok_and(|value| value == "required");
                assert!(!required, "network namespaces: {why}");
                eprintln!(
                    "NOT TESTED: the link over two network namespaces: {why} (needs root, `ip` and /dev/net/tun)"
                );
                None
            }
        }
    }

    fn attempt(delay: Duration, loss: f64) -> Result<Network, String> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = format!("{}{}", std::process::id(), (b'a' + COUNT.fetch_add(1, Ordering::Relaxed) as u8) as char);
        let sides = ["a", "b"].map(|side| format!("rb{side}{number}"));
        let devices = ["t", "u"].map(|side| format!("rb{side}{number}"));
        let mut network = Network { sides, devices, weather: Arc::default(), threads: Vec::new() };
        let mut ends = Vec::new();
        for (side, (device, address)) in network.sides.iter().zip(network.devices.iter().zip([RIG, "10.77.0.2"])) {
            ends.push(tun(device)?);
            ip(&["netns", "add", side])?;
            ip(&["link", "set", device, "netns", side])?;
            ip(&["-n", side, "addr", "add", &format!("{address}/30"), "dev", device])?;
            ip(&["-n", side, "link", "set", "lo", "up"])?;
            ip(&["-n", side, "link", "set", device, "up"])?;
        }
        for (seed, (from, to)) in [(0, 1), (1, 0)].into_iter().enumerate() {
            let clone = |end: &File| end.try_clone().map_err(|e| e.to_string());
            let (mut from, mut to) = (clone(&ends[from])?, clone(&ends[to])?);
            let (late, due): (Sender<(Instant, Vec<u8>)>, Receiver<_>) = channel();
            let weather = Arc::clone(&network.weather);
            network.threads.push(thread::spawn(move || take(&mut from, &late, &weather, delay, loss, seed as u64)));
            network.threads.push(thread::spawn(move || {
                for (at, packet) in due {
                    thread::sleep(at.saturating_duration_since(Instant::now()));
                    // A device that is down takes none.
                    let _ = to.write_all(&packet);
                }
            }));
        }
        Ok(network)
    }

    /// A command in the namespace of this side.
    pub fn command(&self, side: usize, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.sides[side], program]);
        command
    }

    /// Lets nothing through, or everything again.
    pub fn black(&self, black: bool) {
        self.weather.black.store(black, Ordering::Relaxed);
    }

    /// Takes the rig's device down.
    pub fn cut(&self) {
        ip(&["-n", &self.sides[0], "link", "set", &self.devices[0], "down"]).expect("it was up");
    }

    /// Packets that got through, and that did not.
    pub fn counts(&self) -> (u64, u64) {
        (self.weather.passed.load(Ordering::Relaxed), self.weather.dropped.load(Ordering::Relaxed))
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        self.weather.over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
        for side in &self.sides {
            let _ = ip(&["netns", "del", side]);
        }
    }
}

/// Reads packets of one device and hands those on that the weather lets through.
fn take(from: &mut File, late: &Sender<(Instant, Vec<u8>)>, weather: &Weather, delay: Duration, loss: f64, seed: u64) {
    // The same losses in every test: xorshift.
    let mut state = 0x9E37_79B9_7F4A_7C15_u64 ^ (seed + 1);
    let mut packet = vec![0; 2048];
    while !weather.over.load(Ordering::Relaxed) {
        let mut waits = libc::pollfd { fd: from.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        // SAFETY: one descriptor, which is open.
        if unsafe { libc::poll(&raw mut waits, 1, 50) } <= 0 {
            continue;
        }
        let Ok(length) = from.read(&mut packet) else {
            thread::sleep(Duration::from_millis(10));
            continue;
        };
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        let lost = (state >> 11) as f64 / (1_u64 << 53) as f64 <= loss;
        if lost || weather.black.load(Ordering::Relaxed) {
            weather.dropped.fetch_add(1, Ordering::Relaxed);
            continue;
        }
        weather.passed.fetch_add(1, Ordering::Relaxed);
        if late.send((Instant::now() + delay, packet[..length].to_vec())).is_err() {
            return;
        }
    }
}

/// A new TUN device of this name.
fn tun(name: &str) -> Result<File, String> {
    let file =
        OpenOptions::new().read(true).write(true).open("/dev/net/tun").map_err(|e| format!("/dev/net/tun: {e}"))?;
    // SAFETY: a structure of numbers, for which zero is a value.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    for (to, from) in request.ifr_name.iter_mut().zip(name.bytes()) {
        *to = from as libc::c_char;
    }
    request.ifr_ifru.ifru_flags = (libc::IFF_TUN | libc::IFF_NO_PI) as i16;
    // SAFETY: the descriptor is open, and the request is what this call reads.
    if unsafe { libc::ioctl(file.as_raw_fd(), libc::TUNSETIFF, &raw mut request) } != 0 {
        return Err(format!("TUN device {name}: {}", std::io::Error::last_os_error()));
    }
    Ok(file)
}

fn ip(arguments: &[&str]) -> Result<(), String> {
    let output = Command::new("ip").args(arguments).output().map_err(|e| format!("ip: {e}"))?;
    if output.status.success() {
        return Ok(());
    }
    Err(format!("ip {}: {}", arguments.join(" "), String::from_utf8_lossy(&output.stderr).trim()))
}
