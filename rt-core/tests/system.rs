//! What the report says holds in the kernel, seen through /proc; with rights or without. Works for root and for anybody.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

use rt_core::system::{Grant, Outcome, Report, Request, prepare_process, prepare_thread};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::{CapabilitySet, CapabilitySets, set_capabilities};
use std::collections::BTreeSet;
use std::fs::read_to_string;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;

/// Memory and limits belong to the process, which the tests of this file share.
static PROCESS: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    PROCESS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Each test prepares a thread of its own and lets it end.
fn in_a_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    thread::scope(|scope| scope.spawn(work).join().unwrap())
}

fn wish<'a>(grants: &'a [Grant], what: &str) -> &'a Grant {
    grants.iter().find(|grant| grant.what == what).unwrap()
}

fn remedy(grant: &Grant) -> &str {
    match &grant.outcome {
        Outcome::Refused { remedy, .. } => remedy,
        other => panic!("expected a refusal of {}, got {other:?}", grant.what),
    }
}

/// Real-time priority and policy (1 = SCHED_FIFO) of the calling thread: fields 40 and 41 of proc_pid_stat(5).
fn priority_and_policy() -> (u32, u32) {
    let stat = read_to_string("/proc/thread-self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect(); // from field 3 on
    (fields[37].parse().unwrap(), fields[38].parse().unwrap())
}

fn status(file: &str, key: &str) -> String {
    let text = read_to_string(file).unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix(key)).unwrap();
    line.trim_start_matches(':').trim().to_owned()
}

/// First CPU that this thread may run on.
fn first_cpu() -> usize {
    let list = status("/proc/thread-self/status", "Cpus_allowed_list");
    list.split([',', '-']).next().unwrap().parse().unwrap()
}

fn locked_kib() -> u64 {
    status("/proc/self/status", "VmLck").trim_end_matches(" kB").parse().unwrap()
}

#[test]
fn the_priority_reported_is_the_one_in_force() {
    let (grant, (priority, policy)) = in_a_thread(|| {
        let grants = prepare_thread(&Request { priority: 7, ..Request::default() });
        (wish(&grants, "sched").clone(), priority_and_policy())
    });
    match &grant.outcome {
        Outcome::Granted(text) => {
            assert_eq!(text, "SCHED_FIFO 7");
            assert_eq!((priority, policy), (7, 1));
        }
        Outcome::Refused { remedy, .. } => {
            assert!(remedy.contains("rtprio 99") || remedy.contains("control group"), "{grant}");
            assert_eq!(policy, 0);
        }
        Outcome::Absent(_) => panic!("it was asked for: {grant}"),
    }
}

#[test]
fn a_priority_that_is_none_is_refused() {
    for priority in [0, 100, 255] {
        let (grants, (_, policy)) =
            in_a_thread(|| (prepare_thread(&Request { priority, ..Request::default() }), priority_and_policy()));
        let grant = wish(&grants, "sched");
        assert!(!remedy(grant).is_empty() && grant.to_string().contains("1..=99"), "{grant}");
        assert_eq!(policy, 0);
    }
}

#[test]
fn the_cpus_reported_are_those_in_force() {
    let one = first_cpu();
    let (grants, allowed) = in_a_thread(|| {
        let grants = prepare_thread(&Request { cpus: Some(vec![one, one]), ..Request::default() });
        (grants, status("/proc/thread-self/status", "Cpus_allowed_list"))
    });
    assert_eq!(wish(&grants, "affinity").outcome, Outcome::Granted(format!("CPUs [{one}]")));
    assert_eq!(allowed, one.to_string());
}

#[test]
fn cpus_that_are_none_or_do_not_exist_are_refused() {
    let one = first_cpu();
    for cpus in [vec![], vec![usize::MAX], vec![1023], vec![one, 1023]] {
        let grants = in_a_thread(|| prepare_thread(&Request { cpus: Some(cpus.clone()), ..Request::default() }));
        let grant = wish(&grants, "affinity");
        assert!(remedy(grant).contains(&format!("{one}")), "{cpus:?}: {grant}");
    }
}

