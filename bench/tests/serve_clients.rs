//! Clients of `bench serve` that behave badly, runs of other processes, and gaps that must show.

mod serve_client;

use serve_client::{Live, PATIENCE, Service, bench, samples, wait_for};
use std::collections::BTreeSet;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::fd::AsRawFd;
use std::os::unix::process::CommandExt;
use std::process::Stdio;
use std::thread;
use std::time::Duration;

/// Times of the buckets, without those that only say that nothing is there.
fn times(live: &Live) -> Vec<f64> {
    live.buckets.iter().map(|bucket| bucket.t_s).collect()
}

/// Numbers of the buckets of 10 ms that begin at these times.
fn buckets_of(times_s: Vec<f64>) -> BTreeSet<u64> {
    times_s.into_iter().map(|t_s| (t_s * 100.0).round() as u64).collect()
}

/// Longest distance between two buckets, s.
fn longest_gap_s(live: &Live) -> f64 {
    times(live).windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max)
}

#[test]
fn a_client_that_takes_nothing_holds_nobody_up_and_goes_on_with_the_newest() {
    let service = Service::start(&["--control"]);
    let mut slow = service.live();
    let small: libc::c_int = 4096;
    // SAFETY: the socket is open, and the option is an int of this size.
    let set = unsafe {
        libc::setsockopt(
            slow.stream().as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_RCVBUF,
            (&raw const small).cast(),
            size_of::<libc::c_int>() as libc::socklen_t,
        )
    };
    assert_eq!(set, 0);
    let mut quick = service.live();
    quick.send("{\"type\": \"emergency-stop\"}");
    service.run("long");
    slow.until("its first buckets", |slow| !slow.buckets.is_empty());
    let stopped_at_s = slow.buckets.last().expect("some").t_s;
    // What fits into the buffers of both ends is some 10 s of data.
    quick.until("25 s more of the run", |quick| {
        quick.buckets.last().is_some_and(|bucket| bucket.t_s > stopped_at_s + 25.0)
    });
    assert_eq!(service.state()["service"]["state"], "running", "what a client says has no effect");
    let newest_s = quick.buckets.last().expect("some").t_s;
    slow.until("the newest", |slow| slow.buckets.last().is_some_and(|bucket| bucket.t_s >= newest_s));
    assert!(longest_gap_s(&slow) > 2.0, "it was passed over, and sees it: {}", longest_gap_s(&slow));
    assert!(slow.buckets.windows(2).all(|pair| pair[0].t_s < pair[1].t_s));
    service.done("/stop", "{}");
    service.wait_state("idle");
    // On a busy machine the loop itself may be late and pass ticks over: a bucket without any sample is no bucket.
    let known = buckets_of(times(&quick));
    let (first, last) = (known.first().expect("some"), known.last().expect("some"));
    let recorded: BTreeSet<u64> = samples(&service.recording()).iter().map(|sample| sample.tick / 10).collect();
    let due: BTreeSet<u64> = recorded.range(first..=last).copied().collect();
    assert_eq!(known, due, "who takes what comes misses nothing of what was recorded");
}

#[test]
fn what_the_service_misses_shows_while_the_recording_is_whole() {
    let service = Service::start(&["--control"]);
    let mut live = service.live();
    service.run("long");
    service.wait_time(0.5);
    service.signal(libc::SIGSTOP);
    // Its buffer holds 8 s.
    thread::sleep(Duration::from_secs(11));
    service.signal(libc::SIGCONT);
    let state = wait_for("the missed samples", || {
        let state = service.state();
        (state["run"]["missed"].as_u64() > Some(0)).then_some(state)
    });
    let after_s = state["run"]["time_s"].as_f64().expect("a number");
    live.until("what came after", |live| live.buckets.last().is_some_and(|bucket| bucket.t_s > after_s));
    let nothing =
        |bucket: &&serve_client::Bucket| bucket.spans.iter().all(|span| span.iter().all(|value| value.is_nan()));
    assert_eq!(live.buckets.iter().filter(nothing).count(), 1, "one bucket says that nothing is there");
    assert!(longest_gap_s(&live) > 1.0, "and time jumps: {}", longest_gap_s(&live));
    live.until("a word of it", |live| {
        live.of_type("event").any(|event| event["text"].as_str().is_some_and(|text| text.contains("did not reach")))
    });
    service.done("/stop", "{}");
    service.wait_state("idle");
    let recorded = samples(&service.recording());
    assert!(recorded.windows(2).all(|pair| pair[1].sequence() == pair[0].sequence() + 1), "its own logger missed none");
}

