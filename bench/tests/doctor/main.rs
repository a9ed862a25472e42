//! `bench doctor`: each check on copies of what machines show, all of them on a machine that shows nothing, and the command.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

mod machine;

use bench::doctor::{CHECKS, Finding, Space, State, examine};
use machine::{CAN_UP, CLOCK, CPU, LATENCY_TIMER, Machine, POOR_LIMITS, packed, refused};
use rt_core::system::{Grant, Report, remedies};
use rt_core::transport::Foreign;
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

/// The promises that hold for every check, whatever the machine: a poor one here, one that shows nothing, a good one.
#[test]
fn every_check_has_a_name_of_its_own_and_a_remedy_unless_all_is_well() {
    let names: BTreeSet<&str> = CHECKS.iter().map(|check| check.name).collect();
    assert_eq!(names.len(), CHECKS.len());

    let (poor, poor_and_large) = (poor_machine("0"), poor_machine("0-7"));
    for machine in [&Machine::good(), &Machine::bare(), &poor, &poor_and_large] {
        let findings = examine(&machine.surroundings);
        assert_eq!(findings.len(), CHECKS.len());
        for Finding { name, state, found, remedy } in findings {
            assert!(!found.is_empty() && !found.contains('\n'), "{name}: {found:?}");
            assert_eq!(remedy.is_empty(), state == State::Ok, "{name} is {state}: {remedy:?}");
            assert!(!remedy.contains('\n'), "{name}: {remedy:?}");
        }
    }
    // A check that can't complain is none. (Too few CPUs and none of them isolated exclude each other.)
    for (small, large) in examine(&poor.surroundings).iter().zip(&examine(&poor_and_large.surroundings)) {
        assert!(small.state.max(large.state) > State::Ok, "{} finds nothing wrong with {:?}", small.name, small.found);
    }
}

#[test]
fn a_good_machine_passes() {
    for finding in examine(&Machine::good().surroundings) {
        assert_eq!(finding.state, State::Ok, "{finding:?}");
    }
}

/// Something wrong with everything; `online` CPUs.
fn poor_machine(online: &str) -> Machine {
    let no_room = Space { free_bytes: 1_000_000, writable: true };
    Machine::good()
        .with("/proc/sys/kernel/version", "#1 SMP Debian")
        .with("/proc/sys/kernel/sched_rt_runtime_us", "1000")
        .with("/proc/cpuinfo", "flags : fpu hypervisor")
        .with("/proc/swaps", "Filename Type Size\n/dev/sda2 partition 8")
        .with("/proc/self/limits", POOR_LIMITS)
        .with(&format!("{CLOCK}/current_clocksource"), "jiffies")
        .with(&format!("{CPU}/online"), online)
        .with(&format!("{CPU}/isolated"), "")
        .with(&format!("{CPU}/cpu0/cpufreq/scaling_governor"), "powersave")
        .without("/dev/cpu_dma_latency")
        .with(LATENCY_TIMER, "16")
        .but(|s| {
            s.timer_resolution_ns = 4_000_000;
            s.disk = Ok(no_room);
            s.shared_memory = Ok(no_room);
            s.foreign = Some(Foreign { folder: "/tmp/iceoryx2".into(), owner: "root".to_owned() });
            s.trial = Report::new(vec![refused("sched", "EPERM", remedies::PRIORITY)]);
            s.ip_links = s.ip_links.as_ref().map(|links| links.replace("ERROR-ACTIVE", "BUS-OFF"));
        })
}

