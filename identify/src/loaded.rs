//! A campaign as it was read, and what its sensors' noise is.

use recordings::{Campaign, Protocol, Recording, Role, RunEntry};

use crate::corruption::{Corruption, clean};
use crate::identification::IdentifyError;
use crate::noise::{median, spread_about_line, white_std, white_std_of_adjacent};
use crate::plausible::{SetAside, examine};
use crate::prepare::{Channel, stretches};
use crate::problem::Problem;

/// A run as it was read.
pub struct LoadedRun {
    /// Its entry in the campaign.
    pub entry: RunEntry,
    /// Its samples, corrupted ones missing.
    pub recording: Recording,
    /// What was taken out of them.
    pub corruption: Corruption,
    /// Noise of one sample by channel, in the channel's unit, where the data tell it.
    pub noise: [Option<f64>; 5],
    /// Spread of the values about their straight line before the first motion of a run with a free lever, by channel: noise of
    /// any colour that a second shows.
    pub rest: [Option<f64>; 5],
    /// Step of a quantised channel, in the channel's unit; 0 for a continuous one.
    pub step: [f64; 5],
}

/// A campaign with all runs read.
pub struct Loaded {
    /// The campaign.
    pub campaign: Campaign,
    /// In the order of the campaign.
    pub runs: Vec<LoadedRun>,
    /// Sensors that are not used, and runs that are of no use without them; those are no runs of the campaign here.
    pub set_aside: Vec<SetAside>,
}

impl Loaded {
    /// Reads every run of the campaign in `dir`.
    pub fn read(dir: &std::path::Path) -> Result<Loaded, IdentifyError> {
        Loaded::of(Campaign::open(dir)?)
    }

    /// Reads every run that the campaign names, which may be fewer than its folder holds, and examines whether its columns can be
    /// what they say ([`examine`]).
    pub fn of(mut campaign: Campaign) -> Result<Loaded, IdentifyError> {
        let mut recordings = campaign.runs.iter().map(|entry| campaign.read(entry)).collect::<Result<_, _>>()?;
        let set_aside = examine(&mut campaign, &mut recordings)?;
        Ok(Loaded { set_aside, ..Loaded::from_recordings(campaign, recordings) })
    }

    /// Of recordings in the order of the campaign's runs. What no sensor can mean becomes missing.
    pub fn from_recordings(campaign: Campaign, recordings: Vec<Recording>) -> Loaded {
        let mut runs = Vec::new();
        for (entry, mut recording) in campaign.runs.iter().zip(recordings) {
            let corruption = clean(&mut recording, entry.protocol);
            let noise = Channel::ALL.map(|c| {
                let noise = match c {
                    Channel::Volume => white_std_of_adjacent(&readings(&recording)),
                    _ => white_std(c.of(&recording)),
                };
                noise.filter(|s| *s > 0.0)
            });
            let step =
                Channel::ALL.map(|c| if c == Channel::Volume { 0.0 } else { crate::noise::step(c.of(&recording)) });
            let rest = Channel::ALL.map(|c| at_rest(&recording, entry.protocol, c));
            runs.push(LoadedRun { entry: entry.clone(), recording, corruption, noise, rest, step });
        }
        let mut loaded = Loaded { campaign, runs, set_aside: Vec::new() };
        loaded.without_the_motion();
        loaded
    }

    /// The noise of slow rows of a free lever without what its motion makes of them: second differences of rows that are [`SLOW_ROWS_S`] apart
    /// see the lever's swing. What the rests show counts where it is less.
    fn without_the_motion(&mut self) {
        let is_slow = |run: &LoadedRun| is_free(run.entry.protocol) && spacing_s(&run.recording) > SLOW_ROWS_S;
        if !self.runs.iter().any(is_slow) {
            return;
        }
        for role in [Role::Identify, Role::Validate] {
            for channel in Channel::ALL {
                let shown = |run: &LoadedRun| -> Option<f64> {
                    let rows = run.recording.voltage_v.iter().position(|u| *u != 0.0).filter(|_| is_slow(run))?;
                    white_std(&channel.of(&run.recording)[..rows]).filter(|noise| *noise > 0.0)
                };
                let Some(at_rest) = self.median_for(role, shown) else { continue };
                for run in self.runs.iter_mut().filter(|run| run.entry.role == role && is_slow(run)) {
                    let noise = &mut run.noise[channel.index()];
                    *noise = noise.map(|moving| moving.min(at_rest));
                }
            }
        }
    }