#[test]
fn a_run_of_another_process_is_shown_and_can_be_stopped() {
    let service = Service::start(&["--control"]);
    let mut live = service.live();
    let file = |name: &str| service.path().join(name).display().to_string();
    let (profile, out) = (file("profiles/long.toml"), file("elsewhere.mcap"));
    let run = |out: &str| {
        bench(&["run", &profile, "--realtime", "--instance", &service.instance, "--out", out])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts")
    };
    let mut other = run(&out);
    let state = service.wait_time(0.6);
    assert_eq!((&state["service"]["state"], &state["run"]["own"]), (&"idle".into(), &false.into()), "{state}");
    assert_eq!(state["run"]["name"], "long", "as it announced");
    let duration_s = state["run"]["duration_s"].as_f64().expect("as it announced");
    assert!((duration_s - 60.5).abs() < 1e-6, "{duration_s}");
    service.run("short");
    thread::sleep(Duration::from_millis(500));
    assert_eq!(service.state()["service"]["state"], "armed", "nothing is started while somebody else drives the rig");
    service.done("/stop", "{}");
    assert_eq!(other.wait().expect("it is our child").code(), Some(130));
    assert_eq!(service.wait_state("idle")["queue"][0]["profile"], "short", "people stopped it for a reason");
    live.until("its end", |live| live.of_type("state").any(|state| state["run"]["ended"] == true));
    assert!(!live.buckets.is_empty());

    // One that is killed has no last sample.
    let mut other = run(&file("killed.mcap"));
    wait_for("the second run", || {
        let state = service.state();
        (state["run"]["ended"] == false && state["run"]["time_s"].as_f64() > Some(0.3)).then_some(())
    });
    other.kill().expect("it is our child");
    other.wait().expect("it is our child");
    wait_for("its end to be noticed", || (service.state()["run"]["ended"] == true).then_some(()));
    assert_eq!(service.state()["run"]["number"], 2, "every run has its number");
    service.done("/arm", "{}");
    wait_for("a run after it", || (service.state()["last"]["outcome"] == "completed").then_some(()));
}

#[test]
fn downloads_that_take_nothing_hold_up_no_other_request() {
    let service = Service::start(&["--control"]);
    // More than the buffers of both ends; a download asks for no more than the name.
    let content: Vec<u8> = (0..8 << 20).map(|at: u32| (at % 251) as u8).collect();
    std::fs::create_dir_all(service.data()).expect("a temporary folder");
    std::fs::write(service.data().join("large.mcap"), &content).expect("a temporary folder");
    let begun = || {
        let mut client = TcpStream::connect(&service.address).expect("it is taken up");
        client.set_read_timeout(Some(PATIENCE)).expect("a socket");
        let asked = "GET /api/v1/runs/large/recording HTTP/1.1";
        write!(client, "{asked}\r\nHost: {}\r\nConnection: close\r\n\r\n", service.address).expect("it is asked");
        let mut status = [0; 12];
        client.read_exact(&mut status).expect("it answers");
        assert_eq!(&status, b"HTTP/1.1 200");
        client
    };
    // More than the service has threads for what waits.
    let mut stalled = [begun(), begun(), begun()];
    thread::sleep(Duration::from_millis(500));

    let (status, runs) = service.get("/runs");
    assert_eq!((status, &runs[0]["id"]), (200, &"large".into()), "{runs}");
    assert_eq!(service.get("/runs/large").0, 500, "it is no recording, and that is said");
    assert_eq!(service.post("/confirm", "{}").0, 409, "nobody asks for anything");

    // Who goes on gets it all.
    let mut rest = Vec::new();
    stalled[0].read_to_end(&mut rest).expect("the rest");
    assert!(rest.ends_with(&content), "{} bytes of {}", rest.len(), content.len());
}

#[test]
fn clients_that_say_nothing_keep_nobody_from_stopping_nor_a_run_from_starting() {
    // Of 256 files the service itself needs some 60.
    let few_files = || {
        let limit = libc::rlimit { rlim_cur: 256, rlim_max: 256 };
        // SAFETY: a plain system call with a valid argument.
        if unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &raw const limit) } == 0 {
            Ok(())
        } else {
            Err(io::Error::last_os_error())
        }
    };
    let service = Service::start_with(&["--control"], |command| {
        // SAFETY: between fork and exec it only sets a limit; it allocates nothing.
        unsafe { command.pre_exec(few_files) };
    });
    let mut silent: Vec<TcpStream> =
        (0..300).map(|_| TcpStream::connect(&service.address).expect("the system takes it up")).collect();
    assert_eq!(service.done_at_last("/emergency-stop", "{}")["service"]["state"], "tripped");
    // Those that found no place are closed, the others when they have said nothing for long enough.
    for client in &mut silent {
        client.set_read_timeout(Some(PATIENCE)).expect("a socket");
        let end = client.read(&mut [0]).map_err(|error| error.kind());
        assert!(matches!(end, Ok(0) | Err(io::ErrorKind::ConnectionReset)), "it was not left: {end:?}");
    }
    service.done("/acknowledge", "{}");
    service.run("short");
    let last = wait_for("the run's end", || {
        let last = service.state()["last"].clone();
        last["outcome"].is_string().then_some(last)
    });
    assert_eq!(last["outcome"], "completed", "{last}");
}