#[test]
fn the_preemption_model_in_force() {
    let configuration =
        |lines: &str| packed(&format!("CONFIG_PREEMPT_DYNAMIC=y\n{lines}\n# CONFIG_PREEMPT_RT is not set\n"));
    let kernel = |version: &str| Machine::good().with("/proc/sys/kernel/version", version);
    let dynamic = || kernel("#1 SMP PREEMPT_DYNAMIC @0");

    kernel("#1 SMP PREEMPT_RT").says("kernel", State::Ok, &["6.12.6-rt", "PREEMPT_RT"]);
    kernel("#1 SMP PREEMPT RT 5.4").says("kernel", State::Ok, &[]);
    kernel("#1 SMP").with("/sys/kernel/realtime", "1").says("kernel", State::Ok, &[]);
    kernel("#1 SMP PREEMPT").says("kernel", State::Advice, &["preemption full", "linux-image-rt"]);
    kernel("#1 SMP").says("kernel", State::Advice, &["voluntary or none"]);
    let boot = "/boot/config-6.12.6-rt";
    kernel("#1 SMP").with(boot, "CONFIG_PREEMPT_NONE=y").says("kernel", State::Problem, &["preemption none"]);
    kernel("#1 SMP").with(boot, "CONFIG_PREEMPT_VOLUNTARY=y").says("kernel", State::Advice, &["preemption voluntary"]);

    // Chosen while it runs, then at boot, then when it was built: the first that is known counts.
    let debugfs = "/sys/kernel/debug/sched/preempt";
    let built = |line| dynamic().with_bytes("/proc/config.gz", &configuration(line));
    built("CONFIG_PREEMPT_NONE=y").says("kernel", State::Problem, &["none, changeable", "preempt=full"]);
    built("CONFIG_PREEMPT_LAZY=y").says("kernel", State::Advice, &["lazy, changeable", "preempt=full"]);
    built("CONFIG_PREEMPT=y").says("kernel", State::Advice, &["full, changeable", "linux-image-rt"]);
    let booted = || built("CONFIG_PREEMPT_NONE=y").with("/proc/cmdline", "quiet preempt=none preempt=voluntary ro");
    booted().says("kernel", State::Advice, &["voluntary, changeable"]);
    booted().with(debugfs, "none voluntary (full) lazy").says("kernel", State::Advice, &["full, changeable"]);
    dynamic().says("kernel", State::Advice, &["voluntary or none"]);
    dynamic().with_bytes("/proc/config.gz", b"no gzip").says("kernel", State::Advice, &["voluntary or none"]);
    Machine::bare().says("kernel", State::Absent, &["/proc/sys/kernel/version"]);
}

#[test]
fn clocks_and_timers() {
    let source = |name: &str| Machine::good().with(&format!("{CLOCK}/current_clocksource"), name);
    for good in ["tsc", "kvm-clock", "arch_sys_counter"] {
        source(good).says("clock source", State::Ok, &[good]);
    }
    source("hpet").says("clock source", State::Advice, &["hpet", "clocksource=tsc"]);
    source("acpi_pm").with(&format!("{CLOCK}/available_clocksource"), "hpet acpi_pm").says(
        "clock source",
        State::Advice,
        &["dmesg"],
    );
    source("jiffies").says("clock source", State::Problem, &["milliseconds"]);
    Machine::bare().says("clock source", State::Absent, &[]);
    let coarse = Machine::good().but(|s| s.timer_resolution_ns = 4_000_000);
    coarse.says("high-resolution timers", State::Problem, &["4000000 ns", "CONFIG_HIGH_RES_TIMERS"]);
}

#[test]
fn throttling_counts_from_half_a_share_on() {
    let runtime = |us: &str| Machine::good().with("/proc/sys/kernel/sched_rt_runtime_us", us);
    runtime("-1").says("real-time throttling", State::Ok, &["off"]);
    runtime("900000").says("real-time throttling", State::Ok, &[]);
    runtime("899999").says("real-time throttling", State::Advice, &["sched_rt_runtime_us=950000"]);
    runtime("499999").says("real-time throttling", State::Problem, &["499999 us of each 1000000 us"]);
    runtime("0").says("real-time throttling", State::Problem, &[]);
    runtime("none").says("real-time throttling", State::Absent, &[]);
}

#[test]
fn a_hypervisor_is_seen_by_its_flag_or_its_name() {
    Machine::good().with("/proc/cpuinfo", "flags : fpu hypervisor lahf_lm").says(
        "virtual machine",
        State::Advice,
        &["stall"],
    );
    Machine::good().with("/sys/hypervisor/type", "xen").says("virtual machine", State::Advice, &["(xen)"]);
    let arm = Machine::good().with_bytes("/proc/device-tree/hypervisor/compatible", b"linux,kvm\0");
    arm.says("virtual machine", State::Advice, &["(linux,kvm)"]);
    Machine::good().with("/proc/cpuinfo", "flags : hypervisors").says("virtual machine", State::Ok, &[]);
}

#[test]
fn cpus_that_can_be_spared_should_be() {
    let with = |online: &str, isolated: &str| {
        Machine::good().with(&format!("{CPU}/online"), online).with(&format!("{CPU}/isolated"), isolated)
    };
    with("0", "").says("CPUs", State::Advice, &["share"]);
    with("0-1", "").says("CPUs", State::Ok, &["2"]);
    with("0-1", "").says("isolated CPUs", State::Ok, &["none can be spared"]);
    with("0-3", "").says("isolated CPUs", State::Advice, &["none of 4", "isolcpus=managed_irq,domain,3", "--cpu 3"]);
    with("0-3", "2-3").says("isolated CPUs", State::Ok, &["2-3"]);
    with("nonsense", "").says("CPUs", State::Absent, &[]);
}

