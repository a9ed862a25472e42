//! What watching costs: the loop's lateness with ten live clients of `bench serve` and three subscribers of shared memory against none, in
//! alternating slices of one run; the service's processor time with one client; the age of a sample when a client has it.
//!
//! ```text
//! cargo build --release && cargo run --release -p benchmarks --bin service -- 120
//! ```
//!
//! The number is the length of the run in s. On a machine that does something else meanwhile the ratio says nothing.

use benchmarks::{Target, exit};
use recordings::{Item, McapReader};
use rt_core::{Delivery, SampleSubscriber};
use serde_json::Value;
use std::error::Error;
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tungstenite::Message;

/// Length of a slice, s.
const SLICE_S: f64 = 5.0;
/// What is left out at the beginning of a slice, s: clients come and go then.
const SETTLING_S: f64 = 1.0;
const CLIENTS: usize = 10;
const SUBSCRIBERS: usize = 3;
const INSTANCE: &str = "benchmark-service";

/// Median of the slices' p99 with all clients over that with none.
const WATCHED: Target = Target::AtMost(1.1);
/// Share of a core with one client.
const SHARE: Target = Target::AtMost(0.1);
/// From when the oldest sample of a frame was due to the client having it, ms, p99: the screen adds a frame of its own.
const AGE_MS: Target = Target::AtMost(80.0);

fn main() -> ExitCode {
    exit(measured())
}

fn measured() -> Result<bool, Box<dyn Error>> {
    let seconds: f64 = std::env::args().nth(1).map_or(Ok(120.0), |text| text.parse())?;
    let folder = tempfile::tempdir()?;
    let mut service = Service::start(folder.path(), seconds)?;
    let run = service.begin()?;
    let (mut without, mut with) = (Vec::new(), Vec::new());
    let mut next_s = service.time_s()?;
    while next_s + SLICE_S < seconds - 15.0 {
        let crowd = (with.len() < without.len()).then(|| Crowd::start(&service.address));
        let slices = if crowd.is_some() { &mut with } else { &mut without };
        slices.push((next_s + SETTLING_S, next_s + SLICE_S));
        next_s += SLICE_S;
        thread::sleep(Duration::from_secs_f64((next_s - service.time_s()?).max(0.0)));
        if let Some(crowd) = crowd {
            crowd.leave()?;
        }
    }
    let (share, ages_ms) = service.with_one_client()?;
    service.end()?;

    let lateness = lateness(&run)?;
    let p99 = |slices: &[(f64, f64)]| median(slices.iter().filter_map(|slice| of_slice(&lateness, *slice)).collect());
    let (alone, crowded) = (p99(&without), p99(&with));
    println!(
        "slices of {SLICE_S} s: {} with none, {} with {CLIENTS} clients and {SUBSCRIBERS} subscribers",
        without.len(),
        with.len()
    );
    println!("  lateness, median of the slices' p99: {alone:.1} us with none, {crowded:.1} us with all");
    let mut reached = true;
    let mut say = |name: &str, figure: f64, target: Target| {
        println!("{name}: {figure:.3}, {}", target.judge(figure));
        reached &= target.reached_by(figure);
    };
    say("p99 of lateness, all over none", crowded / alone, WATCHED);
    say("share of a core, one client", share, SHARE);
    say("age of a frame's oldest sample at the client, p99, ms", quantile(ages_ms, 0.99), AGE_MS);
    Ok(reached)
}

/// A service with its token.
struct Service {
    child: Child,
    address: String,
    token: String,
    data: PathBuf,
}

