//! A machine made of files: what `/proc`, `/sys` and `/dev` of good and of poor ones show.

use bench::doctor::{Asked, Root, Space, State, Surroundings, examine};
use flate2::Compression;
use flate2::write::GzEncoder;
use rt_core::system::{Grant, Outcome, Report};
use std::fs;
use std::io::Write;
use tempfile::TempDir;

pub const CPU: &str = "/sys/devices/system/cpu";
pub const CLOCK: &str = "/sys/devices/system/clocksource/clocksource0";
pub const LATENCY_TIMER: &str = "/sys/bus/usb-serial/devices/ttyUSB0/latency_timer";
pub const LIMITS: &str = "\
Limit                     Soft Limit           Hard Limit           Units     
Max locked memory         unlimited            unlimited            bytes     
Max realtime priority     99                   99                   \n";
pub const POOR_LIMITS: &str = "\
Limit                     Soft Limit           Hard Limit           Units     
Max locked memory         8388608              8388608              bytes     
Max realtime priority     0                    0                    \n";
pub const CAN_UP: &str = r#"[{"ifname":"lo","flags":["UP"],"linkinfo":{"info_kind":7}},
    {"ifname":"can0","flags":["NOARP","UP","LOWER_UP","ECHO"],"linkinfo":{"info_kind":"can","info_data":{
    "state":"STATE","berr_counter":{"tx":3,"rx":135},"restart_ms":100,"bittiming":{"bitrate":500000,"sample_point":"0.875"}}}},
    {"ifname":"vcan0","flags":["NOARP","UP","LOWER_UP"],"linkinfo":{"info_kind":"vcan"}},
    {"ifname":"can1","flags":["NOARP"],"linkinfo":{"info_kind":"can","info_data":{"state":"STOPPED"}}}]"#;

/// A machine made of files.
pub struct Machine {
    folder: TempDir,
    pub surroundings: Surroundings,
}

impl Machine {
    /// No file at all.
    pub fn bare() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let room = Space { free_bytes: 100_000_000_000, writable: true };
        let surroundings = Surroundings {
            root: Root::new(folder.path()),
            asked: Asked { directory: "/data".into(), ..Asked::default() },
            timer_resolution_ns: 1,
            disk: Ok(room),
            shared_memory: Ok(room),
            foreign: None,
            ip_links: None,
            trial: Report::default(),
        };
        Machine { folder, surroundings }
    }

    /// As it should be, with an FTDI adapter and CAN.
    pub fn good() -> Self {
        let mut machine = Machine::bare()
            .with("/proc/sys/kernel/version", "#1 SMP PREEMPT_RT Debian 6.12.6-1")
            .with("/proc/sys/kernel/osrelease", "6.12.6-rt")
            .with("/proc/sys/kernel/sched_rt_runtime_us", "950000")
            .with("/proc/sys/kernel/sched_rt_period_us", "1000000")
            .with("/proc/cpuinfo", "processor : 0\nflags : fpu tsc constant_tsc")
            .with("/proc/swaps", "Filename Type Size Used Priority")
            .with("/proc/self/limits", LIMITS)
            .with("/proc/self/status", "Name: bench\nCapEff:\t0000000000000000")
            .with(&format!("{CLOCK}/current_clocksource"), "tsc")
            .with(&format!("{CLOCK}/available_clocksource"), "tsc hpet acpi_pm")
            .with(&format!("{CPU}/online"), "0-7")
            .with(&format!("{CPU}/isolated"), "7")
            .with(&format!("{CPU}/nohz_full"), "7")
            .with(&format!("{CPU}/cpu0/cpufreq/scaling_governor"), "performance")
            .with(&format!("{CPU}/cpu0/cpuidle/state0/name"), "POLL")
            .with(&format!("{CPU}/cpu0/cpuidle/state0/latency"), "0")
            .with(&format!("{CPU}/cpu0/cpuidle/state1/name"), "C6")
            .with(&format!("{CPU}/cpu0/cpuidle/state1/latency"), "133")
            .with("/dev/cpu_dma_latency", "")
            .with("/dev/ttyUSB0", "")
            .with(LATENCY_TIMER, "1")
            .with("/sys/class/net/lo/type", "772")
            .with("/sys/class/net/can0/type", "280");
        machine.surroundings.ip_links = Some(CAN_UP.replace("STATE", "ERROR-ACTIVE"));
        let granted = Grant { what: "sched", outcome: Outcome::Granted("SCHED_FIFO 80".to_owned()) };
        machine.surroundings.trial = Report::new(vec![granted]);
        machine
    }

    pub fn place(&self, path: &str) -> std::path::PathBuf {
        self.folder.path().join(path.trim_start_matches('/'))
    }

    pub fn with(self, path: &str, text: &str) -> Self {
        self.with_bytes(path, format!("{text}\n").as_bytes())
    }

    pub fn with_bytes(self, path: &str, bytes: &[u8]) -> Self {
        let place = self.place(path);
        fs::create_dir_all(place.parent().unwrap()).unwrap();
        fs::write(place, bytes).unwrap();
        self
    }

    pub fn without(self, path: &str) -> Self {
        let place = self.place(path);
        if place.is_dir() {
            fs::remove_dir_all(place).unwrap()
        } else {
            fs::remove_file(place).unwrap()
        }
        self
    }

    pub fn but(mut self, change: impl FnOnce(&mut Surroundings)) -> Self {
        change(&mut self.surroundings);
        self
    }

    /// What one check says; the words must be in what was found or in the remedy.
    #[track_caller]
    pub fn says(&self, check: &str, state: State, words: &[&str]) {
        let findings = examine(&self.surroundings);
        let finding = findings.iter().find(|finding| finding.name == check).expect("a check of this name");
        assert_eq!(finding.state, state, "{finding:?}");
        for word in words {
            assert!(
                finding.found.contains(word) || finding.remedy.contains(word),
                "{word:?} is missing in {finding:?}"
            );
        }
    }
}

pub fn packed(text: &str) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(text.as_bytes()).unwrap();
    encoder.finish().unwrap()
}

pub fn refused(what: &'static str, cause: &str, remedy: &str) -> Grant {
    Grant { what, outcome: Outcome::Refused { cause: cause.to_owned(), remedy: remedy.to_owned() } }
}