#[test]
fn one_cpu_with_another_governor_is_enough() {
    let second = format!("{CPU}/cpu1/cpufreq/scaling_governor");
    Machine::good().with(&second, "powersave").says("governor", State::Advice, &["performance, powersave", "cpupower"]);
    Machine::good().without(&format!("{CPU}/cpu0/cpufreq")).says("governor", State::Absent, &[]);
    // /sys/devices/system/cpu/cpufreq is no CPU.
    Machine::good().with(&format!("{CPU}/cpufreq/scaling_governor"), "powersave").says("governor", State::Ok, &[]);
}

#[test]
fn deep_sleep_matters_when_it_cant_be_forbidden() {
    let device = "/dev/cpu_dma_latency";
    Machine::good().says("idle states", State::Ok, &["C6, 133 us", "forbids"]);
    Machine::good().without(device).says("idle states", State::Advice, &["C6, 133 us", "max_cstate"]);
    let shallow =
        |path: &str, text: &str| Machine::good().without(device).with(&format!("{CPU}/cpu0/cpuidle/{path}"), text);
    shallow("state1/latency", "10").says("idle states", State::Ok, &["10 us"]);
    shallow("state1/disable", "1").says("idle states", State::Ok, &["POLL"]);
    // There, but not for this user: a directory can't be opened for writing even by root.
    // Worth asking for even where the kernel calls its sleep shallow: a hypervisor's may be deep.
    shallow("state1/latency", "10").with(&format!("{device}/x"), "").says("idle states", State::Advice, &["udev"]);
}

#[test]
fn rights_come_from_the_limit_or_the_capability() {
    let poor = || Machine::good().with("/proc/self/limits", POOR_LIMITS);
    poor().says("memory lock", State::Problem, &["8192 KiB", "memlock unlimited", "LimitMEMLOCK=infinity"]);
    poor().says("priority", State::Problem, &["none permitted", "rtprio 99", "LimitRTPRIO=99"]);
    let capable = |bits: &str| poor().with("/proc/self/status", &format!("CapInh:\t0\nCapEff:\t{bits}"));
    capable("0000000000004000").says("memory lock", State::Ok, &["CAP_IPC_LOCK"]);
    capable("0000000000004000").says("priority", State::Problem, &[]);
    capable("0000000000800000").says("priority", State::Ok, &["CAP_SYS_NICE"]);
    capable("0000000000800000").says("memory lock", State::Problem, &[]);
    let low = POOR_LIMITS.replace("priority     0 ", "priority     50");
    Machine::good().with("/proc/self/limits", &low).says("priority", State::Problem, &["up to 50", "80"]);
    Machine::bare().says("priority", State::Absent, &["trial"]);
}

#[test]
fn the_trial_tells_what_the_files_do_not() {
    let tried = |grants: Vec<Grant>| Machine::good().but(|s| s.trial = Report::new(grants));
    let group = refused("sched", "SCHED_FIFO 80: not permitted", remedies::CONTROL_GROUP);
    tried(vec![group]).says("trial", State::Problem, &["sched refused: SCHED_FIFO 80", "rt_group_sched=0"]);
    let latency = refused("cpu_latency", "opening", remedies::CPU_LATENCY);
    tried(vec![latency.clone()]).says("trial", State::Advice, &["see the check `idle states`"]);
    let memory = refused("memory", "limit", remedies::MEMORY);
    tried(vec![latency, memory]).says("trial", State::Problem, &["`idle states`; see the check `memory lock`"]);
    Machine::bare().says("trial", State::Absent, &[]);
}

#[test]
fn swap_is_named() {
    let swaps = "Filename Type Size Used Priority\n/swapfile file 2097148 0 -2\n/dev/zram0 partition 1 0 100";
    Machine::good().with("/proc/swaps", swaps).says("swap", State::Advice, &["/swapfile, /dev/zram0", "swapoff"]);
    Machine::bare().says("swap", State::Ok, &[]);
}

