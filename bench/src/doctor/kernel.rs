//! The kernel: how soon it lets a thread run that has become ready, and by what clock.

use super::{Root, Surroundings, Verdict};
use std::fmt;

const REAL_TIME_KERNEL: &str = "for a bound on lateness install a PREEMPT_RT kernel (Debian: linux-image-rt-amd64; Fedora, RHEL: \
     kernel-rt; Ubuntu: the real-time kernel)";
const BOOT_FULL: &str = "boot with preempt=full (`echo full > /sys/kernel/debug/sched/preempt` until then)";

/// When the kernel interrupts itself in favour of a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Preemption {
    RealTime,
    Full,
    Lazy,
    Voluntary,
    None,
    /// Voluntary or none: the kernel does not tell.
    Little,
}

impl Preemption {
    fn named(name: &str) -> Option<Self> {
        match name {
            "full" => Some(Preemption::Full),
            "lazy" => Some(Preemption::Lazy),
            "voluntary" => Some(Preemption::Voluntary),
            "none" => Some(Preemption::None),
            _ => None,
        }
    }
}

impl fmt::Display for Preemption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Preemption::RealTime => "real-time (PREEMPT_RT)",
            Preemption::Full => "full",
            Preemption::Lazy => "lazy",
            Preemption::Voluntary => "voluntary",
            Preemption::None => "none",
            Preemption::Little => "voluntary or none",
        })
    }
}

/// The preemption model in force. A dynamic kernel was built with one and may have been booted with another.
pub(super) fn preemption(surroundings: &Surroundings) -> Verdict {
    let root = &surroundings.root;
    let Some(version) = root.text("/proc/sys/kernel/version") else {
        return Verdict::absent("/proc/sys/kernel/version can't be read", "judge the kernel by `bench latency`");
    };
    let dynamic = version.contains("PREEMPT_DYNAMIC");
    let model = if root.number("/sys/kernel/realtime") == Some(1)
        || version.contains("PREEMPT_RT")
        || version.contains("PREEMPT RT")
    {
        Preemption::RealTime
    } else if dynamic {
        chosen_at_run_time(root).or_else(|| built_in(root)).unwrap_or(Preemption::Little)
    } else {
        let assumed = if version.contains("PREEMPT") { Preemption::Full } else { Preemption::Little };
        built_in(root).unwrap_or(assumed)
    };
    let release = root.text("/proc/sys/kernel/osrelease").unwrap_or_default();
    let kind = if dynamic { ", changeable" } else { "" };
    let found = format!("{release} preemption {model}{kind}").trim().to_owned();
    match model {
        Preemption::RealTime => Verdict::ok(found),
        Preemption::Full => Verdict::advice(found, REAL_TIME_KERNEL),
        Preemption::Lazy | Preemption::Voluntary | Preemption::Little if dynamic => {
            Verdict::advice(found, format!("{BOOT_FULL}; {REAL_TIME_KERNEL}"))
        }
        Preemption::Lazy | Preemption::Voluntary | Preemption::Little => Verdict::advice(found, REAL_TIME_KERNEL),
        Preemption::None if dynamic => Verdict::problem(found, format!("{BOOT_FULL}; {REAL_TIME_KERNEL}")),
        Preemption::None => Verdict::problem(found, REAL_TIME_KERNEL),
    }
}

/// `none voluntary (full) lazy` in debugfs, which root alone can read; otherwise the last one on the command line counts.
fn chosen_at_run_time(root: &Root) -> Option<Preemption> {
    if let Some(text) = root.text("/sys/kernel/debug/sched/preempt") {
        let (_, rest) = text.split_once('(')?;
        return Preemption::named(rest.split_once(')')?.0);
    }
    let line = root.text("/proc/cmdline")?;
    line.split_whitespace().filter_map(|word| Preemption::named(word.strip_prefix("preempt=")?)).next_back()
}

fn built_in(root: &Root) -> Option<Preemption> {
    let configuration = configuration(root)?;
    let set = |option: &str| configuration.lines().any(|line| line.strip_prefix(option) == Some("=y"));
    [
        ("CONFIG_PREEMPT_RT", Preemption::RealTime),
        ("CONFIG_PREEMPT_LAZY", Preemption::Lazy),
        ("CONFIG_PREEMPT", Preemption::Full),
        ("CONFIG_PREEMPT_VOLUNTARY", Preemption::Voluntary),
        ("CONFIG_PREEMPT_NONE", Preemption::None),
    ]
    .into_iter()
    .find_map(|(option, model)| set(option).then_some(model))
}

