//! What concerns one thread: where it runs, when it runs, its stack.

use super::faults::{PAGE_BYTES, fewest_faults_of};
use super::report::Grant;
use super::rights::{Limit, may};
use super::{Request, remedies};
use rustix::thread::{
    CapabilitySet, CpuSet, current_timer_slack, sched_getaffinity, sched_setaffinity, set_current_timer_slack,
};
use std::io;
use std::num::NonZeroU64;

/// Stack that is touched before the loop begins, bytes: several times what its deepest call takes.
const STACK_BYTES: usize = 256 << 10;

/// Prepares the calling thread. It must have 256 KiB of stack left: a thread of the standard library has 2 MiB.
///
/// The priority comes last: what comes before it may take its time.
pub fn prepare_thread(request: &Request) -> Vec<Grant> {
    vec![timer_slack(), affinity(request.cpus.as_deref()), prefault_stack(), fifo(request.priority)]
}

fn timer_slack() -> Grant {
    let refused =
        |cause: String| Grant::refused("timer_slack", cause, "let a sandbox (seccomp) permit prctl(PR_SET_TIMERSLACK)");
    if let Err(e) = set_current_timer_slack(NonZeroU64::new(1)) {
        return refused(format!("prctl: {}", io::Error::from(e)));
    }
    match current_timer_slack() {
        // 0: the thread is SCHED_FIFO already, which knows no slack.
        Ok(slack_ns @ 0..=1) => Grant::granted("timer_slack", format!("{slack_ns} ns")),
        Ok(slack_ns) => refused(format!("1 ns was set, {slack_ns} ns holds")),
        Err(e) => refused(format!("reading back: {}", io::Error::from(e))),
    }
}

fn affinity(cpus: Option<&[usize]>) -> Grant {
    let allowed = || sched_getaffinity(None).map(|set| members(&set)).unwrap_or_default();
    let Some(cpus) = cpus else {
        return Grant::absent("affinity", format!("not asked for, CPUs {:?}", allowed()));
    };
    let mut wanted = cpus.to_vec();
    wanted.sort_unstable();
    wanted.dedup();
    let refused = |cause: String| {
        let remedy = format!("name at least one CPU out of {:?}, or widen the control group's cpuset", allowed());
        Grant::refused("affinity", cause, remedy)
    };
    if wanted.is_empty() {
        return refused("an empty list of CPUs".to_owned());
    }
    if let Some(beyond) = wanted.iter().find(|&&cpu| cpu >= CpuSet::MAX_CPU) {
        return refused(format!("CPU {beyond}: expected 0..{}", CpuSet::MAX_CPU));
    }
    let mut set = CpuSet::new();
    wanted.iter().for_each(|&cpu| set.set(cpu));
    if let Err(e) = sched_setaffinity(None, &set) {
        return refused(format!("CPUs {wanted:?}: {}", io::Error::from(e)));
    }
    // The kernel silently leaves out what does not exist or is not in the control group's set.
    match sched_getaffinity(None).map(|set| members(&set)) {
        Ok(got) if got == wanted => Grant::granted("affinity", format!("CPUs {got:?}")),
        Ok(got) => refused(format!("CPUs {wanted:?} were asked for, {got:?} granted")),
        Err(e) => refused(format!("reading back: {}", io::Error::from(e))),
    }
}

fn members(set: &CpuSet) -> Vec<usize> {
    (0..CpuSet::MAX_CPU).filter(|&cpu| set.is_set(cpu)).collect()
}

fn prefault_stack() -> Grant {
    touch_stack();
    let size = STACK_BYTES >> 10;
    match fewest_faults_of(touch_stack) {
        0 => Grant::granted("stack", format!("{size} KiB touched")),
        // Seen only when the system reclaims memory at this very moment: it is scarce.
        faults => Grant::refused(
            "stack",
            format!("{size} KiB touched cost {faults} page faults when touched again"),
            "free memory, or let the memory be locked",
        ),
    }
}

/// Not inlined: its frame is to lie below the caller's, where the loop's calls will be.
#[inline(never)]
fn touch_stack() {
    let mut frame = [0_u8; STACK_BYTES];
    for byte in frame.iter_mut().step_by(PAGE_BYTES) {
        *std::hint::black_box(byte) = 1;
    }
    std::hint::black_box(&mut frame); // or the frame could be left out
}

fn fifo(priority: u8) -> Grant {
    if !(1..=99).contains(&priority) {
        let cause = format!("priority {priority}: expected 1..=99");
        return Grant::refused("sched", cause, format!("choose one of them; {} is a good one", Request::PRIORITY));
    }
    let outcome = set_fifo(priority).and_then(|()| policy());
    match outcome {
        Ok(Policy { fifo: true, priority: got }) if got == i32::from(priority) => {
            Grant::granted("sched", format!("SCHED_FIFO {got}"))
        }
        Ok(got) => Grant::refused(
            "sched",
            format!("SCHED_FIFO {priority} was set, but {got:?} holds"),
            "end the service that resets priorities (rtkit, uresourced, a container's runtime)",
        ),
        Err(e) => {
            let (limit, capable) = (Limit::priority(), may(CapabilitySet::SYS_NICE));
            let permitted = capable || limit.0.is_none_or(|limit| limit >= u64::from(priority));
            let rights = if capable { "with CAP_SYS_NICE" } else { "without CAP_SYS_NICE" };
            Grant::refused(
                "sched",
                format!("SCHED_FIFO {priority}: {e}; highest permitted priority {limit}, {rights}"),
                if permitted { remedies::CONTROL_GROUP } else { remedies::PRIORITY },
            )
        }
    }
}

/// How the kernel schedules the calling thread.
#[derive(Debug)]
struct Policy {
    fifo: bool,
    priority: i32,
}

// System calls by number: rustix has none of the scheduler's policies, and musl's functions of these names do nothing.

fn set_fifo(priority: u8) -> io::Result<()> {
    let parameter = scheduling_parameter(i32::from(priority));
    // SAFETY: 0 = the calling thread; the pointer is valid for the read of a sched_param.
    checked(unsafe { libc::syscall(libc::SYS_sched_setscheduler, 0, libc::SCHED_FIFO, &raw const parameter) }).map(drop)
}

fn policy() -> io::Result<Policy> {
    let mut parameter = scheduling_parameter(0);
    // SAFETY: 0 = the calling thread; no memory is touched.
    let policy = checked(unsafe { libc::syscall(libc::SYS_sched_getscheduler, 0) })?;
    // SAFETY: 0 = the calling thread; the pointer is valid for the write of a sched_param.
    checked(unsafe { libc::syscall(libc::SYS_sched_getparam, 0, &raw mut parameter) })?;
    Ok(Policy { fifo: policy == libc::c_long::from(libc::SCHED_FIFO), priority: parameter.sched_priority })
}

fn scheduling_parameter(sched_priority: i32) -> libc::sched_param {
    // SAFETY: all zero bits are a valid value of its integers; musl's has more fields than the one that counts.
    let mut parameter: libc::sched_param = unsafe { std::mem::zeroed() };
    parameter.sched_priority = sched_priority;
    parameter
}

fn checked(returned: libc::c_long) -> io::Result<libc::c_long> {
    if returned < 0 { Err(io::Error::last_os_error()) } else { Ok(returned) }
}
