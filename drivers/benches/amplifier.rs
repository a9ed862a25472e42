//! What encoding and decoding of an amplifier's frames costs.
//!
//! ```text
//! cargo bench -p drivers --bench amplifier               # ns of a frame, median of the rounds
//! cargo bench -p drivers --bench amplifier -- --check    # ends with 3 where a frame takes more than 300 ns
//! ```
//!
//! A round is 2,000 frames, shorter than a time slice of a busy machine; voltages and measured values differ from frame to frame.
//! The fastest round is that of an undisturbed processor.

use drivers::amplifier::{
    AmplifierSettings, DriveState, Outbox, PROTOCOLS, ProtocolKind, Telemetry, TmclSettings, Told, VescSettings,
};
use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

const FRAMES: usize = 2_000;
const ROUNDS: usize = 2_001;
/// Other values before they come again.
const VALUES: usize = 1024;
/// Most that a frame may take, ns.
const TARGET_NS: f64 = 300.0;

fn settings(kind: &ProtocolKind) -> AmplifierSettings {
    AmplifierSettings {
        protocol: kind.name.into(),
        port: "/dev/null".into(),
        baud: 460_800,
        full_scale_v: 12.0,
        reversed: false,
        telemetry_every_ticks: 10,
        timeout_ms: 100.0,
        vesc: VescSettings::default(),
        tmcl: TmclSettings::default(),
    }
}

fn state(n: usize) -> DriveState {
    let share = n as f32 / VALUES as f32;
    let telemetry = Telemetry {
        supply_v: 11.0 + 2.0 * share,
        motor_current_a: 10.0 * share - 5.0,
        speed_rpm: 8000.0 * share - 4000.0,
        duty: 2.0 * share - 1.0,
        temperature_c: 20.0 + 50.0 * share,
        fault: None,
    };
    DriveState { telemetry }
}

fn voltage_v(n: usize) -> f64 {
    24.0 * n as f64 / VALUES as f64 - 12.0
}

/// What a frame costs, ns: median and minimum of the rounds.
fn rounds(mut frame: impl FnMut(usize)) -> (f64, f64) {
    let mut ns: Vec<f64> = (0..=ROUNDS)
        .map(|_| {
            let start = Instant::now();
            for n in 0..FRAMES {
                frame(n % VALUES);
            }
            start.elapsed().as_nanos() as f64 / FRAMES as f64
        })
        .skip(1)
        .collect();
    ns.sort_by(f64::total_cmp);
    (ns[ROUNDS / 2], ns[0])
}

fn main() -> ExitCode {
    let check = std::env::args().any(|argument| argument == "--check");
    let mut slow = false;
    println!("{:8} {:38} {:>10} {:>10}", "protocol", "frame", "median ns", "least ns");
    for kind in PROTOCOLS {
        let mut client = (kind.client)(&settings(kind)).expect("plain settings are in range");
        let mut drive = (kind.drive)(&settings(kind)).expect("plain settings are in range");
        let (mut out, mut back) = (Outbox::new(), Outbox::new());
        let commands: Vec<Vec<u8>> = (0..VALUES)
            .map(|n| {
                out.clear();
                client.command(voltage_v(n), &mut out);
                out.bytes().to_vec()
            })
            .collect();
        client.reset();
        let encode = rounds(|n| {
            out.clear();
            client.command(black_box(voltage_v(n)), &mut out);
            black_box(out.bytes());
        });
        let decode = rounds(|n| {
            back.clear();
            black_box(drive.hear(black_box(&commands[n]), 0, &state(0), &mut back));
        });
        client.reset();
        // A request and its answer, less what the request and the drive's part alone cost, would be a difference of noise: for a
        // protocol that tracks requests the whole is said.
        let answers: Vec<Vec<u8>> = (0..VALUES)
            .map(|n| {
                out.clear();
                back.clear();
                client.request(&mut out);
                drive.hear(out.bytes(), 0, &state(n), &mut back);
                client.hear(back.bytes(), &mut |_| {});
                back.bytes().to_vec()
            })
            .collect();
        let (mut tellings, mut asked) = (0_u64, 0_u64);
        let request = rounds(|n| {
            out.clear();
            asked += 1;
            client.request(&mut out);
            black_box(out.bytes());
            client.hear(black_box(&answers[n]), &mut |told| {
                tellings += u64::from(matches!(told, Told::Telemetry(_)));
                black_box(told);
            });
        });
        let hear = (kind.name == "vesc").then(|| {
            rounds(|n| {
                client.hear(black_box(&answers[n]), &mut |told| {
                    black_box(told);
                })
            })
        });
        assert!(tellings * 2 > asked, "{tellings} of {asked} requests were answered");
        let cases = [
            ("encode a command", Some(encode)),
            ("decode a command (and acknowledge it)", Some(decode)),
            ("decode telemetry", hear),
            ("encode a request, decode its answer", Some(request)),
        ];
        for (what, ns) in cases {
            let Some((median, least)) = ns else { continue };
            println!("{:8} {what:38} {median:10.1} {least:10.1}", kind.name);
            slow |= least > TARGET_NS;
        }
    }
    if check && slow {
        eprintln!("a frame takes more than {TARGET_NS} ns");
        return ExitCode::from(3);
    }
    ExitCode::SUCCESS
}
