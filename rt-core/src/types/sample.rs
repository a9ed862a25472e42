//! The sample that is published for every tick.

use iceoryx2::prelude::ZeroCopySend;

use super::{Measurement, TargetKind};

/// Version of [`Sample`]'s layout; a subscriber refuses another.
pub const SAMPLE_VERSION: u32 = 3;

/// A tick of a run is below this: 139 years.
const TICKS: u64 = 1 << 42;
/// A time of a run, and the clock that it goes by, is below this, ns: 146 years.
const TIMES_NS: u64 = 1 << 62;

/// A number that no run comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {field} below {bound}, got {got}: no run comes to that")]
pub struct BeyondRange {
    /// Field of the sample.
    pub field: &'static str,
    /// What is too much.
    pub bound: u64,
    /// What came.
    pub got: u64,
}

/// One tick as it is published. Fixed size, versioned; the type name is part of the service's contract with other
/// languages. Durations of 4.3 s and more read `u32::MAX`.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchSample")]
pub struct Sample {
    /// [`SAMPLE_VERSION`].
    pub version: u32,
    /// Number of the run within the service's life; samples of different runs share the service.
    pub run: u32,
    /// Tick number, from 0: the number of the period. Gaps only where `skipped` grows.
    pub tick: u64,
    /// Scheduled time since the run's start, ns.
    pub scheduled_ns: u64,
    /// `CLOCK_MONOTONIC` at the wake-up, ns; 0 in virtual time.
    pub woken_ns: u64,
    /// Wake-up later than scheduled by, ns (0 in virtual time).
    pub lateness_ns: u64,
    /// Ticks of this run that were passed over up to here, because those before them took too long.
    pub skipped: u64,
    /// Command, V.
    pub voltage_v: f64,
    /// Measured angle, degrees; NaN = not measured.
    pub angle_deg: f64,
    /// Measured pressure, bar absolute; NaN = not measured.
    pub pressure1_bar: f64,
    /// Measured pressure, bar absolute; NaN = not measured.
    pub pressure2_bar: f64,
    /// Measured torque, Nm; NaN = not measured.
    pub torque_nm: f64,
    /// Measured volume, ml; NaN = not measured.
    pub volume_ml: f64,
    /// Age of each measured value at the tick, ns, in the order of [`Input`].
    pub age_ns: [u32; 5],
    /// Age of the oldest sign of life among the device's drivers, ns.
    pub heartbeat_age_ns: u32,
    /// Part of the lateness that earlier ticks caused: the loop itself came late to its wait, ns.
    pub behind_ns: u32,
    /// Duration of the stage "read inputs", ns. This and the other stages: 0 in virtual time.
    pub read_ns: u32,
    /// Duration of the supervisor's check, ns.
    pub check_ns: u32,
    /// Duration of the reference (profile), ns.
    pub reference_ns: u32,
    /// Duration of the controller, with the supervisor's release of its command, ns.
    pub control_ns: u32,
    /// Duration of the stage "write outputs", ns.
    pub write_ns: u32,
    /// Duration of the hand-over at the tick before this one, ns.
    pub publish_ns: u32,
    /// Segment of the protocol.
    pub segment: u32,
    /// Active step of the profile, counted through its unrolled loops from 0.
    pub step: u32,
    /// Bits: see [`flags`].
    pub flags: u32,
    /// Bits of [`Input`]: 0..5 valid values; shifted by 8: values that the device itself calls wrong.
    pub quality: u32,
    /// Why the supervisor tripped: 0 = it has not, otherwise [`Trip::code`](crate::supervisor::Trip::code).
    pub trip: u32,
    /// What the profile asks for at this tick, in the unit of `target_of`; NaN = nothing. It stands here also where the
    /// command is the safe state: what was asked, not what was given.
    pub target: f64,
    /// What `target` is of: the number of a [`TargetKind`], 0 = there is none.
    pub target_of: u32,
    /// Fills the layout up to its alignment; 0.
    pub reserved: u32,
}

/// Bits of [`Sample::flags`].
pub mod flags {
    /// The brake valve is commanded open.
    pub const BRAKE_OPEN: u32 = 1 << 0;
    /// The bypass valve is commanded open.
    pub const BYPASS_OPEN: u32 = 1 << 1;
    /// The supervisor has tripped: the command is the safe state.
    pub const TRIPPED: u32 = 1 << 2;
    /// Last sample of its run.
    pub const LAST: u32 = 1 << 3;
    /// The device failed within this tick: the sample holds no measurement, and the safe state was ordered.
    pub const FAULT: u32 = 1 << 4;
    /// The tick before this one ended after this one, or one before it, should have begun.
    pub const OVERRUN: u32 = 1 << 5;
    /// Somebody asked for a stop: the command is the safe state.
    pub const STOPPED: u32 = 1 << 6;
    /// The supervisor let the voltage follow no faster than its slew limit.
    pub const SLEW_LIMITED: u32 = 1 << 7;
    /// The run waits for the people at the rig: they may have their hands on it, and the supervisor leaves out what hands disturb.
    pub const WAITING: u32 = 1 << 8;
    /// At this tick their confirmation was taken; an amount that it brought is the measured volume.
    pub const CONFIRMED: u32 = 1 << 9;
}