impl Service {
    fn start(folder: &Path, seconds: f64) -> Result<Service, Box<dyn Error>> {
        let program = std::env::current_exe()?.with_file_name("bench");
        let profiles = folder.join("profiles");
        std::fs::create_dir(&profiles)?;
        let script = format!(
            "name = \"watched\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\n\
             [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
             [[step]]\nvoltage_v = 1.0\nfor_s = {seconds:?}\n"
        );
        std::fs::write(profiles.join("watched.toml"), script)?;
        let data = folder.join("data");
        let mut command = Command::new(&program);
        command.args(["serve", "--control", "--listen", "127.0.0.1:0", "--instance", INSTANCE]);
        command.arg("--profiles").arg(&profiles).arg("--data").arg(&data).stdout(Stdio::piped());
        let mut child = command
            .spawn()
            .map_err(|error| format!("{}: {error}; build it first: cargo build --release", program.display()))?;
        let out = child.stdout.take().ok_or("its output is a pipe")?;
        let mut lines = BufReader::new(out).lines();
        let mut service = Service { child, address: String::new(), token: String::new(), data };
        while service.token.is_empty() {
            let line = lines.next().ok_or("the service ended by itself")??;
            if let Some(address) = line.strip_prefix("listening on http://") {
                service.address = address.trim_end_matches('/').to_owned();
            } else if let Some((_, token)) = line.split_once("#token=") {
                service.token = token.to_owned();
            }
        }
        Ok(service)
    }

    fn post(&self, path: &str, body: &str) -> Result<(), Box<dyn Error>> {
        let request = ureq::post(format!("http://{}/api/v1{path}", self.address));
        request.header("Authorization", format!("Bearer {}", self.token)).send(body)?;
        Ok(())
    }

    fn state(&self) -> Result<Value, Box<dyn Error>> {
        let text = ureq::get(format!("http://{}/api/v1/state", self.address)).call()?.body_mut().read_to_string()?;
        Ok(serde_json::from_str(&text)?)
    }

    /// The run's time, s.
    fn time_s(&self) -> Result<f64, Box<dyn Error>> {
        let state = self.state()?;
        if state["run"]["ended"] != false {
            return Err(format!("expected a run under way, got {state}").into());
        }
        state["run"]["time_s"].as_f64().ok_or_else(|| "the run has no time".into())
    }

    /// Starts the run; the recording that it will be.
    fn begin(&self) -> Result<PathBuf, Box<dyn Error>> {
        self.post("/queue", "{\"profile\": \"watched\"}")?;
        self.post("/arm", "{}")?;
        let begun = Instant::now();
        while !self.time_s().is_ok_and(|time_s| time_s > 1.0) {
            if begun.elapsed() > Duration::from_secs(30) {
                return Err("the run does not begin".into());
            }
            thread::sleep(Duration::from_millis(50));
        }
        for entry in std::fs::read_dir(&self.data)? {
            let path = entry?.path();
            if path.extension().is_some_and(|end| end == "part") {
                return Ok(path.with_extension(""));
            }
        }
        Err("the run has no recording".into())
    }

    /// Share of a core over 10 s with one client, and the ages of its frames' oldest samples, ms.
    fn with_one_client(&self) -> Result<(f64, Vec<f64>), Box<dyn Error>> {
        let mut client = connect(&self.address)?;
        let (mut origin_ms, mut ages_ms) = (None, Vec::new());
        let (begun, before) = (Instant::now(), cpu_s(self.child.id())?);
        // The first frame is the history.
        let mut frames = 0;
        while begun.elapsed() < Duration::from_secs(10) {
            match client.read()? {
                Message::Text(text) => {
                    let message: Value = serde_json::from_str(text.as_str())?;
                    if message["type"] == "begin" {
                        origin_ms = message["origin_utc_ms"].as_f64();
                    }
                }
                Message::Binary(bytes) => {
                    frames += 1;
                    let first = bytes.get(16..24).ok_or("a frame without a bucket")?;
                    let oldest_ms = 1e3 * f64::from_le_bytes(first.try_into()?);
                    let now_ms = SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs_f64() * 1e3;
                    if frames > 1 {
                        ages_ms.extend(origin_ms.map(|origin_ms| now_ms - origin_ms - oldest_ms));
                    }
                }
                _ => {}
            }
        }
        Ok(((cpu_s(self.child.id())? - before) / begun.elapsed().as_secs_f64(), ages_ms))
    }

