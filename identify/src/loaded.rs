//! A campaign as it was read, and what its sensors' noise is.

use recordings::{Campaign, Protocol, Recording, Role, RunEntry};

use crate::corruption::{Corruption, clean};
use crate::identification::IdentifyError;
use crate::noise::{median, spread_about_line, white_std};
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
                let values: Vec<f64> =
                    if c == Channel::Volume { readings(&recording) } else { c.of(&recording).to_vec() };
                white_std(&values).filter(|s| *s > 0.0)
            });
            let step =
                Channel::ALL.map(|c| if c == Channel::Volume { 0.0 } else { crate::noise::step(c.of(&recording)) });
            let rest = Channel::ALL.map(|c| at_rest(&recording, entry.protocol, c));
            runs.push(LoadedRun { entry: entry.clone(), recording, corruption, noise, rest, step });
        }
        Loaded { campaign, runs, set_aside: Vec::new() }
    }

    /// Stretches and weights of the runs with this role.
    pub fn problem(&self, role: Role) -> Result<Problem, IdentifyError> {
        let mut problem = Problem::default();
        for (n, run) in self.runs.iter().enumerate().filter(|(_, r)| r.entry.role == role) {
            let pieces = stretches(n, &run.entry.file, run.entry.protocol, run.entry.plane, &run.recording)?;
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

    /// Noise of one sample of a channel in a run, at least what its steps make; where the run does not tell it, the median of the other runs.
    pub fn noise_of(&self, run: usize, channel: Channel) -> f64 {
        let c = channel.index();
        // the clamp-steps hold one reading of the cylinder for a whole segment: the pump map tells its noise
        let own = match (self.runs[run].entry.protocol, channel) {
            (Protocol::ClampSteps, Channel::Volume) => None,
            _ => self.runs[run].noise[c],
        };
        let least = self.runs[run].step[c] / 12f64.sqrt();
        own.map(|s| s.max(least)).unwrap_or_else(|| {
            let mut others: Vec<f64> = self
                .runs
                .iter()
                .filter(|r| r.entry.protocol != Protocol::ClampSteps && r.entry.protocol != Protocol::VolumeMap)
                .filter_map(|r| r.noise[c])
                .collect();
            if others.is_empty() { UNKNOWN_NOISE[c] } else { median(&mut others) }
        })
    }
}

/// See [`LoadedRun::rest`].
fn at_rest(r: &Recording, protocol: Protocol, channel: Channel) -> Option<f64> {
    const FEWEST: usize = 50;
    let free = matches!(protocol, Protocol::ConstantFlow | Protocol::SquareWave | Protocol::RandomSteps);
    let rows = r.voltage_v.iter().position(|u| *u != 0.0)?;
    let known: Vec<f64> = channel.of(r)[..rows].iter().copied().filter(|v| v.is_finite()).collect();
    if !free || known.len() < FEWEST {
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