impl Sample {
    /// Brake valve commanded open.
    pub fn brake_open(&self) -> bool {
        self.flags & flags::BRAKE_OPEN != 0
    }

    /// Bypass valve commanded open.
    pub fn bypass_open(&self) -> bool {
        self.flags & flags::BYPASS_OPEN != 0
    }

    /// The run's last sample.
    pub fn last(&self) -> bool {
        self.flags & flags::LAST != 0
    }

    /// The supervisor has tripped.
    pub fn tripped(&self) -> bool {
        self.flags & flags::TRIPPED != 0
    }

    /// The device failed within this tick.
    pub fn fault(&self) -> bool {
        self.flags & flags::FAULT != 0
    }

    /// The tick before this one ended too late.
    pub fn overrun(&self) -> bool {
        self.flags & flags::OVERRUN != 0
    }

    /// The run waits for the people at the rig.
    pub fn waiting(&self) -> bool {
        self.flags & flags::WAITING != 0
    }

    /// A confirmation was taken at this tick.
    pub fn confirmed(&self) -> bool {
        self.flags & flags::CONFIRMED != 0
    }

    /// Seconds since the run's start.
    pub fn time_s(&self) -> f64 {
        self.scheduled_ns as f64 * 1e-9
    }

    /// Number of this sample within its run: the ticks that were run before it. Loss is seen by gaps of this number.
    pub fn sequence(&self) -> u64 {
        self.tick.saturating_sub(self.skipped)
    }

    /// Whether ticks and times are such that what is reckoned with them stays in range: whoever takes samples from outside asks first.
    ///
    /// # Errors
    /// The first field that is not.
    #[inline]
    pub fn in_range(&self) -> Result<(), BeyondRange> {
        // Both bounds are powers of two: one look for all fields of a kind.
        if (self.tick | self.skipped) < TICKS && (self.scheduled_ns | self.woken_ns | self.lateness_ns) < TIMES_NS {
            return Ok(());
        }
        Err(self.beyond())
    }

    #[cold]
    fn beyond(&self) -> BeyondRange {
        let of = |field, bound, got| BeyondRange { field, bound, got };
        let fields = [
            of("tick", TICKS, self.tick),
            of("skipped", TICKS, self.skipped),
            of("scheduled_ns", TIMES_NS, self.scheduled_ns),
            of("woken_ns", TIMES_NS, self.woken_ns),
        ];
        let last = of("lateness_ns", TIMES_NS, self.lateness_ns);
        fields.into_iter().find(|field| field.got >= field.bound).unwrap_or(last)
    }

    /// The measurement that this sample carries, as the device gave it.
    pub fn measurement(&self) -> Measurement {
        Measurement {
            angle_deg: self.angle_deg,
            pressure1_bar: self.pressure1_bar,
            pressure2_bar: self.pressure2_bar,
            torque_nm: self.torque_nm,
            volume_ml: self.volume_ml,
            age_ns: self.age_ns,
            faulty: self.quality >> 8,
            heartbeat_age_ns: self.heartbeat_age_ns,
        }
    }

    /// What the profile asks for at this tick, and its value in that kind's unit.
    pub fn target(&self) -> Option<(TargetKind, f64)> {
        TargetKind::of_code(self.target_of).map(|kind| (kind, self.target))
    }

    /// From wake-up to the last stage before publication, ns.
    pub fn execution_ns(&self) -> u64 {
        [self.read_ns, self.check_ns, self.reference_ns, self.control_ns, self.write_ns].map(u64::from).iter().sum()
    }

