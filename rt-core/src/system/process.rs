//! What concerns the process as a whole: its memory, and how deeply the CPUs may sleep.

use super::faults::{PAGE_BYTES, fewest_faults_of};
use super::report::{Grant, Report};
use super::rights::{Limit, may};
use super::{Request, remedies};
use rustix::mm::{MlockAllFlags, mlockall, munlockall};
use rustix::thread::CapabilitySet;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Heap that is touched once and kept, bytes: more than the bench allocates from a run's start to its end.
const HEAP_BYTES: usize = 16 << 20;
/// Page faults at the second touch that are no sign of memory given back: something else on the same stack or page table.
const STRAY_FAULTS: u64 = 4;
const CPU_LATENCY: &str = "/dev/cpu_dma_latency";
const NOT_ASKED: &str = "not asked for";

/// Holds what was granted to the process; dropping it gives the latency request and the locked memory back. What the
/// allocator was told stays. One per process at a time: the second one's end would unlock the first one's memory.
#[derive(Debug)]
pub struct ProcessGuard {
    /// The request holds as long as the file is open.
    _cpu_latency: Option<File>,
    locked: bool,
}

impl Drop for ProcessGuard {
    fn drop(&mut self) {
        if self.locked {
            // A failure leaves memory locked, which harms nobody and ends with the process.
            let _ = munlockall();
        }
    }
}

/// Prepares the process: call it before the loop's threads are started, so that their stacks are locked from the beginning.
///
/// Takes some milliseconds and as much memory as the process has mapped. The guard must live as long as the loop.
pub fn prepare_process(request: &Request) -> (ProcessGuard, Report) {
    let (memory, locked) = match request.lock_memory {
        true => lock_memory(Limit::locked_memory(), may(CapabilitySet::IPC_LOCK)),
        false => (Grant::absent("memory", NOT_ASKED), false),
    };
    let heap = match request.lock_memory {
        true => keep_heap(),
        false => Grant::absent("heap", NOT_ASKED),
    };
    let (cpu_latency, held) = match request.latency_request {
        true => request_cpu_latency(Path::new(CPU_LATENCY)),
        false => (Grant::absent("cpu_latency", NOT_ASKED), None),
    };
    (ProcessGuard { _cpu_latency: held, locked }, Report::new(vec![memory, heap, cpu_latency]))
}

/// With a limit, locking today's memory may succeed and an allocation in the middle of the run fail: better refused here.
fn lock_memory(limit: Limit, capable: bool) -> (Grant, bool) {
    let refused = |cause: String| (Grant::refused("memory", cause, remedies::MEMORY), false);
    if !limit.unlimited() && !capable {
        return refused(format!("at most {limit} bytes may be locked, and later allocations would fail beyond them"));
    }
    if let Err(e) = mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE) {
        return refused(format!("mlockall: {}", io::Error::from(e)));
    }
    match locked_kib() {
        Ok(kib) if kib > 0 => (Grant::granted("memory", format!("locked, {kib} KiB so far")), true),
        Ok(_) => refused("mlockall succeeded, but /proc/self/status shows no locked memory".to_owned()),
        // The call itself was granted; without /proc there is no second witness.
        Err(_) => (Grant::granted("memory", "locked"), true),
    }
}

/// Memory of this process that is locked now, KiB.
fn locked_kib() -> io::Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmLck:"));
    line.and_then(|rest| rest.split_whitespace().next()?.parse().ok())
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "/proc/self/status has no line `VmLck: N kB`"))
}

/// Tells the allocator to give nothing back, touches some heap, and sees whether it stays.
fn keep_heap() -> Grant {
    if !keep_freed_memory() {
        return Grant::absent("heap", "the C library's allocator can't be told to keep freed memory");
    }
    let touch = || {
        let mut heap = Vec::<u8>::new();
        // A failure shows below: what was never allocated is not there at the second touch either.
        let outcome = heap.try_reserve_exact(HEAP_BYTES);
        for byte in heap.spare_capacity_mut().iter_mut().step_by(PAGE_BYTES) {
            byte.write(1);
        }
        std::hint::black_box(&mut heap); // or the writes could be left out
        outcome
    };
    let size = HEAP_BYTES >> 20;
    if touch().is_err() {
        let cause = format!("{size} MiB can't be allocated");
        return Grant::refused("heap", cause, "free memory, or raise the limit of the address space (`ulimit -v`)");
    }
    match fewest_faults_of(|| drop(touch())) {
        faults if faults <= STRAY_FAULTS => Grant::granted("heap", format!("{size} MiB touched, freed memory is kept")),
        faults => Grant::refused(
            "heap",
            format!("{size} MiB touched and freed cost {faults} page faults when touched again"),
            "unset GLIBC_TUNABLES and MALLOC_ variables of the environment, and preload no other allocator",
        ),
    }
}