#[test]
fn latency_timers_of_serial_adapters() {
    let by_id = "/dev/serial/by-id/usb-FTDI-if00-port0";
    let linked = |machine: Machine| {
        fs::create_dir_all(machine.place("/dev/serial/by-id")).unwrap();
        symlink("../../ttyUSB0", machine.place(by_id)).unwrap();
        machine
    };
    let asked = |machine: Machine, path: &str| machine.but(|s| s.asked.serial = vec![path.into()]);
    let slow = || Machine::good().with(LATENCY_TIMER, "16");
    // Nobody said that the rig is on it: advice. The rig's own port: problem.
    slow().says("serial ports", State::Advice, &["ttyUSB0 holds data back for 16 ms", "echo 1 >"]);
    asked(slow(), "/dev/ttyUSB0").says("serial ports", State::Problem, &["16 ms", "udev"]);
    asked(linked(slow()), by_id).says("serial ports", State::Problem, &["ttyUSB0", "16 ms"]);
    asked(linked(Machine::good()), by_id).says("serial ports", State::Ok, &[by_id, "1 ms"]);
    asked(Machine::good(), "/dev/ttyACM7").says("serial ports", State::Problem, &["/dev/ttyACM7 does not exist"]);
    let modem = Machine::good().with("/dev/ttyACM0", "");
    asked(modem, "/dev/ttyACM0").says("serial ports", State::Ok, &["no latency timer"]);
    Machine::good().without("/sys/bus/usb-serial").says("serial ports", State::Absent, &["--serial"]);
}

#[test]
fn states_of_can_interfaces() {
    let in_state = |state: &str| Machine::good().but(|s| s.ip_links = Some(CAN_UP.replace("STATE", state)));
    in_state("ERROR-ACTIVE").says("CAN", State::Ok, &["can0 500000 bit/s, ERROR-ACTIVE", "sent 3 received 135"]);
    in_state("ERROR-PASSIVE").says("CAN", State::Advice, &["120 ohm"]);
    in_state("BUS-OFF").says("CAN", State::Problem, &["BUS-OFF", "ip link set can0 down"]);
    in_state("NEW-STATE").says("CAN", State::Advice, &["NEW-STATE"]);

    let asked = |machine: Machine, name: &str| machine.but(|s| s.asked.can = vec![name.to_owned()]);
    let virtual_one = Machine::good().with("/sys/class/net/vcan0/type", "280");
    asked(virtual_one, "vcan0").says("CAN", State::Ok, &["vcan0 up, virtual"]);
    // The worst of several counts, and each is named.
    let two = Machine::good().with("/sys/class/net/can1/type", "280");
    two.says("CAN", State::Problem, &["can0 500000 bit/s", "can1 is down", "bitrate 500000"]);
    asked(Machine::good(), "can7").says("CAN", State::Problem, &["can7 is no CAN interface", "modprobe vcan"]);
    asked(Machine::good(), "lo").says("CAN", State::Problem, &["lo is a network interface, and none of CAN", "can0"]);
    let without_restart = CAN_UP.replace("STATE", "ERROR-ACTIVE").replace("\"restart_ms\":100", "\"restart_ms\":0");
    Machine::good().but(|s| s.ip_links = Some(without_restart)).says(
        "CAN",
        State::Advice,
        &["ERROR-ACTIVE", "restart-ms 0", "restart-ms 100"],
    );
    let without = packed("# CONFIG_CAN is not set\n");
    let no_can = Machine::good().with_bytes("/proc/config.gz", &without);
    asked(no_can, "can7").says("CAN", State::Problem, &["built without CAN", "linux-image-amd64"]);
    let none = || Machine::good().without("/sys/class/net/can0");
    none().says("CAN", State::Absent, &["no interface"]);
    none().with_bytes("/proc/config.gz", &without).says("CAN", State::Absent, &["built without CAN"]);
}

