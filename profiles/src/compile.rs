//! Binds a script to a rig and a seed: voltages in volts, durations in ticks, random steps drawn.

use crate::error::ScriptError;
use crate::playback::{Instruction, Jump, Playback};
use crate::script::{Context, Drive, End, FixtureChange, Item, ItemKind, RandomSteps, Script};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rt_core::{PERIOD_NS, Target};

/// Nearest whole number of ticks, at least one.
fn ticks(seconds: f64) -> u64 {
    ((seconds * 1e9 / PERIOD_NS as f64).round() as u64).max(1)
}

/// The first whole number of ticks that is not below.
pub(crate) fn ticks_at_least(seconds: f64) -> u64 {
    ((seconds * 1e9 / PERIOD_NS as f64).ceil() as u64).max(1)
}

/// Unrolls the script into instructions.
pub(crate) fn playback(script: &Script, context: &Context) -> Result<Playback, ScriptError> {
    let error = |line, what| ScriptError { file: script.file.clone(), line, what };
    if !(context.u_max_v.is_finite() && context.u_max_v > 0.0) {
        let what = format!("the rig's largest voltage must be a finite number above 0 V, got {}", context.u_max_v);
        return Err(error(1, what));
    }
    let mut instructions = Vec::with_capacity(script.items.len());
    let mut first_of_item = Vec::with_capacity(script.items.len() + 1);
    for item in &script.items {
        first_of_item.push(instructions.len());
        match &item.kind {
            ItemKind::Hold(hold) => {
                let (ticks, any, on_arrival) = match &hold.end {
                    End::After { seconds } => (ticks(*seconds), Vec::new(), false),
                    End::Until { any, timeout_s } => (ticks(*timeout_s), any.clone(), false),
                    End::Arrival { any, bound_s } => (ticks_at_least(*bound_s), any.clone(), true),
                };
                instructions.push(Instruction {
                    jumps: Vec::new(),
                    target: hold
                        .change
                        .drive
                        .map(|drive| target(drive, context))
                        .transpose()
                        .map_err(|what| error(item.line, what))?,
                    brake_open: hold.change.brake_open,
                    bypass_open: hold.change.bypass_open,
                    fixture: hold.change.fixture,
                    ticks,
                    any,
                    on_arrival,
                    new_segment: hold.new_segment,
                    guard_deg: None,
                });
            }
            ItemKind::Random { index, steps } => {
                random(&mut instructions, steps, context, &mut stream(script, context, *index));
            }
        }
    }
    first_of_item.push(instructions.len());
    for (Item { skips, .. }, &first) in script.items.iter().zip(&first_of_item) {
        instructions[first].jumps =
            skips.iter().map(|skip| Jump { when: skip.when.clone(), to: first_of_item[skip.to] }).collect();
    }
    Ok(Playback::new(script.start, instructions))
}

fn target(drive: Drive, context: &Context) -> Result<Target, String> {
    match drive {
        Drive::VoltageUMax(share) => Ok(Target::VoltageV(share * context.u_max_v)),
        Drive::VoltageV(voltage_v) if voltage_v.abs() <= context.u_max_v => Ok(Target::VoltageV(voltage_v)),
        Drive::VoltageV(voltage_v) => Err(format!(
            "`voltage_v` = {voltage_v} V exceeds the rig's largest voltage of {} V: lower it, or use `voltage_u_max`",
            context.u_max_v
        )),
        Drive::FlowMlS(flow_ml_s) => Ok(Target::FlowMlS(flow_ml_s)),
    }
}

/// The random stream of one block: the seed and the script's name choose it, the block's number its stream.
fn stream(script: &Script, context: &Context, block: u64) -> ChaCha8Rng {
    // FNV-1a, 64 bit: fixed for ever, unlike the standard library's hasher.
    let name = script
        .name
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    let mut rng = ChaCha8Rng::seed_from_u64(context.seed ^ name);
    rng.set_stream(block);
    rng
}

fn random(instructions: &mut Vec<Instruction>, steps: &RandomSteps, context: &Context, rng: &mut ChaCha8Rng) {
    let total = ticks(steps.total_s);
    let shortest = ticks(steps.length_s[0]);
    let mut done = 0;
    while done < total {
        // Every step draws the same five numbers, so that a changed share shifts none of the others.
        let length_s = rng.random_range(steps.length_s[0]..=steps.length_s[1]);
        let size = rng.random_range(steps.voltage_u_max[0]..=steps.voltage_u_max[1]);
        let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
        let zero = rng.random::<f64>() < steps.zero_share;
        let valves = rng.random::<f64>();
        let left = total - done;
        let length = ticks(length_s);
        // What would be left behind this step and is shorter than a step goes to it.
        let length = if length + shortest > left { left } else { length };
        let brake_closed = valves < steps.brake_closed_share;
        let bypass_open = !brake_closed && valves < steps.brake_closed_share + steps.bypass_open_share;
        instructions.push(Instruction {
            jumps: Vec::new(),
            target: Some(Target::VoltageV(if zero { 0.0 } else { sign * size * context.u_max_v })),
            brake_open: Some(!brake_closed),
            bypass_open: Some(bypass_open),
            fixture: None::<FixtureChange>,
            ticks: length,
            any: Vec::new(),
            on_arrival: false,
            new_segment: true,
            guard_deg: Some(steps.guard_deg),
        });
        done += length;
    }
}