    /// A sample in which nothing is set but the version and nothing is measured. For readers and tests.
    pub const BLANK: Sample = Sample {
        version: SAMPLE_VERSION,
        run: 0,
        tick: 0,
        scheduled_ns: 0,
        woken_ns: 0,
        lateness_ns: 0,
        skipped: 0,
        voltage_v: 0.0,
        angle_deg: f64::NAN,
        pressure1_bar: f64::NAN,
        pressure2_bar: f64::NAN,
        torque_nm: f64::NAN,
        volume_ml: f64::NAN,
        age_ns: [0; 5],
        heartbeat_age_ns: 0,
        behind_ns: 0,
        read_ns: 0,
        check_ns: 0,
        reference_ns: 0,
        control_ns: 0,
        write_ns: 0,
        publish_ns: 0,
        segment: 0,
        step: 0,
        flags: 0,
        quality: 0,
        trip: 0,
        target: f64::NAN,
        target_of: 0,
        reserved: 0,
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    fn what_no_run_comes_to_is_out_of_range() {
        let most = TICKS - 1;
        let largest = Sample {
            tick: most,
            skipped: most,
            scheduled_ns: most * crate::types::PERIOD_NS,
            woken_ns: TIMES_NS - 1,
            lateness_ns: TIMES_NS - 1,
            ..Sample::BLANK
        };
        assert_eq!(largest.in_range(), Ok(()));
        for (beyond, field) in [
            (Sample { tick: TICKS, ..largest }, "tick"),
            (Sample { tick: u64::MAX, ..largest }, "tick"),
            (Sample { skipped: u64::MAX, ..largest }, "skipped"),
            (Sample { scheduled_ns: TIMES_NS, ..largest }, "scheduled_ns"),
            (Sample { woken_ns: u64::MAX, ..largest }, "woken_ns"),
            (Sample { lateness_ns: TIMES_NS, ..largest }, "lateness_ns"),
        ] {
            assert_eq!(beyond.in_range().map_err(|beyond| beyond.field), Err(field));
        }
    }

    /// The layout is a contract with subscribers in other languages and with recordings: changing it is a new
    /// [`SAMPLE_VERSION`].
    #[test]
    fn layout_of_version_3() {
        assert_eq!(SAMPLE_VERSION, 3);
        assert_eq!((size_of::<Sample>(), align_of::<Sample>()), (184, 8));
        let offsets = [
            ("version", offset_of!(Sample, version), 0),
            ("run", offset_of!(Sample, run), 4),
            ("tick", offset_of!(Sample, tick), 8),
            ("scheduled_ns", offset_of!(Sample, scheduled_ns), 16),
            ("woken_ns", offset_of!(Sample, woken_ns), 24),
            ("lateness_ns", offset_of!(Sample, lateness_ns), 32),
            ("skipped", offset_of!(Sample, skipped), 40),
            ("voltage_v", offset_of!(Sample, voltage_v), 48),
            ("angle_deg", offset_of!(Sample, angle_deg), 56),
            ("pressure1_bar", offset_of!(Sample, pressure1_bar), 64),
            ("pressure2_bar", offset_of!(Sample, pressure2_bar), 72),
            ("torque_nm", offset_of!(Sample, torque_nm), 80),
            ("volume_ml", offset_of!(Sample, volume_ml), 88),
            ("age_ns", offset_of!(Sample, age_ns), 96),
            ("heartbeat_age_ns", offset_of!(Sample, heartbeat_age_ns), 116),
            ("behind_ns", offset_of!(Sample, behind_ns), 120),
            ("read_ns", offset_of!(Sample, read_ns), 124),
            ("check_ns", offset_of!(Sample, check_ns), 128),
            ("reference_ns", offset_of!(Sample, reference_ns), 132),
            ("control_ns", offset_of!(Sample, control_ns), 136),
            ("write_ns", offset_of!(Sample, write_ns), 140),
            ("publish_ns", offset_of!(Sample, publish_ns), 144),
            ("segment", offset_of!(Sample, segment), 148),
            ("step", offset_of!(Sample, step), 152),
            ("flags", offset_of!(Sample, flags), 156),
            ("quality", offset_of!(Sample, quality), 160),
            ("trip", offset_of!(Sample, trip), 164),
            ("target", offset_of!(Sample, target), 168),
            ("target_of", offset_of!(Sample, target_of), 176),
            ("reserved", offset_of!(Sample, reserved), 180),
        ];
        for (field, offset, documented) in offsets {
            assert_eq!(offset, documented, "offset of {field}");
        }
        use flags::*;
        let bits = [BRAKE_OPEN, BYPASS_OPEN, TRIPPED, LAST, FAULT, OVERRUN, STOPPED, SLEW_LIMITED, WAITING, CONFIRMED];
        assert_eq!(bits, [1, 2, 4, 8, 16, 32, 64, 128, 256, 512]);
        // SAFETY: the function reads no data; it is unsafe only because the trait's implementor vouches for the name.
        assert_eq!(unsafe { Sample::type_name() }, "RecBenchSample");
    }
}
