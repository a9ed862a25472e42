//! A stretch: a piece of a run that is simulated from one initial state, with its inputs and targets.

use model::port::{Before, Held, Ran};
use model::rec::{Circuit, Input, Lever};
use recordings::{Protocol, Recording};

use crate::guide::Guide;
use crate::noise::mean;

/// What is compared with the model: a position among the plant's channels ([`crate::plant::PlantHeader::channels`]). Those of
/// the REC rig have names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Channel(pub u8);

#[allow(non_upper_case_globals, reason = "they read as the variants of the rig's channels")]
impl Channel {
    /// Encoder, degrees.
    pub const Angle: Channel = Channel(0);
    /// bar absolute
    pub const Pressure1: Channel = Channel(1);
    /// bar absolute
    pub const Pressure2: Channel = Channel(2);
    /// Torque that the clamp holds, Nm.
    pub const Torque: Channel = Channel(3);
    /// Measuring cylinder, ml.
    pub const Volume: Channel = Channel(4);
    /// All of the REC rig.
    pub const ALL: [Channel; 5] =
        [Channel::Angle, Channel::Pressure1, Channel::Pressure2, Channel::Torque, Channel::Volume];
    /// Position among the plant's channels.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
    /// Column of the campaign contract.
    pub fn column(self) -> &'static str {
        ["angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml"][self.index()]
    }
    /// This channel of a recording.
    pub fn of(self, r: &Recording) -> &[f64] {
        [&r.angle_deg, &r.pressure1_bar, &r.pressure2_bar, &r.torque_nm, &r.volume_ml][self.index()]
    }
}

/// How the plant stands in a stretch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stand {
    /// The lever is free.
    Free,
    /// The angle is an input; pump and valves work.
    Led,
    /// The angle is an input; the chambers are shut off.
    LedShutOff,
    /// Angle and pressures are inputs; the chambers are shut off and chamber 1 is drained.
    Drained,
    /// Pump alone; the pressures are inputs.
    Bench,
}

/// The mean of the valid samples of one channel over some rows.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Channel.
    pub channel: Channel,
    /// Mean of the measured values.
    pub measured: f64,
    /// Number of samples in the mean.
    pub samples: usize,
    /// Position in the stretch of the row that stands for the whole, where the sensitivities are taken.
    pub middle: usize,
    /// Time of that row, s since the run's start.
    pub time_s: f64,
}

/// A piece of a run that is simulated from one initial state.
///
/// The REC rig has named inputs (voltage, valves, led angle and pressures), which are empty for any other plant; that has
/// columns, in the order of its header.
#[derive(Clone, Debug)]
pub struct Stretch {
    /// Position of the run in the campaign.
    pub run: usize,
    /// The run's file, to be named where something goes wrong; empty for a plant's table.
    pub file: String,
    /// Its protocol, if it is of a campaign of the REC rig.
    pub protocol: Option<Protocol>,
    /// How the plant stands; one without a lever is [`Stand::Free`] too.
    pub stand: Stand,
    /// Gravity acts.
    pub vertical: bool,
    /// Times of the rows, s since the run's start.
    pub time_s: Vec<f64>,
    /// Voltage, V.
    pub voltage_v: Vec<f64>,
    /// Brake valve.
    pub brake_open: Vec<bool>,
    /// Bypass valve.
    pub bypass_open: Vec<bool>,
    /// Angle as an input, rad; empty where it is not one.
    pub angle_rad: Vec<f64>,
    /// Turning points of the way on which a led lever came to its first angle, rad; that angle is the last. Empty: not known, or free.
    pub way_rad: Vec<f64>,
    /// What a led lever is held with at first, where the way there is not known and that was measured.
    pub held: Option<Held>,
    /// What the pump has done since the run's start.
    pub ran: Vec<Ran>,
    /// What was before, where the lever is led or the pump on its bench, with angle and pressures as inputs: it says how the effects begin that remember.
    pub past: Option<Box<Stretch>>,
    /// Pressures as inputs, bar absolute; empty where they are not.
    pub pressure_bar: [Vec<f64>; 2],
    /// Inputs of another plant by column, one value a row.
    pub inputs: Vec<Vec<f64>>,
    /// Initial angle (rad) and pressures (bar absolute) as the sensors show them; on another plant its states.
    pub initial: Vec<f64>,
    /// Standard errors of the initial values; 0 = taken as exact.
    pub initial_std: Vec<f64>,
    /// Measured values by channel, one a row; `NaN` = none. Channels that are not targets are empty.
    pub measured: Vec<Vec<f64>>,
    /// The simulation follows what was measured, as an observer does; `None`: it runs free.
    pub guide: Option<Guide>,
    /// First rows of the blocks over which targets are averaged, and the number of rows at the end.
    pub blocks: Vec<usize>,
    /// What is compared, in the order of the blocks, then of the channels.
    pub targets: Vec<Target>,
}