    /// Median over the runs with this role of what they tell. Runs that are only simulated may ask the others where none of theirs tells it; what
    /// is fitted never rests on them.
    fn median_for(&self, role: Role, told: impl Fn(&LoadedRun) -> Option<f64>) -> Option<f64> {
        let of = |own: bool| self.runs.iter().filter(move |run| (run.entry.role == role) == own).filter_map(&told);
        let mut all: Vec<f64> = of(true).collect();
        if all.is_empty() && role == Role::Validate {
            all.extend(of(false));
        }
        (!all.is_empty()).then(|| median(&mut all))
    }

    /// Stretches and weights of the runs with this role.
    pub fn problem(&self, role: Role) -> Result<Problem, IdentifyError> {
        let mut problem = Problem::default();
        for (n, run) in self.runs.iter().enumerate().filter(|(_, r)| r.entry.role == role) {
            let pieces = stretches(n, &run.entry.file, run.entry.protocol, run.entry.plane, &run.recording)?;
            for channel in Channel::ALL {
                let compared = pieces.iter().any(|s| s.targets.iter().any(|t| t.channel == channel));
                if compared && self.told_noise(n, channel).is_none() {
                    tracing::warn!(
                        file = run.entry.file.as_str(),
                        column = channel.column(),
                        assumed = UNKNOWN_NOISE[channel.index()],
                        "no run tells the noise of this sensor: it is assumed"
                    );
                }
            }
            for s in pieces {
                problem.std.push(Channel::ALL.map(|c| self.noise_of(n, c)).to_vec());
                problem.steps.push(Channel::ALL.map(|c| self.undithered(n, c)).to_vec());
                problem.stretches.push(s);
            }
        }
        Ok(problem)
    }

    /// Mean square that a sensor's steps leave structured, in units of its noise squared: where the noise is too small to
    /// dither them.
    fn undithered(&self, run: usize, channel: Channel) -> f64 {
        let step = self.runs[run].step[channel.index()];
        let noise = self.runs[run].noise[channel.index()].unwrap_or(0.0);
        if noise < 0.4 * step { step * step / 12.0 / self.noise_of(run, channel).powi(2) } else { 0.0 }
    }

    /// RMS of a channel's sensor noise in a run, its colour included: what no model can do better than.
    pub fn floor_of(&self, run: usize, channel: Channel) -> f64 {
        let mut rests: Vec<f64> = self.runs.iter().filter_map(|r| r.rest[channel.index()]).collect();
        self.noise_of(run, channel).max(median(&mut rests))
    }

    /// Noise of one sample of a channel in a run, at least what its steps make; where the run does not tell it, the median of the other runs with
    /// its role; where nothing does, what is usual.
    pub fn noise_of(&self, run: usize, channel: Channel) -> f64 {
        self.told_noise(run, channel).unwrap_or(UNKNOWN_NOISE[channel.index()])
    }

    /// The same where a run tells it.
    fn told_noise(&self, run: usize, channel: Channel) -> Option<f64> {
        let c = channel.index();
        // the clamp-steps hold one reading of the cylinder for a whole segment: the pump map tells its noise
        let own = match (self.runs[run].entry.protocol, channel) {
            (Protocol::ClampSteps, Channel::Volume) => None,
            _ => self.runs[run].noise[c],
        };
        let least = self.runs[run].step[c] / 12f64.sqrt();
        own.map(|s| s.max(least)).or_else(|| {
            self.median_for(self.runs[run].entry.role, |r| {
                let tells = r.entry.protocol != Protocol::ClampSteps && r.entry.protocol != Protocol::VolumeMap;
                r.noise[c].filter(|_| tells)
            })
        })
    }
}

/// Rows further apart than this, s, show the swing of a lever of some 10 Hz in their second differences.
const SLOW_ROWS_S: f64 = 0.015;

/// Usual distance of the rows, s.
fn spacing_s(r: &Recording) -> f64 {
    median(&mut r.time_s.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>())
}

fn is_free(protocol: Protocol) -> bool {
    matches!(protocol, Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps)
}

/// See [`LoadedRun::rest`].
fn at_rest(r: &Recording, protocol: Protocol, channel: Channel) -> Option<f64> {
    const FEWEST: usize = 50;
    let rows = r.voltage_v.iter().position(|u| *u != 0.0)?;
    let known: Vec<f64> = channel.of(r)[..rows].iter().copied().filter(|v| v.is_finite()).collect();
    if !is_free(protocol) || known.len() < FEWEST {
        return None;
    }
    Some(spread_about_line(&known)).filter(|s| *s > 0.0)
}

/// The cylinder's readings, with a `NaN` where a segment ends and it starts anew.
fn readings(r: &Recording) -> Vec<f64> {
    let mut out = Vec::new();
    for i in 0..r.len() {
        if i > 0 && r.segment[i] != r.segment[i - 1] {
            out.push(f64::NAN);
        }
        if r.volume_ml[i].is_finite() {
            out.push(r.volume_ml[i]);
        }
    }
    out
}