#[test]
fn a_prepared_thread_can_be_prepared_again() {
    in_a_thread(|| {
        let first = prepare_thread(&Request::default());
        let again = prepare_thread(&Request::default());
        let refused = |grants: &[Grant]| grants.iter().map(Grant::is_refused).collect::<Vec<_>>();
        assert_eq!(refused(&first), refused(&again));
        assert!(!wish(&again, "timer_slack").is_refused() && !wish(&again, "stack").is_refused(), "{again:?}");
    });
}

#[test]
fn memory_is_locked_while_the_guard_lives_and_no_longer() {
    let _alone = alone();
    let before = locked_kib();
    let (guard, report) = prepare_process(&Request::default());
    let held = locked_kib();
    let grant = wish(report.grants(), "memory");
    match &grant.outcome {
        Outcome::Granted(text) => assert!(held > before, "{text}, but {held} KiB are locked, {before} were before"),
        Outcome::Refused { remedy, .. } => {
            assert!(remedy.contains("memlock unlimited"), "{grant}");
            assert_eq!(held, before);
        }
        Outcome::Absent(_) => panic!("it was asked for: {grant}"),
    }
    assert!(!wish(report.grants(), "heap").is_refused(), "{report}");
    drop(guard);
    assert_eq!(locked_kib(), 0);
}

#[test]
fn what_was_not_asked_for_is_not_done() {
    let _alone = alone();
    let (_guard, report) =
        prepare_process(&Request { lock_memory: false, latency_request: false, ..Request::default() });
    assert!(report.grants().iter().all(|grant| matches!(grant.outcome, Outcome::Absent(_))), "{report}");
    assert_eq!(locked_kib(), 0);
}

/// As an ordinary user on an ordinary system: every refusal comes with its remedy, nothing panics, and nothing is done
/// behind its back.
#[test]
fn without_rights_it_is_refused_with_the_remedy() {
    let _alone = alone();
    let limited = [(Resource::Memlock, 8 << 20), (Resource::Rtprio, 0)].map(|(resource, limit)| {
        let was = getrlimit(resource);
        // The smaller one: raising it would take the rights that this test is about.
        let current = Some(was.current.map_or(limit, |current| current.min(limit)));
        setrlimit(resource, Rlimit { current, maximum: was.maximum }).unwrap();
        (resource, was)
    });
    let (process, thread, locked, policy) = in_a_thread(|| {
        // Capabilities belong to the thread: they end with it.
        let none = CapabilitySet::empty();
        set_capabilities(None, CapabilitySets { effective: none, permitted: none, inheritable: none }).unwrap();
        let (_guard, process) = prepare_process(&Request::default());
        let thread = prepare_thread(&Request::default());
        (process, thread, locked_kib(), priority_and_policy())
    });
    for (resource, was) in limited {
        setrlimit(resource, was).unwrap();
    }

    let memory = remedy(wish(process.grants(), "memory"));
    for way in ["memlock unlimited", "LimitMEMLOCK=infinity", "setcap cap_sys_nice,cap_ipc_lock+ep"] {
        assert!(memory.contains(way), "{memory}");
    }
    let sched = remedy(wish(&thread, "sched"));
    for way in ["rtprio 99", "LimitRTPRIO=99", "setcap cap_sys_nice,cap_ipc_lock+ep"] {
        assert!(sched.contains(way), "{sched}");
    }
    assert_eq!((locked, policy), (0, (0, 0)));
}

#[test]
fn each_wish_has_a_key_of_its_own_in_the_metadata() {
    let _alone = alone();
    let (_guard, process) = prepare_process(&Request::default());
    let thread = Report::new(in_a_thread(|| prepare_thread(&Request::default())));
    let wishes: Vec<&Grant> = process.grants().iter().chain(thread.grants()).collect();
    let keys: BTreeSet<String> = process.notes().into_keys().chain(thread.notes().into_keys()).collect();
    assert_eq!(keys.len(), wishes.len());
    assert!(keys.contains("realtime.sched") && keys.contains("realtime.memory"), "{keys:?}");
    for (report, grants) in [(&process, process.grants()), (&thread, thread.grants())] {
        assert_eq!(report.to_string().lines().count(), grants.len());
    }
}
