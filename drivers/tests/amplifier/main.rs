//! Protocols of pump amplifiers: both sides against each other, against random bytes, and against programs that nobody here wrote.

#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../counting/mod.rs"]
mod counting;
#[path = "../peers/mod.rs"]
mod peers;

mod allocation;
mod both_sides;
mod lost_bytes;
mod random_bytes;
mod tmcl_peer;
mod vesc_peer;

use drivers::amplifier::{
    AmplifierSettings, Drive, DriveState, Outbox, Protocol, ProtocolKind, Telemetry, TmclSettings, Told, VescSettings,
};

/// Settings of a plain rig for a protocol.
fn settings(kind: &ProtocolKind) -> AmplifierSettings {
    AmplifierSettings {
        protocol: kind.name.into(),
        port: "/dev/null".into(),
        baud: 460_800,
        full_scale_v: 12.0,
        reversed: false,
        telemetry_every_ticks: 10,
        timeout_ms: 100.0,
        vesc: VescSettings { pole_pairs: 7 },
        tmcl: TmclSettings::default(),
    }
}

/// Every quantity differs from every other.
fn state() -> DriveState {
    let telemetry = Telemetry {
        supply_v: 12.3,
        motor_current_a: -4.56,
        speed_rpm: 2345.0,
        duty: 0.25,
        temperature_c: 34.5,
        fault: None,
    };
    DriveState { telemetry }
}

/// Both ends of a wire.
struct Pair {
    client: Box<dyn Protocol>,
    drive: Box<dyn Drive>,
    state: DriveState,
    out: Outbox,
    back: Outbox,
}

impl Pair {
    fn of(kind: &ProtocolKind) -> Pair {
        Pair::with(kind, &settings(kind), &settings(kind))
    }

    fn with(kind: &ProtocolKind, client: &AmplifierSettings, drive: &AmplifierSettings) -> Pair {
        let (client, drive) = ((kind.client)(client).unwrap(), (kind.drive)(drive).unwrap());
        Pair { client, drive, state: state(), out: Outbox::new(), back: Outbox::new() }
    }

    /// Sends, answers, and says what the drive was commanded and the client told.
    fn exchange(&mut self, now_ns: u64, ask: impl FnOnce(&mut dyn Protocol, &mut Outbox)) -> (Option<f64>, Vec<Told>) {
        self.out.clear();
        self.back.clear();
        ask(&mut *self.client, &mut self.out);
        let commanded = self.drive.hear(self.out.bytes(), now_ns, &self.state, &mut self.back);
        (commanded, heard(&mut *self.client, self.back.bytes()))
    }
}

fn heard(client: &mut dyn Protocol, bytes: &[u8]) -> Vec<Told> {
    let mut all = vec![];
    client.hear(bytes, &mut |told| all.push(told));
    all
}
