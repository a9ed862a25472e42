//! What the script wants, beside what is measured. Samples don't carry it, so the script is played once more on the samples as they come:
//! the same measurements at the same ticks give the same steps.

use super::buckets::Channel;
use profiles::Playback;
use rt_core::{ControlledPressure, Reference, Sample, Target, Tick};

/// Quantities that a sensor measures and a script can ask for.
pub const COUNT: usize = 3;

/// Named after the channels that they are the references of, in the order of [`Wanted`].
pub const CHANNELS: [Channel; COUNT] = [
    Channel { name: "reference_angle_deg", label: "reference", unit: "deg", group: "angle" },
    Channel { name: "reference_pressure1_bar", label: "reference 1", unit: "bar", group: "pressure" },
    Channel { name: "reference_pressure2_bar", label: "reference 2", unit: "bar", group: "pressure" },
];

/// Values of a tick, in the order of [`CHANNELS`]; NaN: none is wanted, or what is wanted is not known.
pub type Wanted = [f32; COUNT];

/// Nothing.
pub const NOTHING: Wanted = [f32::NAN; COUNT];

/// A script that is played along with a run.
#[derive(Debug)]
pub struct Shadow {
    /// `None` from where it can't be told any more how the run's own script goes on.
    playback: Option<Playback>,
    /// Number of the next sample.
    expected: u64,
}

impl Shadow {
    /// Of a run whose first sample is still to come. `None`: its script is not known.
    pub fn new(playback: Option<Playback>) -> Self {
        Shadow { playback, expected: 0 }
    }

    /// What is wanted at this sample. Samples come in order; where one is missing, or the sample's step is another than the script's, nothing is
    /// said from there on: a wrong reference is worse than none.
    pub fn at(&mut self, sample: &Sample) -> Wanted {
        if self.playback.is_none() || sample.sequence() != self.expected {
            self.playback = None;
            return NOTHING;
        }
        self.expected += 1;
        // The rig goes safe, and follows nothing.
        if sample.tripped() || sample.fault() {
            self.playback = None;
        }
        let Some(playback) = &mut self.playback else { return NOTHING };
        let now = Tick::at(sample.tick);
        if sample.confirmed() {
            playback.confirmed(now);
        }
        let step = playback.step(now, &sample.measurement());
        if step.index != sample.step {
            self.playback = None;
            return NOTHING;
        }
        wanted(step.target)
    }
}

fn wanted(target: Target) -> Wanted {
    let none = f32::NAN;
    match target {
        Target::AngleDeg { angle_deg, .. } => [angle_deg as f32, none, none],
        Target::PressureBar { of: ControlledPressure::Chamber1, bar } => [none, bar as f32, none],
        Target::PressureBar { of: ControlledPressure::Chamber2, bar } => [none, none, bar as f32],
        // A difference has no channel of its own; voltage and flow are commands.
        Target::PressureBar { of: ControlledPressure::Difference, .. } | Target::VoltageV(_) | Target::FlowMlS(_) => {
            NOTHING
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use profiles::{Context, Hands, Script};
    use rt_core::flags;

    /// Waits for an angle, then holds another one.
    fn shadow() -> Shadow {
        let text = "name = \"a\"\nprotocol = \"square-wave\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
             [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\n\
             [[step]]\ntarget = { angle_deg = 10.0 }\nuntil = [{ channel = \"angle_deg\", above = 5.0 }]\ntimeout_s = 1.0\n\
             [[step]]\ntarget = { pressure2_bar = 3.0 }\nfor_s = 1.0\n";
        let script = Script::parse(text, "test").expect("a script");
        Shadow::new(Some(script.compile(&Context { u_max_v: 24.0, seed: 1, hands: Hands::Rig }).expect("it compiles")))
    }

    fn sample(tick: u64, angle_deg: f64, step: u32) -> Sample {
        Sample { tick, scheduled_ns: tick * rt_core::PERIOD_NS, angle_deg, step, ..Sample::BLANK }
    }

    fn text(wanted: Wanted) -> String {
        format!("{wanted:?}")
    }

    #[test]
    fn it_goes_on_with_the_measurements_as_the_run_does() {
        let mut shadow = shadow();
        for tick in 0..300 {
            assert_eq!(text(shadow.at(&sample(tick, 1.0, 0))), "[10.0, NaN, NaN]", "tick {tick}");
        }
        assert_eq!(text(shadow.at(&sample(300, 6.0, 1))), "[NaN, NaN, 3.0]");
        assert_eq!(text(shadow.at(&sample(301, 6.0, 1))), "[NaN, NaN, 3.0]");
    }

    #[test]
    fn it_says_nothing_once_the_run_may_be_elsewhere() {
        let known = |shadow: &mut Shadow, sample: &Sample| shadow.at(sample).iter().any(|value| !value.is_nan());
        let mut missed = shadow();
        assert!(known(&mut missed, &sample(0, 1.0, 0)) && !known(&mut missed, &sample(2, 1.0, 0)));
        assert!(!known(&mut missed, &sample(3, 1.0, 0)), "and stays silent");
        let mut other_step = shadow();
        assert!(!known(&mut other_step, &sample(0, 1.0, 1)));
        assert!(!known(&mut shadow(), &sample(7, 1.0, 0)), "joined late");
        let mut tripped = shadow();
        assert!(!known(&mut tripped, &Sample { flags: flags::TRIPPED, ..sample(0, 1.0, 0) }));
        // Ticks that the loop passed over are not missing.
        let mut skipped = shadow();
        assert!(known(&mut skipped, &sample(0, 1.0, 0)));
        assert!(known(&mut skipped, &Sample { skipped: 4, ..sample(5, 1.0, 0) }));
        assert!(!known(&mut Shadow::new(None), &sample(0, 1.0, 0)));
    }
}
