//! What a run is, as far as it says so: from the profile that was queued, or from what any run announces before its first sample.

use super::view;
use crate::setup::Setup;
use profiles::{Context, OutlineRow, Playback, Script};
use recordings::RunMetadata;

/// See the module.
pub struct Described {
    name: String,
    protocol: String,
    role: String,
    plane: String,
    seed: Option<u64>,
    script: Option<Unrolled>,
}

/// A script as it is played.
struct Unrolled {
    playback: Playback,
    outline: Vec<OutlineRow>,
    /// At most, s.
    duration_s: f64,
}

impl Unrolled {
    fn new(script: &Script, context: &Context) -> Option<Unrolled> {
        // What can't be compiled is refused by the run itself, with the reason.
        let playback = script.compile(context).ok()?;
        let duration_s = rt_core::Tick::at(playback.ticks_bound()).seconds();
        Some(Unrolled { playback, outline: script.outline(), duration_s })
    }
}

impl Described {
    /// A profile, played so.
    pub fn queued(script: &Script, context: &Context) -> Self {
        Described {
            name: script.name.clone(),
            protocol: script.protocol.as_str().to_owned(),
            role: script.role.as_str().to_owned(),
            plane: script.plane.as_str().to_owned(),
            seed: Some(context.seed),
            script: Unrolled::new(script, context),
        }
    }

    /// What was announced, or `None` where these bytes are of another build.
    pub fn announced(bytes: &[u8]) -> Option<Self> {
        let run = RunMetadata::from_record(bytes).ok()?;
        let setup = Setup::of_recorded(&run, "announced run").ok();
        let script = Script::parse(&run.profile, "announced profile").ok();
        let script = setup.as_ref().zip(script.as_ref()).and_then(|(setup, script)| {
            let Setup { u_max_v, seed, hands, .. } = *setup;
            Unrolled::new(script, &Context { u_max_v, seed, hands })
        });
        Some(Described {
            name: run.name,
            protocol: run.protocol.to_string(),
            role: run.role.to_string(),
            plane: run.plane.to_string(),
            seed: setup.map(|setup| setup.seed),
            script,
        })
    }

    /// The run's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Fills in what is known of the run.
    pub fn fill(&self, run: &mut view::Run) {
        run.name.clone_from(&self.name);
        run.protocol = Some(self.protocol.clone());
        run.role = Some(self.role.clone());
        run.plane = Some(self.plane.clone());
        run.seed = self.seed;
        run.duration_s = self.script.as_ref().map(|script| script.duration_s);
    }

    /// The step with this index, in words.
    pub fn step(&self, index: u32) -> Option<view::Step> {
        let Unrolled { playback, outline, .. } = self.script.as_ref()?;
        let place = playback.place(index)?;
        let row = outline.iter().find(|row| row.line == place.line);
        let what = row.map_or(String::new(), |row| match row.ends.as_str() {
            "" => format!(": {}", row.what),
            ends => format!(": {} ({ends})", row.what),
        });
        Some(view::Step { index, text: format!("{place}{what}") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use profiles::Hands;

    #[test]
    fn a_built_in_profile_is_described_with_its_steps() {
        let script = crate::commands::run::profile("square_h").expect("it is built in");
        let context = Context { u_max_v: 24.0, seed: 3, hands: Hands::Rig };
        let described = Described::queued(&script, &context);
        let mut run = view::Run::default();
        described.fill(&mut run);
        assert_eq!((run.name.as_str(), run.seed), ("square_h", Some(3)));
        assert!((run.duration_s.expect("it has an end") - script.duration_bound_s()).abs() < 0.1);
        let step = described.step(0).expect("it has a first step");
        assert!(step.text.starts_with("line ") && step.text.contains(": "), "{step:?}");
        assert_eq!(described.step(1_000_000), None);
        assert!(Described::announced(b"of another build").is_none());
    }
}
