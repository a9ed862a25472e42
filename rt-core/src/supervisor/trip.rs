//! Why the supervisor tripped.

use std::fmt;

/// What was judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Channel {
    /// Pressure of chamber 1.
    Pressure1 = 1,
    /// Pressure of chamber 2.
    Pressure2 = 2,
    /// Angle of the lever.
    Angle = 3,
    /// Velocity of the lever, from angle differences.
    Velocity = 4,
    /// Torque on the clamp.
    Torque = 5,
    /// The commanded voltage.
    Voltage = 6,
    /// Signs of life of the device's drivers.
    Heartbeat = 7,
    /// The loop's own deadline.
    Deadline = 8,
    /// A person.
    EmergencyStop = 9,
}

impl Channel {
    /// All of them, in the order of their numbers.
    pub const ALL: [Channel; 9] = [
        Channel::Pressure1,
        Channel::Pressure2,
        Channel::Angle,
        Channel::Velocity,
        Channel::Torque,
        Channel::Voltage,
        Channel::Heartbeat,
        Channel::Deadline,
        Channel::EmergencyStop,
    ];

    /// The channel of a sample's [`Trip::code`]; `None` for 0 and for what no trip has.
    pub fn of_code(code: u32) -> Option<Channel> {
        Channel::ALL.into_iter().find(|&channel| channel as u32 == code & 0xff)
    }

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            Channel::Pressure1 => "pressure 1",
            Channel::Pressure2 => "pressure 2",
            Channel::Angle => "angle",
            Channel::Velocity => "velocity",
            Channel::Torque => "torque",
            Channel::Voltage => "voltage",
            Channel::Heartbeat => "heartbeat of the drivers",
            Channel::Deadline => "deadline",
            Channel::EmergencyStop => "emergency stop",
        }
    }

    /// Unit of the channel's values and limits.
    pub fn unit(self) -> &'static str {
        match self {
            Channel::Pressure1 | Channel::Pressure2 => "bar",
            Channel::Angle => "deg",
            Channel::Velocity => "deg/s",
            Channel::Torque => "Nm",
            Channel::Voltage => "V",
            Channel::Heartbeat | Channel::Deadline => "ms",
            Channel::EmergencyStop => "",
        }
    }
}

/// How a limit was broken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Breach {
    /// The value is below this limit.
    Below(f64),
    /// The value is above this limit.
    Above(f64),
    /// The value is no number, where a command must be one.
    NotFinite,
    /// A required value was missing, or called wrong by its device, for more than this many ticks in a row.
    Missing(u32),
    /// The value is older than this, ms.
    Stale(f64),
    /// Somebody asked for it.
    Demanded,
}

impl Breach {
    fn code(self) -> u32 {
        match self {
            Breach::Below(_) => 1,
            Breach::Above(_) => 2,
            Breach::NotFinite => 3,
            Breach::Missing(_) => 4,
            Breach::Stale(_) => 5,
            Breach::Demanded => 6,
        }
    }
}

/// Why the supervisor tripped. The first breach counts; later ones are consequences.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trip {
    /// The tick at which it tripped; that tick's command already is the safe state.
    pub tick: u64,
    /// What was judged.
    pub channel: Channel,
    /// The value, in the channel's unit; NaN where it was missing. Of a stale channel: its age, ms.
    pub value: f64,
    /// The limit and the side on which it was broken.
    pub breach: Breach,
}

impl Trip {
    /// The number that samples carry: the channel's, plus 256 times the breach's. Channels: 1 pressure 1, 2 pressure 2,
    /// 3 angle, 4 velocity, 5 torque, 6 voltage, 7 heartbeat, 8 deadline, 9 emergency stop. Breaches: 1 below, 2 above,
    /// 3 not finite, 4 missing, 5 stale, 6 demanded.
    pub fn code(&self) -> u32 {
        self.channel as u32 | self.breach.code() << 8
    }
}

impl fmt::Display for Trip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Trip { tick, channel, value, breach } = self;
        let (name, unit) = (channel.name(), channel.unit());
        match breach {
            Breach::Above(limit) if *channel == Channel::Deadline => {
                write!(
                    f,
                    "{name} missed: {value:.2} ms since the tick should have begun, limit {limit} ms, at tick {tick}"
                )
            }
            Breach::Below(limit) => write!(f, "{name} {value:.4} {unit} below {limit} {unit} at tick {tick}"),
            Breach::Above(limit) => write!(f, "{name} {value:.4} {unit} above {limit} {unit} at tick {tick}"),
            Breach::NotFinite => write!(f, "{name} is {value}, not a finite number, at tick {tick}"),
            Breach::Missing(limit) => write!(f, "{name} missing for more than {limit} ticks at tick {tick}"),
            Breach::Stale(limit) => write!(f, "{name} is {value:.1} ms old, limit {limit} ms, at tick {tick}"),
            Breach::Demanded => write!(f, "{name} demanded at tick {tick}"),
        }
    }
}
