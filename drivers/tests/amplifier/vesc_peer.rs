//! The crate `vesc`, which nobody here wrote, drives our emulated VESC.

use super::{Pair, settings};
use drivers::amplifier::{DriveState, Fault, Outbox, Telemetry, protocol};
use proptest::prelude::*;
use vesc::{Command, CommandReply, Decoder, FaultCode, ValuesMask};

/// What the crate's client says to our drive; the replies that it understands, and the voltage that was commanded.
fn ask(pair: &mut Pair, commands: &[Command]) -> (Vec<CommandReply>, Option<f64>) {
    let mut bytes = vec![];
    for command in commands {
        let mut frame = [0; 64];
        let length = vesc::encode(*command, &mut frame).unwrap();
        bytes.extend(&frame[..length]);
    }
    pair.back.clear();
    let commanded = pair.drive.hear(&bytes, 0, &pair.state, &mut pair.back);
    let mut decoder = Decoder::<512>::default();
    assert_eq!(decoder.feed(pair.back.bytes()).unwrap(), pair.back.bytes().len());
    (decoder.by_ref().collect(), commanded)
}

fn vesc_pair() -> Pair {
    Pair::of(protocol("vesc").unwrap())
}

proptest! {
    #[test]
    fn it_drives_the_emulated_amplifier(
        duty in -1.0..1.0_f32, current_a in -100.0..100.0_f32, rpm in -8000.0..8000.0_f32, supply_v in 8.0..60.0_f32,
        celsius in -20.0..110.0_f32, mask in 0..(1_u32 << 22), code in 0..30_u8,
    ) {
        let mut pair = vesc_pair();
        let fault = drivers::amplifier::vesc::fault(code);
        pair.state = DriveState { telemetry: Telemetry {
            supply_v, motor_current_a: current_a, speed_rpm: rpm, duty, temperature_c: celsius, fault,
        } };
        let (replies, commanded) = ask(&mut pair, &[
            Command::GetValues,
            Command::SetDuty(duty),
            Command::GetValuesSelective(ValuesMask::from_bits_retain(mask)),
            Command::Alive,
            Command::FwVersion,
        ]);
        prop_assert!((commanded.unwrap() - 12.0 * f64::from(duty)).abs() < 12.0 * 1.1e-5);
        let [CommandReply::GetValues(all), CommandReply::GetValuesSelective(some), CommandReply::FwVersion(version)] = &replies[..]
        else { panic!("{replies:?}") };
        prop_assert!((all.temp_mosfet - celsius).abs() < 0.051);
        prop_assert!((all.avg_current_motor - current_a).abs() < 0.0051);
        prop_assert!((all.duty_cycle - duty).abs() < 0.00051);
        prop_assert!((all.rpm - 7.0 * rpm).abs() < 0.51, "electrical, with 7 pole pairs: {} {}", all.rpm, rpm);
        prop_assert!((all.voltage_in - supply_v).abs() < 0.051);
        prop_assert!((all.avg_voltage_q - supply_v * duty).abs() < 0.01);
        prop_assert_eq!(all.fault_code as u8, code);
        prop_assert_eq!(all.fault_code == FaultCode::None, code == 0);
        prop_assert_eq!(all.status, 0);
        // A mask chooses out of the same values; those left out are 0.
        let chosen = |bit: u32, value: f32| if mask & (1 << bit) == 0 { 0.0 } else { value };
        prop_assert_eq!(some.temp_mosfet, chosen(0, all.temp_mosfet));
        prop_assert_eq!(some.avg_current_motor, chosen(2, all.avg_current_motor));
        prop_assert_eq!(some.avg_current_input, chosen(3, all.avg_current_input));
        prop_assert_eq!(some.avg_current_q, chosen(5, all.avg_current_q));
        prop_assert_eq!(some.duty_cycle, chosen(6, all.duty_cycle));
        prop_assert_eq!(some.rpm, chosen(7, all.rpm));
        prop_assert_eq!(some.voltage_in, chosen(8, all.voltage_in));
        prop_assert_eq!(some.fault_code as u8, if mask & (1 << 15) == 0 { 0 } else { code });
        prop_assert_eq!(some.temp_mosfet3, chosen(18, all.temp_mosfet));
        prop_assert_eq!(some.avg_voltage_q, chosen(20, all.avg_voltage_q));
        prop_assert_eq!(version.hw_name(), Some("REC_BENCH"));
        prop_assert_eq!((version.major, version.minor), (6, 6));
        prop_assert_eq!(pair.drive.garbled().refused + pair.drive.garbled().skipped_bytes, 0);
    }

    #[test]
    fn its_frames_are_ours(duty in -1.0..1.0_f64) {
        // The peer computes in f32: one step of 1e-5 of difference may come from that.
        let mut client = (protocol("vesc").unwrap().client)(&settings(protocol("vesc").unwrap())).unwrap();
        let mut out = Outbox::new();
        client.command(duty * 12.0, &mut out);
        let mut theirs = [0; 64];
        let length = vesc::encode(Command::SetDuty(duty as f32), &mut theirs).unwrap();
        let value = |frame: &[u8]| i32::from_be_bytes(frame[3..7].try_into().unwrap());
        prop_assert_eq!(&theirs[..3], &out.bytes()[..3]);
        prop_assert!((value(&theirs[..length]) - value(out.bytes())).abs() <= 1);
        if value(&theirs[..length]) == value(out.bytes()) {
            prop_assert_eq!(&theirs[..length], out.bytes());
        }
        out.clear();
        client.hello(&mut out);
        client.keep_alive(&mut out);
        client.request(&mut out);
        let mut theirs: Vec<u8> = vec![];
        let mask = ValuesMask::TEMP_MOSFET | ValuesMask::AVG_CURRENT_MOTOR | ValuesMask::DUTY_CYCLE | ValuesMask::RPM
            | ValuesMask::VOLTAGE_IN | ValuesMask::FAULT_CODE;
        for command in [Command::FwVersion, Command::Alive, Command::GetValuesSelective(mask)] {
            let mut frame = [0; 64];
            let length = vesc::encode(command, &mut frame).unwrap();
            theirs.extend(&frame[..length]);
        }
        prop_assert_eq!(&theirs[..], out.bytes());
    }
}