/// Whether the allocator knows these settings and took them.
#[cfg(target_env = "gnu")]
fn keep_freed_memory() -> bool {
    // SAFETY: mallopt reads two integers and takes the allocator's own lock. -1 = never trim (mallopt(3)); no blocks of their
    // own mapping, which would go back to the system on free. rustix leaves the allocator to the C library.
    unsafe { libc::mallopt(libc::M_TRIM_THRESHOLD, -1) == 1 && libc::mallopt(libc::M_MMAP_MAX, 0) == 1 }
}

#[cfg(not(target_env = "gnu"))]
fn keep_freed_memory() -> bool {
    false
}

/// Asks that no CPU sleep so deeply that waking it takes more than 0 us, for as long as the file is open
/// (Documentation/power/pm_qos_interface.rst of the kernel: a native 32-bit integer, us).
fn request_cpu_latency(path: &Path) -> (Grant, Option<File>) {
    let refused = |cause: String| (Grant::refused("cpu_latency", cause, remedies::CPU_LATENCY), None);
    let failed = |doing: &str, e: io::Error| refused(format!("{doing} {}: {e}", path.display()));
    let mut file = match OpenOptions::new().read(true).write(true).open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            return (Grant::absent("cpu_latency", format!("this kernel has no {}", path.display())), None);
        }
        Err(e) => return failed("opening", e),
    };
    if let Err(e) = file.write_all(&0_i32.to_ne_bytes()) {
        return failed("writing", e);
    }
    // Reading gives the smallest of all requests of the system.
    let mut in_force = [0; 4];
    match file.read_exact_at(&mut in_force, 0).map(|()| i32::from_ne_bytes(in_force)) {
        Ok(0) => (Grant::granted("cpu_latency", "0 us, held"), Some(file)),
        Ok(other) => refused(format!("0 us was written, {other} us is in force")),
        Err(e) => failed("reading back", e),
    }
}

#[cfg(test)]
mod tests {
    use super::super::report::Outcome;
    use super::*;

    fn cause_and_remedy(grant: &Grant) -> (&str, &str) {
        match &grant.outcome {
            Outcome::Refused { cause, remedy } => (cause, remedy),
            other => panic!("expected a refusal, got {other:?}"),
        }
    }

    #[test]
    fn a_limit_without_the_capability_is_refused_before_anything_is_locked() {
        let (grant, locked) = lock_memory(Limit(Some(8 << 20)), false);
        assert!(!locked);
        let (cause, remedy) = cause_and_remedy(&grant);
        assert!(cause.contains("8388608 bytes"), "{cause}");
        assert!(remedy.contains("memlock unlimited") && remedy.contains("LimitMEMLOCK=infinity"), "{remedy}");
    }

    #[test]
    fn a_system_without_the_latency_device_is_no_refusal() {
        let (grant, file) = request_cpu_latency(Path::new("/nowhere/cpu_dma_latency"));
        assert!(matches!(grant.outcome, Outcome::Absent(_)), "{grant}");
        assert!(file.is_none());
    }

    /// A device that takes the request and does not act on it must not count as granted: /dev/zero agrees by chance,
    /// /dev/full refuses the write, /dev/null has nothing to read back.
    #[test]
    fn a_latency_request_is_read_back() {
        let (grant, file) = request_cpu_latency(Path::new("/dev/zero"));
        assert!(matches!(grant.outcome, Outcome::Granted(_)) && file.is_some(), "{grant}");
        for (device, doing) in [("/dev/full", "writing"), ("/dev/null", "reading back"), ("/dev", "opening")] {
            let (grant, file) = request_cpu_latency(Path::new(device));
            let (cause, remedy) = cause_and_remedy(&grant);
            assert!(cause.starts_with(doing) && remedy.contains("udev"), "{grant}");
            assert!(file.is_none());
        }
    }
}