    /// Stops the run and waits for its recording.
    fn end(&mut self) -> Result<(), Box<dyn Error>> {
        self.post("/stop", "{}")?;
        let begun = Instant::now();
        while self.state()?["last"].is_null() {
            if begun.elapsed() > Duration::from_secs(60) {
                return Err("the run does not end".into());
            }
            thread::sleep(Duration::from_millis(50));
        }
        Ok(())
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Its run ends with it.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

type Client = tungstenite::WebSocket<TcpStream>;

fn connect(address: &str) -> Result<Client, Box<dyn Error>> {
    let stream = TcpStream::connect(address)?;
    let (client, _) = tungstenite::client(format!("ws://{address}/api/v1/live"), stream)
        .map_err(|error| format!("live connection: {error}"))?;
    Ok(client)
}

/// Everybody who watches.
struct Crowd {
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Result<(), String>>>,
}

impl Crowd {
    fn start(address: &str) -> Crowd {
        let over = Arc::new(AtomicBool::new(false));
        let clients = (0..CLIENTS).map(|_| {
            let (over, address) = (Arc::clone(&over), address.to_owned());
            thread::spawn(move || {
                let mut client = connect(&address).map_err(|error| error.to_string())?;
                while !over.load(Ordering::Relaxed) {
                    client.read().map_err(|error| error.to_string())?;
                }
                Ok(())
            })
        });
        let subscribers = (0..SUBSCRIBERS).map(|_| {
            let over = Arc::clone(&over);
            thread::spawn(move || {
                let failed = |error: rt_core::LinkError| error.to_string();
                let mut subscriber = SampleSubscriber::open(INSTANCE, Delivery::BestEffort).map_err(failed)?;
                let mut samples = Vec::new();
                while !over.load(Ordering::Relaxed) {
                    samples.clear();
                    subscriber.receive(Duration::from_millis(100), &mut samples).map_err(failed)?;
                }
                Ok(())
            })
        });
        let threads = clients.chain(subscribers).collect();
        Crowd { over, threads }
    }

    fn leave(self) -> Result<(), Box<dyn Error>> {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().map_err(|_| "a client panicked")??;
        }
        Ok(())
    }
}

/// Processor time of a process, s.
fn cpu_s(id: u32) -> Result<f64, Box<dyn Error>> {
    let text = std::fs::read_to_string(format!("/proc/{id}/stat"))?;
    let (_, after_name) = text.rsplit_once(')').ok_or("expected a name in parentheses")?;
    let fields: Vec<&str> = after_name.split_whitespace().collect();
    let ticks = |at: usize| fields.get(at).ok_or("expected more fields").map(|field| field.parse::<f64>());
    let (user, system) = (ticks(11)??, ticks(12)??);
    Ok((user + system) / rustix::param::clock_ticks_per_second() as f64)
}

/// Time and lateness of each tick, s and us.
fn lateness(path: &Path) -> Result<Vec<(f64, f64)>, Box<dyn Error>> {
    let mut all = Vec::new();
    for item in McapReader::open(path)? {
        if let Item::Sample(sample) = item? {
            all.push((sample.time_s(), sample.lateness_ns as f64 * 1e-3));
        }
    }
    Ok(all)
}

fn of_slice(lateness: &[(f64, f64)], (from_s, to_s): (f64, f64)) -> Option<f64> {
    let us: Vec<f64> = lateness.iter().filter(|(at_s, _)| (from_s..to_s).contains(at_s)).map(|(_, us)| *us).collect();
    (!us.is_empty()).then(|| quantile(us, 0.99))
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    values.get(rank.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

fn median(values: Vec<f64>) -> f64 {
    quantile(values, 0.5)
}
