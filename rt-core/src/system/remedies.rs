//! What to change where the system refuses a wish. One place, so that a refusal at the run's start and `bench doctor` before
//! it say the same.

/// No right to lock (enough) memory.
pub const MEMORY: &str = "put `@realtime - memlock unlimited` into /etc/security/limits.d/realtime.conf, join that group \
     (`groupadd -r realtime; usermod -aG realtime USER`) and log in again; under systemd LimitMEMLOCK=infinity; or \
     `setcap cap_sys_nice,cap_ipc_lock+ep PATH_OF_BENCH`";

/// No right to a real-time priority.
pub const PRIORITY: &str = "put `@realtime - rtprio 99` into /etc/security/limits.d/realtime.conf, join that group \
     (`groupadd -r realtime; usermod -aG realtime USER`) and log in again; under systemd LimitRTPRIO=99; or \
     `setcap cap_sys_nice,cap_ipc_lock+ep PATH_OF_BENCH`";

/// The right is there, the scheduler refuses all the same.
pub const CONTROL_GROUP: &str = "the control group has no real-time budget (CONFIG_RT_GROUP_SCHED): boot with rt_group_sched=0, or \
     give the group one (cpu.rt_runtime_us), or run outside of the container";

/// /dev/cpu_dma_latency can't be opened.
pub const CPU_LATENCY: &str = "put `KERNEL==\"cpu_dma_latency\", GROUP=\"realtime\", MODE=\"0660\"` into \
     /etc/udev/rules.d/99-realtime.rules, then `udevadm control --reload; udevadm trigger /dev/cpu_dma_latency`; or run as root";
