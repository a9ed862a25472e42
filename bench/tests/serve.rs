//! `bench serve` over a real socket: who may do what, runs from the queue, live data, stops, trips.

mod serve_client;

use serde_json::Value;
use serve_client::{Live, Service, bench, samples, wait_for};
use std::time::Duration;

#[test]
fn a_read_only_service_takes_no_commands_by_any_way() {
    let service = Service::start(&[]);
    let state = service.state();
    assert_eq!((&state["service"]["state"], &state["service"]["control"]), (&"idle".into(), &false.into()), "{state}");
    for path in ["/arm", "/stop", "/emergency-stop", "/queue", "/acknowledge", "/confirm", "/disarm"] {
        let (status, answer) = service.post(path, "{}");
        assert_eq!(status, 403, "{path}");
        assert!(answer["error"].as_str().expect("words").contains("read-only"), "{answer}");
        assert!(answer["remedy"].as_str().expect("words").contains("--control"), "{answer}");
    }
    let local = |what: &str| bench(&["service", what, "--instance", &service.instance]).output().expect("it starts");
    let refused = local("arm");
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("read-only"));
    let stands = local("state");
    assert!(stands.status.success() && String::from_utf8_lossy(&stands.stdout).starts_with("idle"));
    assert_eq!(service.state()["service"]["state"], "idle");
}

#[test]
fn commands_need_the_token_and_other_sites_get_nothing() {
    let service = Service::start(&["--control"]);
    let token = service.token.clone().expect("it was said");
    for wrong in [None, Some("Bearer "), Some("Bearer 0000000000000000"), Some("Basic eDp5")] {
        let headers: Vec<(&str, &str)> = wrong.map(|value| ("Authorization", value)).into_iter().collect();
        let (status, answer) = service.post_with("/arm", "{}", &headers);
        assert_eq!(status, 401, "{wrong:?}: {answer}");
    }
    let right = format!("Bearer {token}");
    for (name, value) in [("Origin", "http://evil.example"), ("Origin", "null"), ("Host", "evil.example")] {
        let (status, _) = service.post_with("/arm", "{}", &[("Authorization", &right), (name, value)]);
        assert_eq!(status, 403, "{name}: {value}");
    }
    let evil = Live::try_open(&service.address, &[("Origin", "http://evil.example")]);
    assert!(evil.err().is_some_and(|error| error.contains("403")), "another site's page gets no live data");
    let own = format!("http://{}", service.address);
    assert!(Live::try_open(&service.address, &[("Origin", &own)]).is_ok());
    assert_eq!(service.state()["service"]["state"], "idle", "nothing of all that armed it");

    let (status, _) = service.post_with("/arm", "{}", &[("Authorization", &right), ("Origin", &own)]);
    assert_eq!((status, service.state()["service"]["state"].clone()), (200, "armed".into()));
    for (path, body) in [
        ("/arm", "{\"for_s\": 0}"),
        ("/arm", "{\"for\": 60}"),
        ("/arm", "arm"),
        ("/queue", "{}"),
        ("/queue", "{\"profile\": \"nobody's\"}"),
        ("/acknowledge", "{}"),
        ("/confirm", "{}"),
        ("/nothing", "{}"),
    ] {
        let (status, answer) = service.post(path, body);
        assert!((400..500).contains(&status), "{path} {body}: {status}");
        assert!(answer["error"].is_string() && answer["remedy"].is_string(), "{path} {body}: {answer}");
    }
    let (status, _) = service.post("/arm", &format!("{{\"for_s\": {}}}", " ".repeat(20_000)));
    assert_eq!(status, 413);
    assert_eq!(service.get("/arm").0, 405);
    let file = service.path().join("rec-bench").join(format!("{}.token", service.instance));
    assert_eq!(std::fs::read_to_string(file).expect("it is there").trim(), token);
}

