//! Every way in which `bench serve` ends: its run stops, with zeroed outputs and a closed recording. Signs of life for a service manager.

mod serve_client;

use rt_core::flags;
use serve_client::{Service, samples, wait_for};
use std::os::unix::net::UnixDatagram;
use std::time::Duration;

/// The recording of a run that was stopped: closed, whole, at 0 V.
fn assert_stopped(service: &Service) {
    let file = service.recording();
    let recorded = samples(&file);
    let last = recorded.last().expect("samples");
    assert!(last.last() && last.flags & flags::STOPPED != 0, "{last:?}");
    assert_eq!((last.voltage_v, last.tripped()), (0.0, false));
    assert!(recorded.iter().any(|sample| sample.voltage_v > 0.5), "it was driven before");
    assert!(recorded.windows(2).all(|pair| pair[1].sequence() == pair[0].sequence() + 1), "every sample is there");
    let part = file.with_extension("mcap.part");
    assert!(!part.exists(), "{}", part.display());
}

fn running() -> Service {
    let service = Service::start(&["--control"]);
    service.run("long");
    service.wait_time(0.8);
    service
}

#[test]
fn a_killed_service_leaves_a_stopped_run() {
    let mut service = running();
    service.signal(libc::SIGKILL);
    assert_eq!(service.ended().code(), None);
    assert_stopped(&service);
    // What the killed one left in shared memory keeps nobody from starting again, idle.
    let again = service.again(&["--control"]);
    assert_eq!(again.state()["service"]["state"], "idle");
    again.run("short");
    let last =
        wait_for("the end of a run after it", || Some(again.state()["last"].clone()).filter(|last| !last.is_null()));
    assert_eq!(last["outcome"], "completed", "{last}");
}

#[test]
fn a_service_that_is_told_to_end_stops_its_run_first() {
    let mut service = running();
    service.signal(libc::SIGTERM);
    assert_eq!(service.ended().code(), Some(130), "a run was cut short");
    // It waited: there is nothing left to wait for.
    let files = std::fs::read_dir(service.data()).expect("a folder").map(|file| file.expect("a file").path());
    // Beside it may stand what the flight recorder left of a wake-up that came late.
    let recordings: Vec<_> = files.filter(|path| path.extension().is_none_or(|end| end != "json")).collect();
    assert!(matches!(&recordings[..], [one] if one.extension().is_some_and(|end| end == "mcap")), "{recordings:?}");
    assert_stopped(&service);
    let file = service.path().join("rec-bench").join(format!("{}.token", service.instance));
    assert!(!file.exists(), "the token went with the service");
}

#[test]
fn a_run_that_is_killed_is_noticed_and_nothing_follows() {
    let service = running();
    service.done("/queue", "{\"profile\": \"short\"}");
    let id = service.child.id().to_string();
    let children = std::fs::read_to_string(format!("/proc/{id}/task/{id}/children")).expect("the kernel tells");
    let run: libc::pid_t = children.split_whitespace().next().expect("the run").parse().expect("a number");
    // SAFETY: a plain system call; the process is a child of the service, which waits for it only once it has ended.
    assert_eq!(unsafe { libc::kill(run, libc::SIGKILL) }, 0);
    let state = service.wait_state("idle");
    assert_eq!(state["last"]["outcome"], "failed", "{state}");
    assert_eq!(state["queue"][0]["profile"], "short", "held");
    wait_for("the view of the run to end", || (service.state()["run"]["ended"] == true).then_some(()));
}

#[test]
fn a_service_manager_hears_ready_alive_and_stopping() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).expect("a socket");
    socket.set_read_timeout(Some(Duration::from_secs(60))).expect("a socket");
    let hear = || {
        let mut message = [0; 4096];
        let length = socket.recv(&mut message).expect("a sign within a minute");
        String::from_utf8_lossy(&message[..length]).into_owned()
    };
    let mut service = Service::start_with(&["--control"], |command| {
        command.env("NOTIFY_SOCKET", &path).env("WATCHDOG_USEC", "400000").env_remove("WATCHDOG_PID");
    });
    let ready = hear();
    assert!(
        ready.starts_with("READY=1\n") && ready.contains(&format!("STATUS=listening on {}", service.address)),
        "{ready}"
    );
    assert_eq!(service.get("/state").0, 200, "ready is ready");
    // The run's own process must not speak for the service.
    service.run("long");
    service.wait_time(0.5);
    for _ in 0..5 {
        assert_eq!(hear(), "WATCHDOG=1\n");
    }
    service.signal(libc::SIGTERM);
    wait_for("the word that it stops", || (hear() == "STOPPING=1\n").then_some(()));
    assert_eq!(service.ended().code(), Some(130));
    assert_stopped(&service);
}
