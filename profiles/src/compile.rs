//! Binds a script to a rig and a seed: voltages in volts, durations in ticks, random steps drawn.

use crate::ask::{Hands, Part, Requests};
use crate::controlled::Controlled;
use crate::error::ScriptError;
use crate::instruction::{Aim, Instruction, Jump};
use crate::playback::Playback;
use crate::script::{
    Context, Drive, End, FORESEEN_S, FixtureChange, Hold, Item, ItemKind, RandomSteps, RandomWave, Script, Wave,
};
use crate::signal::Signal;
use crate::values::{ticks, ticks_at_least};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Unrolls the script into instructions.
pub(crate) fn playback(script: &Script, context: &Context) -> Result<Playback, ScriptError> {
    unrolled(script, context, false)
}

/// The same for a prediction, in which nobody is asked.
pub(crate) fn foreseen(script: &Script, context: &Context) -> Result<Playback, ScriptError> {
    unrolled(script, context, true)
}

fn unrolled(script: &Script, context: &Context, foreseen: bool) -> Result<Playback, ScriptError> {
    if !(context.u_max_v.is_finite() && context.u_max_v > 0.0) {
        let what = format!("the rig's largest voltage must be a finite number above 0 V, got {}", context.u_max_v);
        return Err(ScriptError { file: script.file.clone(), line: 1, what });
    }
    let mut instructions = Vec::with_capacity(script.items.len());
    let mut requests = Requests::new(script, if foreseen { Hands::Rig } else { context.hands });
    let mut first_of_item = Vec::with_capacity(script.items.len() + 1);
    for item in &script.items {
        first_of_item.push(instructions.len());
        match &item.kind {
            ItemKind::Hold(hold) => {
                let (ticks, any, on_arrival) = match &hold.end {
                    End::After { seconds } => (ticks(*seconds), Vec::new(), false),
                    End::Until { any, timeout_s } => (ticks(*timeout_s), any.clone(), false),
                    End::Arrival { any, bound_s } => (ticks_at_least(*bound_s), any.clone(), true),
                    End::Confirmed { any, timeout_s } => match context.hands {
                        Hands::People if !foreseen => (timeout_s.map_or(1, ticks), any.clone(), false),
                        // The rig is driven for as long as people take, which nobody knows.
                        Hands::People if drives(hold) => (ticks(timeout_s.unwrap_or(FORESEEN_S)), any.clone(), false),
                        Hands::People | Hands::Rig => (1, Vec::new(), false),
                    },
                };
                let untimed = matches!(&hold.end, End::Confirmed { timeout_s: None, .. });
                let open_ended = untimed && context.hands == Hands::People && drives(hold);
                let aim = hold.change.drive.as_ref().map(|drive| aim(drive, script, context, item.line)).transpose()?;
                let part = requests.of(hold, instructions.len(), item.line);
                instructions.push(Instruction {
                    line: item.line,
                    with: item.with.clone(),
                    jumps: Vec::new(),
                    aim,
                    brake_open: hold.change.brake_open,
                    bypass_open: hold.change.bypass_open,
                    fixture: hold.change.fixture,
                    ticks,
                    any,
                    on_arrival,
                    open_ended,
                    part,
                    new_segment: hold.new_segment,
                    guard_deg: None,
                    struck_at: None,
                });
            }
            ItemKind::Random { stream, steps } => {
                let mut rng = generator(script, context, *stream);
                random(&mut instructions, item, steps, context, &mut rng);
            }
        }
    }
    first_of_item.push(instructions.len());
    for (Item { skips, .. }, &first) in script.items.iter().zip(&first_of_item) {
        instructions[first].jumps =
            skips.iter().map(|skip| Jump { when: skip.when.clone(), to: first_of_item[skip.to] }).collect();
    }
    Ok(Playback::new(script.start, instructions, requests.into_list()))
}

/// Whether the pump has something to do in this hold.
fn drives(hold: &Hold) -> bool {
    hold.change.drive.as_ref().is_some_and(|drive| !drive.rests())
}