#[test]
fn what_can_not_be_meant_is_refused_at_the_start() {
    let failed = |args: &[&str], code: i32, word: &str| {
        let output = bench(args).output().expect("the program starts");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
        assert!(said.contains(word), "{args:?}: {said}");
    };
    let instance = serve_client::instance();
    let serve = |more: &[&'static str]| [&["serve", "--instance", &instance], more].concat();
    failed(&serve(&["--listen", "0.0.0.0:0"]), 2, "--allow-remote");
    failed(&serve(&["--listen", "nowhere"]), 2, "--listen");
    failed(&serve(&["none.toml"]), 2, "none.toml");
    failed(&serve(&["--profiles", "none"]), 2, "none");
    failed(&serve(&["--control", "--token-file", "none", "--listen", "127.0.0.1:0"]), 2, "--token-file");
    failed(&["service", "state", "--instance", &instance], 4, "bench serve");
    let service = Service::start(&[]);
    failed(&["serve", "--instance", &service.instance, "--listen", "127.0.0.1:0"], 4, "in use");
    let taken = ["serve", "--instance", &instance, "--listen", &service.address];
    failed(&taken, 4, "--listen");
}

#[test]
fn a_second_service_that_is_refused_leaves_the_first_one_s_token_where_it_is() {
    let service = Service::start(&["--control"]);
    let mut second = bench(&["serve", "--control", "--instance", &service.instance, "--listen", "127.0.0.1:0"]);
    second.env("XDG_RUNTIME_DIR", service.path()).env_remove("RUNTIME_DIRECTORY");
    assert_eq!(second.output().expect("the program starts").status.code(), Some(4));
    let file = service.path().join("rec-bench").join(format!("{}.token", service.instance));
    assert_eq!(std::fs::read_to_string(file).expect("it is there").trim(), service.token.as_deref().expect("said"));
}

#[test]
fn a_queued_run_is_run_when_armed_shown_and_recorded() {
    let mut service = Service::start(&["--control"]);
    let mut live = service.live();
    let id = service.done("/queue", "{\"profile\": \"short\", \"seed\": 5}")["id"].clone();
    let unwanted = service.done("/queue", "{\"profile\": \"long\"}")["id"].clone();
    std::thread::sleep(Duration::from_millis(300));
    let state = service.state();
    assert_eq!((&state["service"]["state"], &state["queue"][0]["id"]), (&"idle".into(), &id), "idle starts nothing");
    let authorization = format!("Bearer {}", service.token.as_deref().expect("it was said"));
    let gone = ureq::delete(service.url(&format!("/queue/{unwanted}"))).header("Authorization", &authorization).call();
    assert_eq!(gone.expect("it is taken out").status(), 200);
    assert_eq!(service.state()["queue"].as_array().map(Vec::len), Some(1));
    service.done("/arm", "{}");

    let state = service.wait_time(0.7);
    let run = &state["run"];
    assert_eq!(state["service"]["state"], "running");
    assert_eq!((&run["name"], &run["own"], &run["seed"]), (&"short".into(), &true.into(), &5.into()), "{run}");
    assert!((run["duration_s"].as_f64().expect("it has an end") - 2.0).abs() < 1e-6);
    assert!(run["step"]["text"].as_str().expect("words").contains(" V"), "{run}");
    assert_eq!(run["supervisor"], "ok");
    assert_eq!(state["link"]["valid"]["angle"], true, "{state}");
    let own_clock_ms =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).expect("after 1970").as_secs_f64() * 1e3;
    let due_ms = run["origin_utc_ms"].as_f64().expect("real time") + 1000.0 * run["time_s"].as_f64().expect("a number");
    assert!((own_clock_ms - due_ms).abs() < 60_000.0, "its clock is the wall's: {own_clock_ms} {due_ms}");

    let state = service.wait_state("armed");
    assert_eq!(state["last"]["outcome"], "completed", "{state}");
    assert_eq!((&state["run"]["ended"], &state["queue"]), (&true.into(), &Value::Array(Vec::new())));
    let run = state["run"]["number"].as_u64().expect("a number") as u32;

    // What the live connection brought, against the recording.
    live.until("the end of the run", |live| {
        live.of_type("event").any(|event| event["text"].as_str().is_some_and(|text| text.contains("completed")))
            && live.buckets.last().is_some_and(|bucket| bucket.t_s >= 1.98)
    });
    assert_eq!(live.of_type("begin").map(|begin| &begin["run"]).collect::<Vec<_>>(), [&Value::from(run)]);
    assert_eq!(live.of_type("begin").next().map(|begin| &begin["name"]), Some(&"short".into()));
    let recorded = samples(&service.recording());
    assert_eq!((recorded[0].run, recorded[0].tick), (run, 0));
    assert!(recorded.last().is_some_and(|last| last.last() && (1999..=2001).contains(&last.tick)), "2 s");
    check_buckets(&live, &recorded, run);
    assert!(live.of_type("timing").any(|timing| timing["run"] == run && timing["p99_us"].as_f64() > Some(0.0)));
    assert!(live.of_type("state").any(|state| state["run"]["time_s"].as_f64() > Some(0.5)));
    // Who comes later gets it all.
    let mut late = service.live();
    late.until("the history", |late| late.buckets.last().is_some_and(|bucket| bucket.t_s >= 1.98));
    check_buckets(&late, &recorded, run);
    assert!(late.of_type("event").all(|event| event["number"].as_u64() >= Some(1)));

    let (_, runs) = service.get("/runs");
    assert_eq!(
        (&runs[0]["name"], &runs[0]["outcome"], &runs[0]["lossless"]),
        (&"short".into(), &"completed".into(), &true.into()),
        "{runs}"
    );
    assert_eq!(runs[0]["id"], state["last"]["id"]);
    let address = format!("http://{}", service.address);
    let mut page = ureq::get(format!("{address}{}", runs[0]["page"].as_str().expect("a path"))).call().expect("a page");
    assert!(page.headers()["content-security-policy"].to_str().expect("text").contains("sandbox"));
    assert!(page.body_mut().read_to_string().expect("text").contains("angle_deg"));
    let file = format!("{address}{}", runs[0]["recording"].as_str().expect("a path"));
    let bytes = ureq::get(file).call().expect("a file").body_mut().read_to_vec().expect("bytes");
    assert_eq!(bytes, std::fs::read(service.recording()).expect("the file"));
    assert_eq!(service.get("/runs/nobody").0, 404);

    service.signal(libc::SIGTERM);
    assert_eq!(service.ended().code(), Some(0), "nothing was cut short");
}