#[test]
fn can_without_ip_or_with_another_one_is_said() {
    let told = |links: Option<&str>| {
        let links = links.map(str::to_owned);
        Machine::good().with("/sys/class/net/can0/operstate", "up").but(|s| s.ip_links = links)
    };
    told(None).says("CAN", State::Advice, &["can0 up", "iproute2"]);
    told(Some("Usage: ip link")).says("CAN", State::Advice, &["not understood"]);
    told(Some(r#"[{"ifname":"can0","flags":3}]"#)).says("CAN", State::Advice, &["does not describe"]);
    told(Some("[]")).says("CAN", State::Advice, &["does not describe"]);
}

#[test]
fn room_in_minutes_and_instances() {
    let disk = |space| Machine::good().but(|s| s.disk = space);
    let room = |free_bytes| Ok(Space { free_bytes, writable: true });
    disk(room(8_100_000 * 480)).says("disk", State::Ok, &["480 minutes", "/data"]);
    disk(room(8_100_000 * 479)).says("disk", State::Advice, &["479 minutes", "--dir"]);
    disk(room(8_100_000 * 14)).says("disk", State::Problem, &["14 minutes"]);
    disk(Ok(Space { free_bytes: u64::MAX, writable: false })).says("disk", State::Problem, &["may not be written"]);
    disk(Err("/data: gone".to_owned())).says("disk", State::Problem, &["gone"]);

    let shared = |space| Machine::good().but(|s| s.shared_memory = space);
    shared(room(64 << 20)).says("shared memory", State::Ok, &["64 MiB free"]);
    shared(room(32 << 20)).says("shared memory", State::Advice, &["remount"]);
    shared(room(16 << 20)).says("shared memory", State::Problem, &["--shm-size"]);
    shared(Err("none".to_owned())).says("shared memory", State::Problem, &["mount"]);
}

#[test]
fn a_transport_of_another_user_s_is_a_problem_that_names_him() {
    let foreign = |s: &mut bench::doctor::Surroundings| {
        s.foreign = Some(Foreign { folder: "/tmp/iceoryx2".into(), owner: "anna".to_owned() });
    };
    let words = ["/tmp/iceoryx2 is of anna", "root-path", "iceoryx2.toml"];
    Machine::good().but(foreign).says("transport", State::Problem, &words);
    Machine::good().says("transport", State::Ok, &[]);
}

/// The same as a user meets it. Only root can be another user for a moment.
#[test]
fn another_user_s_transport_is_told_by_whoever_needs_it() {
    if !rustix::process::geteuid().is_root() {
        return;
    }
    let nobody = |folder: &Path, arguments: &[&str]| {
        let mut command = Command::new(folder.join("bench"));
        command.args(arguments).current_dir(folder).uid(65534).gid(65534).env_remove("RUST_LOG");
        command.output().expect("it was copied to where everybody may run it")
    };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path();
    fs::copy(env!("CARGO_BIN_EXE_bench"), folder.join("bench")).unwrap();
    let rights = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
    rights(folder, 0o755);
    rights(&folder.join("bench"), 0o755);
    // As the transport leaves it where root came first, but in a place of this test's own.
    let transport = folder.join("transport");
    fs::create_dir(&transport).unwrap();
    rights(&transport, 0o750);
    fs::create_dir(folder.join("config")).unwrap();
    let configured = |path: &Path| {
        let text = format!("[global]\nroot-path = \"{}\"\n", path.display());
        fs::write(folder.join("config/iceoryx2.toml"), text).unwrap();
    };
    configured(&transport);
    let stop = ["stop", "--instance", "test-doctor-transport"];
    let refused = nobody(folder, &stop);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(4), "{said}");
    let found = format!("folder {}, got one of root;", transport.display());
    assert!(said.contains(&found) && said.contains("iceoryx2.toml"), "{said}");
    let doctor = nobody(folder, &["doctor"]);
    let table = String::from_utf8_lossy(&doctor.stdout).into_owned();
    assert_eq!(doctor.status.code(), Some(3), "{table}");
    assert!(table.contains(&format!("{} is of root", transport.display())), "{table}");

    // What it says helps.
    let own = folder.join("own");
    fs::create_dir(&own).unwrap();
    rights(&own, 0o777);
    configured(&own.join("transport"));
    let answered = nobody(folder, &stop);
    let said = String::from_utf8_lossy(&answered.stderr).into_owned();
    assert!(said.contains("no running service of this name"), "{said}");
}

/// The command on this machine, whatever that is: table and document agree, and the exit code says whether there is a problem.
#[test]
fn the_command_on_this_machine() {
    let folder = tempfile::tempdir().unwrap();
    let run = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
        command.arg("doctor").args(more).arg("--dir").arg(folder.path().join("not/yet/there"));
        command.env_remove("RUST_LOG").output().expect("the binary was just built")
    };
    let output = run(&["--json"]);
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let checks = document["checks"].as_array().unwrap();
    assert_eq!(checks.len(), CHECKS.len());
    let problems = checks.iter().filter(|check| check["state"] == "problem").count();
    assert_eq!(document["problems"], problems);
    assert_eq!(output.status.code(), Some(if problems == 0 { 0 } else { 3 }));

    let table = String::from_utf8(run(&[]).stdout).unwrap();
    for (line, check) in table.lines().filter(|line| !line.starts_with(' ')).zip(checks) {
        for part in ["state", "name"] {
            assert!(line.contains(check[part].as_str().unwrap()), "{check} in {line:?}");
        }
    }

    // What is asked for and not there is a problem everywhere.
    let output = run(&["--serial", "no/such/port", "--can", "nocan9"]);
    assert_eq!(output.status.code(), Some(3));
    let table = String::from_utf8(output.stdout).unwrap();
    assert!(table.contains("no/such/port does not exist") && table.contains("nocan9 is no CAN interface"), "{table}");
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("serial ports") && said.contains("CAN") && !said.contains("panicked"), "{said}");
    assert!(!Path::new(folder.path()).join("not").exists(), "looking changes nothing");
}
