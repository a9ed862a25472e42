//! A service in a process of its own, and its clients over a real socket.

#![allow(dead_code, reason = "each test file uses its part")]

use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// Nothing takes so long; the machine may be slow.
pub const PATIENCE: Duration = Duration::from_secs(120);

pub fn bench(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
    command.args(args).stdin(Stdio::null());
    command
}

/// An instance of its own for each service.
pub fn instance() -> String {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    format!("serve-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed))
}

/// Waits until `done` says what was waited for.
pub fn wait_for<T>(what: &str, mut done: impl FnMut() -> Option<T>) -> T {
    let begin = Instant::now();
    loop {
        if let Some(found) = done() {
            return found;
        }
        assert!(begin.elapsed() < PATIENCE, "waited in vain for {what}");
        thread::sleep(Duration::from_millis(20));
    }
}

/// A script that holds these voltages for these seconds.
pub fn script(name: &str, more: &str, holds: &[(f64, f64)]) -> String {
    let mut text = format!(
        "name = \"{name}\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\nabout = \"For a test\"\n{more}\n\
         [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n"
    );
    for (voltage_v, for_s) in holds {
        text.push_str(&format!("[[step]]\nvoltage_v = {voltage_v:?}\nfor_s = {for_s:?}\n"));
    }
    text
}

/// A running service.
pub struct Service {
    pub child: Child,
    pub instance: String,
    pub address: String,
    pub token: Option<String>,
    dir: Option<tempfile::TempDir>,
}

impl Service {
    /// With profiles `short` (2 s), `long` (a minute) and `beyond` (trips by its own envelope), and these options.
    pub fn start(options: &[&str]) -> Service {
        Service::start_with(options, |_| {})
    }

    pub fn start_with(options: &[&str], prepare: impl FnOnce(&mut Command)) -> Service {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let profiles = dir.path().join("profiles");
        std::fs::create_dir(&profiles).expect("a temporary folder");
        let put = |name: &str, text: String| {
            std::fs::write(profiles.join(format!("{name}.toml")), text).expect("a temporary folder");
        };
        // 2 s; the spike of 20 ms must be seen.
        put("short", script("short", "", &[(0.0, 0.5), (6.0, 0.5), (-17.5, 0.02), (-6.0, 0.48), (0.0, 0.5)]));
        put("long", script("long", "", &[(0.0, 0.2), (3.0, 0.3), (1.0, 60.0)]));
        put("beyond", script("beyond", "[envelope]\nvoltage_max_v = 2.0\n", &[(0.0, 0.3), (3.0, 5.0)]));
        Service::in_folder(dir, instance(), options, prepare)
    }

    /// Another one after this one has ended, in the same folder and on the same instance.
    pub fn again(self, options: &[&str]) -> Service {
        let instance = self.instance.clone();
        let dir = self.leave();
        Service::in_folder(dir, instance, options, |_| {})
    }

    fn in_folder(
        dir: tempfile::TempDir,
        instance: String,
        options: &[&str],
        prepare: impl FnOnce(&mut Command),
    ) -> Service {
        let (profiles, data) = (dir.path().join("profiles"), dir.path().join("data"));
        let mut command = bench(&["serve", "--listen", "127.0.0.1:0", "--instance", &instance]);
        command.arg("--profiles").arg(&profiles).arg("--data").arg(&data).args(options);
        command.env("XDG_RUNTIME_DIR", dir.path()).env_remove("RUNTIME_DIRECTORY");
        prepare(&mut command);
        let mut child = command.stdout(Stdio::piped()).spawn().expect("the program starts");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let mut service = Service { child, instance, address: String::new(), token: None, dir: Some(dir) };
        loop {
            let line = lines.next().expect("it ended by itself").expect("text");
            if let Some(address) = line.strip_prefix("listening on http://") {
                service.address = address.trim_end_matches('/').to_owned();
            } else if let Some((_, token)) = line.split_once("#token=") {
                service.token = Some(token.to_owned());
                break;
            } else if line.starts_with("read-only") {
                break;
            }
        }
        thread::spawn(move || lines.for_each(drop));
        service
    }

    /// Its folder.
    pub fn path(&self) -> &Path {
        self.dir.as_ref().expect("it is there until the service leaves").path()
    }

    fn leave(mut self) -> tempfile::TempDir {
        self.dir.take().expect("it is there until the service leaves")
    }

    pub fn data(&self) -> PathBuf {
        self.path().join("data")
    }

    pub fn url(&self, path: &str) -> String {
        format!("http://{}/api/v1{path}", self.address)
    }

    /// Status and body.
    pub fn get(&self, path: &str) -> (u16, Value) {
        let mut answer = agent().get(self.url(path)).call().expect("it answers");
        let text = answer.body_mut().read_to_string().expect("text");
        (answer.status().as_u16(), serde_json::from_str(&text).unwrap_or(Value::String(text)))
    }

    /// With the token.
    pub fn post(&self, path: &str, body: &str) -> (u16, Value) {
        self.post_with(path, body, &[("Authorization", &format!("Bearer {}", self.token.as_deref().unwrap_or("none")))])
    }

    pub fn post_with(&self, path: &str, body: &str, headers: &[(&str, &str)]) -> (u16, Value) {
        self.asked(path, body, headers).expect("it answers")
    }

    /// As `done`, of a service that has no place for this client now and then.
    pub fn done_at_last(&self, path: &str, body: &str) -> Value {
        let authorization = format!("Bearer {}", self.token.as_deref().unwrap_or("none"));
        let answer = || self.asked(path, body, &[("Authorization", &authorization)]).ok();
        let (status, answer) = wait_for(&format!("an answer to {path}"), answer);
        assert_eq!(status, 200, "{path}: {answer}");
        answer
    }

    fn asked(&self, path: &str, body: &str, headers: &[(&str, &str)]) -> Result<(u16, Value), ureq::Error> {
        let mut request = agent().post(self.url(path)).header("Content-Type", "application/json");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        let mut answer = request.send(body)?;
        let text = answer.body_mut().read_to_string()?;
        Ok((answer.status().as_u16(), serde_json::from_str(&text).unwrap_or(Value::String(text))))
    }

    pub fn done(&self, path: &str, body: &str) -> Value {
        let (status, answer) = self.post(path, body);
        assert_eq!(status, 200, "{path}: {answer}");
        answer
    }

    pub fn state(&self) -> Value {
        self.get("/state").1
    }

    pub fn wait_state(&self, state: &str) -> Value {
        wait_for(&format!("the state {state:?}"), || {
            let now = self.state();
            (now["service"]["state"] == state).then_some(now)
        })
    }

    /// Waits until the run under way has come to this time.
    pub fn wait_time(&self, time_s: f64) -> Value {
        wait_for(&format!("{time_s} s of the run"), || {
            let now = self.state();
            let run = &now["run"];
            (run["ended"] == false && run["time_s"].as_f64().is_some_and(|at_s| at_s >= time_s)).then_some(now)
        })
    }

    /// Arms, and queues this.
    pub fn run(&self, profile: &str) {
        self.done("/queue", &format!("{{\"profile\": \"{profile}\"}}"));
        self.done("/arm", "{\"for_s\": 3600}");
    }

    pub fn live(&self) -> Live {
        Live::open(&self.address, &[])
    }

    pub fn signal(&self, signal: libc::c_int) {
        let id = libc::pid_t::try_from(self.child.id()).expect("a process");
        // SAFETY: a plain system call; the process is our own child and was not waited for.
        assert_eq!(unsafe { libc::kill(id, signal) }, 0);
    }

    /// Waits for its end.
    pub fn ended(&mut self) -> ExitStatus {
        let begin = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("it is our child") {
                return status;
            }
            assert!(begin.elapsed() < PATIENCE, "the service does not end");
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// The only recording.
    pub fn recording(&self) -> PathBuf {
        wait_for("a closed recording", || {
            let entries = std::fs::read_dir(self.data()).ok()?;
            let mut files = entries.filter_map(|entry| Some(entry.ok()?.path()));
            files.find(|path| path.extension().is_some_and(|end| end == "mcap"))
        })
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Its run ends with it.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn agent() -> ureq::Agent {
    let config = ureq::Agent::config_builder().http_status_as_error(false).proxy(None);
    config.timeout_global(Some(Duration::from_secs(30))).build().into()
}

/// The samples of a recording.
pub fn samples(path: &Path) -> Vec<rt_core::Sample> {
    let reader = recordings::McapReader::open(path).expect("a recording");
    let items = reader.map(|item| item.expect("it is sound"));
    items.filter_map(|item| if let recordings::Item::Sample(sample) = item { Some(sample) } else { None }).collect()
}

/// A live connection.
pub struct Live {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    pub channels: Vec<String>,
    /// Texts since the last look, by type.
    pub texts: Vec<Value>,
    pub buckets: Vec<Bucket>,
}

/// A bucket, as a client has it.
#[derive(Clone, Debug)]
pub struct Bucket {
    pub run: u32,
    pub t_s: f64,
    /// Lowest, highest, last by channel.
    pub spans: Vec<[f32; 3]>,
}

impl Live {
    pub fn open(address: &str, headers: &[(&str, &str)]) -> Live {
        Live::try_open(address, headers).expect("it is taken up")
    }

    pub fn try_open(address: &str, headers: &[(&str, &str)]) -> Result<Live, String> {
        use tungstenite::client::IntoClientRequest;
        let mut request = format!("ws://{address}/api/v1/live").into_client_request().expect("an address");
        for (name, value) in headers {
            let name: tungstenite::http::HeaderName = name.parse().expect("a name");
            request.headers_mut().insert(name, value.parse().expect("a value"));
        }
        let stream = TcpStream::connect(address).map_err(|error| error.to_string())?;
        stream.set_read_timeout(Some(Duration::from_millis(50))).expect("a socket");
        // The handshake may take longer than one look.
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        let (socket, _) =
            tungstenite::client(request, MaybeTlsStream::Plain(stream)).map_err(|error| error.to_string())?;
        let mut live = Live { socket, channels: Vec::new(), texts: Vec::new(), buckets: Vec::new() };
        let Message::Text(hello) = live.socket.read().map_err(|error| error.to_string())? else {
            return Err("expected a text first".to_owned());
        };
        let hello: Value = serde_json::from_str(hello.as_str()).expect("JSON");
        assert_eq!((&hello["type"], &hello["api"]), (&"hello".into(), &1.into()), "{hello}");
        let channels = hello["channels"].as_array().expect("a list");
        live.channels = channels.iter().map(|channel| channel["name"].as_str().expect("a name").to_owned()).collect();
        Ok(live)
    }

    /// The next message; `false`: the connection is closed.
    pub fn step(&mut self) -> bool {
        match self.socket.read() {
            Ok(Message::Text(text)) => {
                self.texts.push(serde_json::from_str(text.as_str()).expect("JSON"));
                true
            }
            Ok(Message::Binary(bytes)) => {
                self.decode(&bytes);
                true
            }
            Ok(_) => true,
            Err(_) => false,
        }
    }

    /// Reads on until `done` says so.
    pub fn until(&mut self, what: &str, mut done: impl FnMut(&Live) -> bool) {
        let begin = Instant::now();
        while !done(self) {
            assert!(self.step(), "the connection was closed before {what}");
            assert!(begin.elapsed() < PATIENCE, "waited in vain for {what}");
        }
    }

    pub fn channel(&self, name: &str) -> usize {
        self.channels.iter().position(|channel| channel == name).expect("it is one of the channels")
    }

    pub fn of_type<'a>(&'a self, kind: &'a str) -> impl Iterator<Item = &'a Value> {
        self.texts.iter().filter(move |text| text["type"] == kind)
    }

    /// The socket below, for a client that behaves badly.
    pub fn stream(&self) -> &TcpStream {
        match self.socket.get_ref() {
            MaybeTlsStream::Plain(stream) => stream,
            _ => panic!("it is plain"),
        }
    }

    pub fn send(&mut self, text: &str) {
        self.socket.send(Message::text(text)).expect("it is taken");
    }

    fn decode(&mut self, bytes: &[u8]) {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes"));
        let [kind, run, n, m] = [0, 4, 8, 12].map(word);
        assert_eq!((kind, m as usize), (1, self.channels.len()));
        let (n, m) = (n as usize, m as usize);
        assert_eq!(bytes.len(), 16 + 8 * n + 12 * n * m);
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes"));
        for bucket in 0..n {
            let at = 16 + 8 * bucket;
            let t_s = f64::from_le_bytes(bytes[at..at + 8].try_into().expect("8 bytes"));
            let span =
                |channel: usize| [0, 1, 2].map(|part| float(16 + 8 * n + 4 * (n * (3 * channel + part) + bucket)));
            self.buckets.push(Bucket { run, t_s, spans: (0..m).map(span).collect() });
        }
    }
}
