//! Page faults of the calling thread: whether memory that was touched before stays is seen by touching it again.

use std::mem::MaybeUninit;

/// Size of the smallest page on the systems that Linux runs on: a larger one is merely touched more than once.
pub(super) const PAGE_BYTES: usize = 4096;

/// Page faults of the calling thread that needed no disk while `work` ran; the fewest of three goes, since another thread or
/// the system's own housekeeping may take a page in between, but not each time.
pub(super) fn fewest_faults_of(mut work: impl FnMut()) -> u64 {
    let mut one_go = || {
        let before = faults_so_far();
        work();
        faults_so_far().saturating_sub(before)
    };
    one_go().min(one_go()).min(one_go())
}

fn faults_so_far() -> u64 {
    let mut usage = MaybeUninit::<libc::rusage>::zeroed();
    // SAFETY: the pointer is valid for the write of one rusage, and all zero bits, which stay where the call fails, are a
    // valid value of its integers. rustix has no getrusage.
    let usage = unsafe {
        libc::getrusage(libc::RUSAGE_THREAD, usage.as_mut_ptr());
        usage.assume_init()
    };
    u64::try_from(usage.ru_minflt).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::mm::{MapFlags, ProtFlags, mmap_anonymous, munmap};

    /// The check behind "it stays touched" must be able to fail: fresh pages fault, each time.
    #[test]
    fn fresh_pages_fault_and_those_at_hand_do_not() {
        const BYTES: usize = 8 * PAGE_BYTES;
        let fresh = fewest_faults_of(|| {
            // SAFETY: a new private mapping, written within its bounds and given back before anybody else knows of it.
            unsafe {
                let start =
                    mmap_anonymous(std::ptr::null_mut(), BYTES, ProtFlags::READ | ProtFlags::WRITE, MapFlags::PRIVATE)
                        .unwrap();
                (0..BYTES).step_by(PAGE_BYTES).for_each(|at| start.cast::<u8>().add(at).write_volatile(1));
                munmap(start, BYTES).unwrap();
            }
        });
        assert!(fresh >= 1);
        let mut at_hand = vec![0_u8; BYTES];
        assert_eq!(fewest_faults_of(|| std::hint::black_box(&mut at_hand).fill(1)), 0);
    }
}