/// Every bucket says what the recording says, or that something is missing.
fn check_buckets(live: &Live, recorded: &[rt_core::Sample], run: u32) {
    let (voltage, lateness) = (live.channel("voltage_v"), live.channel("lateness_us"));
    assert!(live.buckets.windows(2).all(|pair| pair[0].t_s < pair[1].t_s), "each bucket once, in order");
    let whole = live.buckets.iter().filter(|bucket| !bucket.spans[voltage][2].is_nan()).count();
    assert!(whole * 10 >= live.buckets.len() * 9, "most of it came: {whole} of {}", live.buckets.len());
    let mut compared = 0;
    for bucket in live.buckets.iter().filter(|bucket| !bucket.spans[voltage][2].is_nan()) {
        assert_eq!(bucket.run, run);
        let first = (bucket.t_s * 1e3).round() as u64;
        let of: Vec<_> = recorded.iter().filter(|sample| (first..first + 10).contains(&sample.tick)).collect();
        let fold = |start: f32, with: fn(f32, f32) -> f32, value: fn(&rt_core::Sample) -> f64| {
            of.iter().map(|sample| value(sample) as f32).fold(start, with)
        };
        let volts = |sample: &rt_core::Sample| sample.voltage_v;
        let expected = [
            fold(f32::NAN, f32::min, volts),
            fold(f32::NAN, f32::max, volts),
            of.last().expect("samples").voltage_v as f32,
        ];
        assert_eq!(bucket.spans[voltage], expected, "at {} s", bucket.t_s);
        let latest = fold(f32::NAN, f32::max, |sample| sample.lateness_ns as f64 * 1e-3);
        assert!((bucket.spans[lateness][1] - latest).abs() <= 1e-3 * latest.abs().max(1.0));
        compared += 1;
    }
    assert!(compared > 100, "{compared}");
    let lowest = live.buckets.iter().map(|bucket| bucket.spans[voltage][0]).fold(f32::NAN, f32::min);
    assert_eq!(lowest, -17.5, "the spike is kept");
}