/// Noise that is assumed where no run tells it: degrees, bar, bar, Nm, ml.
const UNKNOWN_NOISE: [f64; 5] = [0.01, 0.01, 0.01, 0.05, 0.05];

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use recordings::{Plane, RigFacts};

    /// A free lever that swings by 10 degrees at 0.7 Hz behind 1.2 s of rest, with rows so far apart and so much noise on angle and pressures.
    fn swinging(spacing_s: f64, noise: f64, seed: u64) -> Recording {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut draw = || -> f64 { noise * rng_normal(&mut rng) };
        let mut r = Recording::default();
        for row in 0..(60.0 / spacing_s) as usize {
            let time_s = row as f64 * spacing_s;
            let moving_s = (time_s - 1.2).max(0.0);
            let swing = (std::f64::consts::TAU * 0.7 * moving_s).sin();
            r.time_s.push(time_s);
            r.voltage_v.push(if moving_s > 0.0 { 10.0 * swing.signum() } else { 0.0 });
            r.angle_deg.push(10.0 * swing + draw());
            r.pressure1_bar.push(3.0 + swing + draw());
            r.pressure2_bar.push(3.0 - swing + draw());
            r.torque_nm.push(f64::NAN);
            r.volume_ml.push(f64::NAN);
            r.brake_open.push(true);
            r.bypass_open.push(false);
            r.segment.push(0);
        }
        r
    }

    fn rng_normal(rng: &mut rand_chacha::ChaCha8Rng) -> f64 {
        StandardNormal.sample(rng)
    }

    fn loaded(runs: Vec<(Role, Recording)>) -> Loaded {
        let entry = |(n, (role, _)): (usize, &(Role, Recording))| RunEntry {
            file: format!("{n}.csv"),
            protocol: Protocol::SquareWave,
            role: *role,
            plane: Plane::Horizontal,
        };
        let campaign = Campaign {
            dir: "made".into(),
            name: "made".into(),
            rig: RigFacts { inertia_kg_m2: 0.085, gravity_nm: 4.0, u_max_v: 24.0 },
            runs: runs.iter().enumerate().map(entry).collect(),
        };
        Loaded::from_recordings(campaign, runs.into_iter().map(|(_, r)| r).collect())
    }

    #[test]
    fn slow_rows_of_a_lever_that_swings_have_the_noise_of_their_rests() {
        let runs = |spacing_s: f64| (0..5).map(|n| (Role::Identify, swinging(spacing_s, 0.01, n))).collect::<Vec<_>>();
        for (spacing_s, within) in [(0.005, 0.1), (0.03, 0.3), (0.1, 0.5)] {
            let all = loaded(runs(spacing_s));
            for channel in [Channel::Angle, Channel::Pressure1] {
                let found = all.noise_of(0, channel);
                assert!((found / 0.01 - 1.0).abs() < within, "{spacing_s} s, {}: {found}", channel.column());
            }
        }
        // faster rows are left as they are
        let all = loaded(runs(0.01));
        assert_eq!(Some(all.noise_of(0, Channel::Angle)), white_std(&all.runs[0].recording.angle_deg));
    }

    #[test]
    fn what_is_fitted_takes_no_noise_from_a_run_that_is_not() {
        let silent = || {
            let mut r = swinging(0.005, 0.01, 1);
            r.pressure2_bar.fill(f64::NAN);
            r
        };
        let channel = Channel::Pressure2;
        let all = loaded(vec![
            (Role::Identify, silent()),
            (Role::Identify, swinging(0.005, 0.01, 2)),
            (Role::Validate, swinging(0.005, 0.1, 3)),
            (Role::Validate, swinging(0.005, 0.1, 4)),
            (Role::Validate, silent()),
        ]);
        assert!((all.noise_of(0, channel) / 0.01 - 1.0).abs() < 0.1, "{}", all.noise_of(0, channel));
        assert!((all.noise_of(4, channel) / 0.1 - 1.0).abs() < 0.1, "{}", all.noise_of(4, channel));
        // where no run with its role tells it, it is assumed, and said to be; what is only simulated asks the others
        let none = loaded(vec![(Role::Identify, silent()), (Role::Validate, swinging(0.005, 0.1, 3))]);
        assert_eq!((none.told_noise(0, channel), none.noise_of(0, channel)), (None, UNKNOWN_NOISE[2]));
        let other = loaded(vec![(Role::Identify, swinging(0.005, 0.01, 2)), (Role::Validate, silent())]);
        assert!((other.noise_of(1, channel) / 0.01 - 1.0).abs() < 0.1, "{}", other.noise_of(1, channel));
    }
}