/// The configuration that the kernel was built with, where it tells.
pub(super) fn configuration(root: &Root) -> Option<String> {
    root.unpacked("/proc/config.gz")
        .or_else(|| root.text(format!("/boot/config-{}", root.text("/proc/sys/kernel/osrelease")?)))
}

/// Without high-resolution timers a wake-up waits for the next jiffy.
pub(super) fn timer_resolution(surroundings: &Surroundings) -> Verdict {
    match surroundings.timer_resolution_ns {
        step_ns @ 0..=1_000 => Verdict::ok(format!("step of {step_ns} ns")),
        step_ns => Verdict::problem(
            format!("step of {step_ns} ns: the loop's period is 1000000 ns"),
            "boot without highres=off and nohpet, with a kernel that has CONFIG_HIGH_RES_TIMERS=y",
        ),
    }
}

/// Which counter the clock is read from. The loop reads it some ten times a tick.
pub(super) fn clock_source(surroundings: &Surroundings) -> Verdict {
    const FOLDER: &str = "/sys/devices/system/clocksource/clocksource0";
    let Some(current) = surroundings.root.text(format!("{FOLDER}/current_clocksource")) else {
        return Verdict::absent(
            "the kernel names none",
            "judge it by `bench latency`: tick_us is 1..5 with a good one",
        );
    };
    let others = surroundings.root.text(format!("{FOLDER}/available_clocksource")).unwrap_or_default();
    let tsc = others.split_whitespace().any(|other| other == "tsc");
    let remedy = if tsc {
        "boot with clocksource=tsc tsc=reliable if the CPU's TSC is constant (`grep constant_tsc /proc/cpuinfo`)"
    } else {
        "see `dmesg | grep -i tsc` why the TSC was given up: firmware settings, or the hypervisor's CPU model"
    };
    match current.as_str() {
        "tsc"
        | "kvm-clock"
        | "hyperv_clocksource_tsc_page"
        | "xen"
        | "arch_sys_counter"
        | "riscv_clocksource"
        | "timebase" => Verdict::ok(current),
        "jiffies" | "refined-jiffies" => Verdict::problem(format!("{current}: it steps by milliseconds"), remedy),
        _ => Verdict::advice(format!("{current}: each reading may be a system call or a slow bus access"), remedy),
    }
}

/// The share of time that real-time threads may take altogether.
pub(super) fn throttling(surroundings: &Surroundings) -> Verdict {
    let read = |name: &str| surroundings.root.number(format!("/proc/sys/kernel/sched_rt_{name}_us"));
    let (Some(runtime_us), Some(period_us)) = (read("runtime"), read("period")) else {
        return Verdict::absent(
            "this kernel has none",
            "nothing to do; a runaway real-time thread would not be stopped",
        );
    };
    let found = format!("{runtime_us} us of each {period_us} us");
    let remedy = "`sysctl kernel.sched_rt_runtime_us=950000 kernel.sched_rt_period_us=1000000` (the kernel's defaults)";
    match runtime_us {
        ..0 => Verdict::ok("off"),
        // The loop needs a few per cent of a CPU; what is left over keeps the machine usable should it run away.
        _ if runtime_us.saturating_mul(10) >= period_us.saturating_mul(9) => Verdict::ok(found),
        _ if runtime_us.saturating_mul(2) >= period_us => Verdict::advice(found, remedy),
        _ => Verdict::problem(found, remedy),
    }
}

/// A hypervisor may stop the whole machine for milliseconds; nothing in the guest can see or prevent it.
pub(super) fn virtual_machine(surroundings: &Surroundings) -> Verdict {
    let root = &surroundings.root;
    let cpuinfo = root.text("/proc/cpuinfo").unwrap_or_default();
    let flagged = cpuinfo
        .lines()
        .filter(|line| line.starts_with("flags"))
        .any(|line| line.split_whitespace().any(|flag| flag == "hypervisor"));
    let kind = root.text("/sys/hypervisor/type").or_else(|| root.text("/proc/device-tree/hypervisor/compatible"));
    if !flagged && kind.is_none() {
        return if cpuinfo.is_empty() {
            Verdict::absent("/proc/cpuinfo can't be read", "judge the machine by `bench latency`")
        } else {
            Verdict::ok("no hypervisor seen")
        };
    }
    let maker = kind.or_else(|| root.text("/sys/class/dmi/id/sys_vendor")).map(|name| format!(" ({name})"));
    Verdict::advice(
        format!("runs in one{}: the host may stall it for milliseconds", maker.unwrap_or_default()),
        "drive a real rig from a machine of its own; otherwise give the guest CPUs of the host for itself (vcpupin, isolcpus) and \
         judge by medians, not by maxima",
    )
}