#[test]
fn a_stop_ends_the_run_and_holds_the_queue() {
    let service = Service::start(&["--control"]);
    service.done("/queue", "{\"profile\": \"long\"}");
    service.run("short");
    service.wait_time(0.6);
    service.done("/stop", "{}");
    let state = service.wait_state("idle");
    assert_eq!(state["last"]["outcome"], "stopped", "{state}");
    assert_eq!(state["queue"][0]["profile"], "short", "what is queued stays");
    let stopped = samples(&service.recording());
    let last = stopped.last().expect("samples");
    assert!(last.last() && last.voltage_v == 0.0 && last.flags & rt_core::flags::STOPPED != 0, "{last:?}");
    assert!(last.time_s() < 59.0, "a minute it would have been");
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(service.state()["service"]["state"], "idle", "the queue is held");
    let (_, runs) = service.get("/runs");
    assert_eq!(runs[0]["outcome"], "stopped", "{runs}");
}

#[test]
fn an_emergency_stop_trips_and_is_held_until_acknowledged() {
    let service = Service::start(&["--control"]);
    service.run("long");
    service.wait_time(0.6);
    service.done("/disarm", "{}");
    assert_eq!(service.state()["service"]["state"], "running", "disarmed, the run goes on");
    let answer = service.done("/emergency-stop", "");
    assert_eq!(answer["service"]["state"], "tripped", "at once: {answer}");
    assert!(answer["service"]["trip"]["reason"].as_str().expect("words").contains("emergency stop"));
    assert_eq!(service.post("/arm", "{}").0, 409, "tripped can't be armed");
    wait_for("the run's end", || (service.state()["last"]["outcome"] == "tripped").then_some(()));
    let last = *samples(&service.recording()).last().expect("samples");
    assert!(last.last() && last.tripped() && last.voltage_v == 0.0, "{last:?}");
    let state = service.state();
    assert_eq!((&state["run"]["supervisor"], &state["run"]["trip"]), (&"tripped".into(), &"emergency stop".into()));
    assert_eq!(service.done("/acknowledge", "{}")["service"]["state"], "idle");
    assert_eq!(service.post("/acknowledge", "{}").0, 409, "once is enough");

    let answer = service.done("/emergency-stop", "{}");
    assert_eq!(answer["service"]["state"], "tripped", "with nothing under way it is held, too");
    service.done("/acknowledge", "{}");
}

#[test]
fn a_run_that_trips_holds_the_queue_and_says_why() {
    let service = Service::start(&["--control"]);
    service.run("beyond");
    service.done("/queue", "{\"profile\": \"short\"}");
    let state = service.wait_state("tripped");
    let trip = &state["service"]["trip"];
    assert!(trip["reason"].as_str().expect("words").contains("voltage"), "{trip}");
    assert_eq!(trip["run"], state["run"]["number"]);
    wait_for("the run's end", || (service.state()["last"]["outcome"] == "tripped").then_some(()));
    std::thread::sleep(Duration::from_millis(300));
    let state = service.state();
    assert_eq!((&state["service"]["state"], &state["queue"][0]["profile"]), (&"tripped".into(), &"short".into()));
    // From the command line, over shared memory.
    let local = |args: &[&str]| {
        let output = bench(&[&["service"], args, &["--instance", &service.instance, "--json"]].concat()).output();
        let output = output.expect("the program starts");
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice::<Value>(&output.stdout).expect("JSON")
    };
    assert!(local(&["state"])["text"].as_str().expect("words").contains("voltage"));
    assert_eq!(local(&["acknowledge"])["state"], "idle");
    let id = local(&["queue", "long", "--seed", "9"])["id"].as_u64().expect("an id").to_string();
    assert_eq!(local(&["unqueue", &id])["queued"], 1);
    assert!(local(&["arm", "--for-s", "3600"])["armed_left_s"].as_f64() > Some(3000.0));
    wait_for("the next run", || (service.state()["last"]["name"] == "short").then_some(()));
    assert_eq!(service.state()["last"]["outcome"], "completed", "{}", service.state());
    assert_eq!(local(&["disarm"])["state"], "idle");
}

#[test]
fn a_run_that_can_not_begin_is_said_and_nothing_follows_it() {
    let service = Service::start(&["--control"]);
    service.done("/queue", "{\"profile\": \"long\"}");
    // The folder for its recording is a file.
    std::fs::write(service.data(), "no folder").expect("a temporary folder");
    service.done("/arm", "{}");
    let state = service.wait_state("idle");
    assert_eq!(state["last"]["outcome"], "failed", "{state}");
    assert!(state["last"]["text"].as_str().expect("words").contains("folder"), "{state}");
}