#[test]
fn its_other_motor_commands_release_the_motor_and_its_duty_is_vector() {
    let mut frame = [0; 64];
    let length = vesc::encode(Command::SetDuty(0.2), &mut frame).unwrap();
    assert_eq!(frame[..length], [0x02, 0x05, 0x05, 0x00, 0x00, 0x4e, 0x20, 0x29, 0xf6, 0x03]);
    for command in [
        Command::SetCurrent(3.0),
        Command::SetCurrentBrake(3.0),
        Command::SetRpm(1000),
        Command::SetPos(10.0),
        Command::SetHandbrake(1.0),
    ] {
        let mut pair = vesc_pair();
        assert_eq!(ask(&mut pair, &[Command::SetDuty(0.5), command]).1, Some(0.0), "{command:?}");
        assert_eq!(pair.drive.voltage_v(0), 0.0);
    }
    // What our drive does not know it ignores, and it stays in step.
    let mut pair = vesc_pair();
    let (replies, commanded) =
        ask(&mut pair, &[Command::FwInfo, Command::SetDuty(-0.5), Command::Reboot, Command::FwVersion]);
    assert!(matches!(replies[..], [CommandReply::FwVersion(_)]) && commanded == Some(-6.0));
    pair.drive.set_timeout(Some(10));
    pair.back.clear();
    let mut frame = [0; 64];
    let length = vesc::encode(Command::GetValues, &mut frame).unwrap();
    pair.drive.hear(&frame[..length], 11, &pair.state, &mut pair.back);
    let Ok((_, CommandReply::GetValues(values))) = vesc::decode(pair.back.bytes()) else { panic!() };
    assert_eq!(values.status, 1, "it says that it has timed out");
    assert_eq!(Fault { code: 1, name: "over voltage" }.to_string(), "over voltage (0x1)");
}