fn aim(drive: &Drive, script: &Script, context: &Context, line: usize) -> Result<Aim, ScriptError> {
    let u_max_v = context.u_max_v;
    let (least, most) = drive.wave.range();
    if drive.quantity == Controlled::VoltageV
        && let Some(voltage_v) = [most, least].into_iter().find(|voltage_v| voltage_v.abs() > u_max_v)
    {
        let row = match &drive.wave {
            Wave::Fixed(Signal::Table { table, .. }) => table.rows().iter().find(|row| row.value == voltage_v),
            _ => None,
        };
        let place = row.map_or(String::new(), |row| format!(" (line {} of its file)", row.line));
        let what = format!(
            "`voltage_v` reaches {voltage_v} V{place}, beyond the rig's largest voltage of {u_max_v} V: lower it, or use \
             `voltage_u_max`"
        );
        return Err(ScriptError { file: script.file.clone(), line, what });
    }
    Ok(Aim {
        quantity: drive.quantity,
        gain: if drive.quantity == Controlled::VoltageUMax { u_max_v } else { 1.0 },
        signal: match &drive.wave {
            Wave::Fixed(signal) => signal.clone(),
            Wave::Random(wave) => random_wave(wave, &mut generator(script, context, wave.stream)),
        },
    })
}

/// The generator of one block or wave: the seed and the script's name choose it, the number its stream.
fn generator(script: &Script, context: &Context, stream: u64) -> ChaCha8Rng {
    // FNV-1a, 64 bit: fixed for ever, unlike the standard library's hasher.
    let name = script
        .name
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    let mut rng = ChaCha8Rng::seed_from_u64(context.seed ^ name);
    rng.set_stream(stream);
    rng
}

fn random_wave(wave: &RandomWave, rng: &mut ChaCha8Rng) -> Signal {
    let mut steps = Vec::new();
    let mut begins = 0;
    while begins < wave.ticks {
        let value = rng.random_range(wave.range[0]..=wave.range[1]);
        let length = length(rng, wave.length_s, wave.ticks - begins);
        steps.push((begins, value));
        begins += length;
    }
    Signal::Steps(steps.into())
}

/// Draws the length of a step. What would be left behind it and is shorter than any step goes to it.
fn length(rng: &mut ChaCha8Rng, length_s: [f64; 2], left: u64) -> u64 {
    let length = ticks(rng.random_range(length_s[0]..=length_s[1]));
    if length + ticks(length_s[0]) > left { left } else { length }
}

fn random(
    instructions: &mut Vec<Instruction>,
    item: &Item,
    steps: &RandomSteps,
    context: &Context,
    rng: &mut ChaCha8Rng,
) {
    let total = ticks(steps.total_s);
    let mut done = 0;
    while done < total {
        // Every step draws the same five numbers, so that a changed share shifts none of the others.
        let length = length(rng, steps.length_s, total - done);
        let size = rng.random_range(steps.voltage_u_max[0]..=steps.voltage_u_max[1]);
        let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
        let zero = rng.random::<f64>() < steps.zero_share;
        let valves = rng.random::<f64>();
        let brake_closed = valves < steps.brake_closed_share;
        let bypass_open = !brake_closed && valves < steps.brake_closed_share + steps.bypass_open_share;
        let share = if zero { 0.0 } else { sign * size };
        instructions.push(Instruction {
            line: item.line,
            with: item.with.clone(),
            jumps: Vec::new(),
            aim: Some(Aim {
                quantity: Controlled::VoltageUMax,
                gain: context.u_max_v,
                signal: Signal::Constant(share),
            }),
            brake_open: Some(!brake_closed),
            bypass_open: Some(bypass_open),
            fixture: None::<FixtureChange>,
            ticks: length,
            any: Vec::new(),
            on_arrival: false,
            open_ended: false,
            part: Part::default(),
            new_segment: true,
            guard_deg: Some(steps.guard_deg),
            struck_at: None,
        });
        done += length;
    }
}
