//! Room for the recordings and for the shared memory.

use super::{Space, Surroundings, Verdict};
use rt_core::Sample;
use rt_core::link::{BUFFER_SAMPLES, MAX_SUBSCRIBERS};
use rt_core::transport::{Foreign, REMEDY};

/// What a recording takes, MB a minute, as measured with 20 channels at 1 kHz.
pub const MB_A_MINUTE: f64 = 8.1;
/// Below this the next run may not end.
const FEW_MINUTES: f64 = 15.0;
/// A day at the rig.
const MANY_MINUTES: f64 = 480.0;
/// Shared memory of one instance, bytes: the buffers of its subscribers, and half as much for what is beside them.
const INSTANCE_BYTES: u64 = (BUFFER_SAMPLES * MAX_SUBSCRIBERS * size_of::<Sample>()) as u64 * 3 / 2;

/// Minutes of recording that fit.
pub(super) fn disk(surroundings: &Surroundings) -> Verdict {
    let directory = surroundings.asked.directory.display();
    match surroundings.disk {
        Err(ref why) => Verdict::problem(why.as_str(), "name a directory for the recordings with --dir"),
        Ok(Space { writable: false, .. }) => Verdict::problem(
            format!("{directory} may not be written"),
            "name another directory with --dir, or make it yours (`chown -R USER DIR`)",
        ),
        Ok(Space { free_bytes, .. }) => {
            let minutes = free_bytes as f64 / (MB_A_MINUTE * 1e6);
            let found =
                format!("{:.1} GB free in {directory}: {minutes:.0} minutes of recording", free_bytes as f64 / 1e9);
            let remedy = "move old recordings away, or name another disk with --dir";
            match minutes {
                ..FEW_MINUTES => Verdict::problem(found, remedy),
                ..MANY_MINUTES => Verdict::advice(found, remedy),
                _ => Verdict::ok(found),
            }
        }
    }
}

/// /dev/shm, where the samples go to the subscribers.
pub(super) fn shared_memory(surroundings: &Surroundings) -> Verdict {
    let need = |instances: u64| instances * INSTANCE_BYTES;
    match surroundings.shared_memory {
        Err(ref why) => Verdict::problem(why.as_str(), "`mount -t tmpfs tmpfs /dev/shm`"),
        Ok(Space { writable: false, .. }) => Verdict::problem("/dev/shm may not be written", "`chmod 1777 /dev/shm`"),
        Ok(Space { free_bytes, .. }) => {
            let mib = |bytes: u64| bytes >> 20;
            let found = format!("{} MiB free, an instance takes {} MiB", mib(free_bytes), mib(INSTANCE_BYTES));
            let remedy = "`mount -o remount,size=512m /dev/shm` (in a container --shm-size=512m), and remove what dead programs left";
            if free_bytes < need(1) {
                Verdict::problem(found, remedy)
            } else if free_bytes < need(2) {
                Verdict::advice(found, remedy)
            } else {
                Verdict::ok(found)
            }
        }
    }
}

/// The folder in which programs find each other's shared memory: the first user's who ran one.
pub(super) fn transport(surroundings: &Surroundings) -> Verdict {
    match &surroundings.foreign {
        None => Verdict::ok("its folder is this user's to use"),
        Some(Foreign { folder, owner }) => {
            Verdict::problem(format!("{} is of {owner}, and this user may not use it", folder.display()), REMEDY)
        }
    }
}
