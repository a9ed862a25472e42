//! The amplifier's reports on their way into a run's recording: each stands between the ticks between which it arrived.

use drivers::telemetry::{Arrived, TelemetryReader};
use recordings::{AmplifierFault, AmplifierReport};
use rt_core::{PERIOD_NS, Sample};

/// See the module. Reports before a run's first tick and after its last one are of no run, and left out.
pub struct AmplifierLog {
    reader: TelemetryReader,
    /// Taken, but of a later tick than was asked for.
    next: Option<Arrived>,
    /// Reports that had found no room when the run began.
    untaken_before: u64,
    /// Tick 0 of the run, `CLOCK_MONOTONIC`, ns; `None` before its first sample.
    origin_ns: Option<u64>,
}

impl AmplifierLog {
    /// Reads here.
    pub fn new(reader: TelemetryReader) -> Self {
        AmplifierLog { reader, next: None, untaken_before: 0, origin_ns: None }
    }

    /// Another run begins: what came before it is forgotten.
    pub fn begin(&mut self) {
        while self.reader.take().is_some() {}
        (self.next, self.origin_ns) = (None, None);
        self.untaken_before = self.reader.untaken();
    }

    /// The next report that arrived before this sample's tick began.
    pub fn before(&mut self, sample: &Sample) -> Option<AmplifierReport> {
        self.origin_ns = self.origin_ns.or_else(|| origin_ns(sample));
        self.until(sample.scheduled_ns)
    }

    /// The next report that arrived before the tick of the run's last sample ended.
    pub fn within(&mut self, last: &Sample) -> Option<AmplifierReport> {
        self.until(last.scheduled_ns + PERIOD_NS)
    }

    /// Reports since the run's beginning that found no room: this reader did not come for so long.
    pub fn lost(&self) -> u64 {
        self.reader.untaken() - self.untaken_before
    }

    /// The next report of the run that arrived before this time, ns since the run's start.
    fn until(&mut self, end_ns: u64) -> Option<AmplifierReport> {
        let origin_ns = self.origin_ns?;
        let end_ns = origin_ns + end_ns;
        loop {
            let arrived = self.next.take().or_else(|| self.reader.take())?;
            if arrived.received_ns >= end_ns {
                self.next = Some(arrived);
                return None;
            }
            if let Some(arrived_ns) = arrived.received_ns.checked_sub(origin_ns) {
                return Some(report(&arrived, arrived_ns));
            }
        }
    }
}

/// `arrived_ns`: since the run's start.
fn report(arrived: &Arrived, arrived_ns: u64) -> AmplifierReport {
    let told = &arrived.telemetry;
    AmplifierReport {
        tick: arrived_ns / PERIOD_NS,
        arrived_ns,
        supply_v: told.supply_v.into(),
        motor_current_a: told.motor_current_a.into(),
        speed_rpm: told.speed_rpm.into(),
        duty: told.duty.into(),
        temperature_c: told.temperature_c.into(),
        fault: told.fault.map(|fault| AmplifierFault { code: fault.code, name: fault.name.to_owned() }),
    }
}

/// When the sample's run began, `CLOCK_MONOTONIC`, ns; the same in all samples of a run in real time. `None` in virtual time.
fn origin_ns(sample: &Sample) -> Option<u64> {
    let due_ns = sample.woken_ns.checked_sub(sample.lateness_ns).filter(|_| sample.woken_ns > 0)?;
    due_ns.checked_sub(sample.scheduled_ns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivers::amplifier::{Fault, Telemetry};
    use drivers::telemetry::{AHEAD, TelemetryLog, telemetry_log};

    const ORIGIN_NS: u64 = 77_000_000_123;

    fn note(log: &mut TelemetryLog, received_ns: u64, current_a: f32) {
        let telemetry = Telemetry { motor_current_a: current_a, ..Telemetry::UNTOLD };
        log.note(Arrived { received_ns, telemetry });
    }

    fn sample(tick: u64) -> Sample {
        let scheduled_ns = tick * PERIOD_NS;
        Sample { tick, scheduled_ns, woken_ns: ORIGIN_NS + scheduled_ns + 500, lateness_ns: 500, ..Sample::BLANK }
    }

    #[test]
    fn reports_stand_between_the_ticks_between_which_they_arrived() {
        let (mut log, reader) = telemetry_log();
        let mut of_run = AmplifierLog::new(reader);
        note(&mut log, ORIGIN_NS - 90 * PERIOD_NS, 0.0);
        of_run.begin();
        note(&mut log, ORIGIN_NS - 1, 1.0);
        note(&mut log, ORIGIN_NS, 2.0);
        note(&mut log, ORIGIN_NS + PERIOD_NS - 1, 3.0);
        note(&mut log, ORIGIN_NS + 2 * PERIOD_NS, 4.0);
        note(&mut log, ORIGIN_NS + 3 * PERIOD_NS, 5.0);
        let told = |report: AmplifierReport| (report.tick, report.arrived_ns, report.motor_current_a);
        assert_eq!(of_run.before(&sample(0)).map(told), None);
        assert_eq!(of_run.before(&sample(1)).map(told), Some((0, 0, 2.0)));
        assert_eq!(of_run.before(&sample(1)).map(told), Some((0, PERIOD_NS - 1, 3.0)));
        assert_eq!(of_run.before(&sample(1)), None);
        assert_eq!(of_run.before(&sample(2)), None, "it arrived within tick 2");
        assert_eq!(of_run.within(&sample(2)).map(told), Some((2, 2 * PERIOD_NS, 4.0)));
        assert_eq!(of_run.within(&sample(2)), None, "the run was over");
        of_run.begin();
        assert_eq!(of_run.before(&sample(9)), None, "the next run has none of them");
    }

    #[test]
    fn what_is_told_arrives_and_what_is_not_stays_untold() {
        let (mut log, reader) = telemetry_log();
        let mut of_run = AmplifierLog::new(reader);
        of_run.begin();
        let fault = Some(Fault { code: 4, name: "over temperature" });
        let telemetry = Telemetry { supply_v: 23.5, duty: -0.25, temperature_c: 41.0, fault, ..Telemetry::UNTOLD };
        log.note(Arrived { received_ns: ORIGIN_NS + 5, telemetry });
        let report = of_run.before(&sample(1)).expect("it arrived before");
        assert_eq!((report.supply_v, report.duty, report.temperature_c), (23.5, -0.25, 41.0));
        assert!(report.motor_current_a.is_nan() && report.speed_rpm.is_nan());
        assert_eq!(report.fault, Some(AmplifierFault { code: 4, name: "over temperature".to_owned() }));
    }

    #[test]
    fn what_found_no_room_counts_for_the_run_in_which_it_did_not() {
        let (mut log, reader) = telemetry_log();
        let mut of_run = AmplifierLog::new(reader);
        (0..AHEAD as u64 + 7).for_each(|n| note(&mut log, n, 0.0));
        of_run.begin();
        assert_eq!(of_run.lost(), 0, "nobody recorded before");
        (0..AHEAD as u64 + 2).for_each(|n| note(&mut log, ORIGIN_NS + n, 0.0));
        assert_eq!(of_run.lost(), 2);
        assert_eq!(std::iter::from_fn(|| of_run.before(&sample(1))).count(), AHEAD);
    }

    #[test]
    fn virtual_time_has_no_amplifier() {
        let (mut log, reader) = telemetry_log();
        let mut of_run = AmplifierLog::new(reader);
        note(&mut log, 5, 0.0);
        assert_eq!(of_run.before(&Sample { tick: 9, scheduled_ns: 9 * PERIOD_NS, ..Sample::BLANK }), None);
    }
}