impl Stretch {
    /// A stretch of a plant other than the REC rig: input and measured columns in the order of its header, initial states with
    /// their standard errors, and the number of rows over which targets are averaged.
    pub fn of_columns(
        run: usize,
        time_s: Vec<f64>,
        inputs: Vec<Vec<f64>>,
        measured: Vec<Vec<f64>>,
        (initial, initial_std): (Vec<f64>, Vec<f64>),
        block: usize,
    ) -> Stretch {
        let rows = time_s.len();
        let alike = inputs.iter().chain(&measured).all(|c| c.len() == rows);
        assert!(rows >= 2 && alike && initial.len() == initial_std.len(), "columns of a stretch have one value a row");
        Stretch {
            run,
            file: String::new(),
            protocol: None,
            stand: Stand::Free,
            vertical: false,
            time_s,
            voltage_v: Vec::new(),
            brake_open: Vec::new(),
            bypass_open: Vec::new(),
            angle_rad: Vec::new(),
            way_rad: Vec::new(),
            held: None,
            ran: Vec::new(),
            past: None,
            pressure_bar: [Vec::new(), Vec::new()],
            inputs,
            initial,
            initial_std,
            measured,
            guide: None,
            blocks: (0..rows).step_by(block.max(1)).collect(),
            targets: Vec::new(),
        }
        .finish()
    }

    /// All that drives it, and all that it starts from, is known.
    pub(super) fn has_inputs(&self) -> bool {
        let inputs = self.angle_rad.iter().chain(self.pressure_bar.iter().flatten());
        inputs.chain(&self.initial).all(|v| v.is_finite())
    }

    /// What was before it, as its effects remember it.
    pub fn before(&self) -> Before<'_> {
        Before { way_rad: &self.way_rad, held: self.held, ran: &self.ran }
    }

    /// The input before it, of which nothing is known: a pump on its bench is started from standstill.
    pub fn input_before(&self) -> Input {
        let input = self.input(0, 1.0);
        if self.stand == Stand::Bench { Input { voltage_v: 0.0, ..input } } else { input }
    }

    /// The input that acts from row `i` on for `dt` seconds, to the next row.
    pub fn input(&self, i: usize, dt: f64) -> Input {
        self.input_over(i, i + 1, dt)
    }

    /// The input that leads from row `i` to a later one, between which it goes on as it does.
    pub fn input_to(&self, i: usize, to: usize) -> Input {
        self.input_over(i, to, self.time_s[to] - self.time_s[i])
    }

    fn input_over(&self, i: usize, to: usize, dt: f64) -> Input {
        let velocity = |series: &[f64]| if to < series.len() { (series[to] - series[i]) / dt } else { 0.0 };
        let lever = match self.stand {
            Stand::Free => Lever::Free,
            Stand::Bench => Lever::Led { velocity_rad_s: 0.0 },
            _ => Lever::Led { velocity_rad_s: velocity(&self.angle_rad) },
        };
        let circuit = match self.stand {
            Stand::Free | Stand::Led => Circuit::Pump,
            Stand::LedShutOff => Circuit::ShutOff { release_ml_s: 0.0 },
            Stand::Drained => Circuit::Measured {
                rate1_bar_s: velocity(&self.pressure_bar[0]),
                rate2_bar_s: velocity(&self.pressure_bar[1]),
            },
            Stand::Bench => Circuit::Bench,
        };
        Input {
            voltage_v: self.voltage_v[i],
            brake_open: self.brake_open[i],
            bypass_open: self.bypass_open[i],
            vertical: self.vertical,
            lever,
            circuit,
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.time_s.len()
    }

    /// The same from its start on for `length_s`, where the lever (or whatever moves) is free and the stretch is longer.
    pub fn shortened(&self, length_s: f64) -> Self {
        let mut s = self.clone();
        let end = self.time_s.partition_point(|t| *t < self.time_s[0] + length_s);
        let blocks = self.blocks.partition_point(|b| *b <= end);
        if self.stand != Stand::Free || end >= self.rows() || blocks < 2 {
            return s;
        }
        s.blocks.truncate(blocks);
        let rows = s.blocks[blocks - 1];
        s.time_s.truncate(rows);
        s.voltage_v.truncate(rows);
        s.brake_open.truncate(rows);
        s.bypass_open.truncate(rows);
        s.inputs.iter_mut().chain(&mut s.measured).for_each(|m| m.truncate(rows));
        s.targets.retain(|t| t.middle < rows);
        s
    }

    pub(super) fn finish(mut self) -> Self {
        let end = self.rows();
        if self.blocks.last() != Some(&end) {
            self.blocks.push(end);
        }
        for b in self.blocks.windows(2) {
            for (c, values) in self.measured.iter().enumerate() {
                let channel = Channel(c as u8);
                if values.is_empty() {
                    continue;
                }
                let (measured, samples) = mean(values[b[0]..b[1]].iter().copied());
                if samples > 0 {
                    let valid: Vec<usize> = (b[0]..b[1]).filter(|&i| values[i].is_finite()).collect();
                    let middle = valid[valid.len() / 2];
                    self.targets.push(Target { channel, measured, samples, middle, time_s: self.time_s[middle] });
                }
            }
        }
        self
    }
}
