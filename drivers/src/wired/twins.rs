//! Two nodes that send the same identifier. Each answers the command, so one echo of the counter comes with two contents; a bus by itself
//! does not tell.

use super::settings::CanSettings;
use crate::can::{Frame, FrameId};
use crate::dbc::{Codec, Database};

/// Commands in a row that got two different answers before it counts: a single one may be a frame that was damaged and repeated.
const ENOUGH: u32 = 5;

/// A message whose frames echo the command's counter.
struct Echoed {
    id: FrameId,
    counter: Codec,
    last: Option<Frame>,
    /// The last counter came with two contents.
    twice: bool,
    in_a_row: u32,
}

/// Looks for them.
pub(super) struct Twins {
    messages: Vec<Echoed>,
}

impl Twins {
    /// For the sensors that have a counter; of the others nothing can be said.
    pub fn new(settings: &CanSettings, database: &Database) -> Twins {
        let mut messages: Vec<Echoed> = vec![];
        let counters = settings.sensors.by_input().into_iter().flatten().filter_map(|sensor| sensor.counter.as_deref());
        for (message, signal) in counters.filter_map(|counter| database.signal(counter).ok()) {
            if !messages.iter().any(|known| known.id == message.id) {
                let counter = signal.codec;
                messages.push(Echoed { id: message.id, counter, last: None, twice: false, in_a_row: 0 });
            }
        }
        Twins { messages }
    }

    /// Looks at a frame that came.
    pub fn see(&mut self, frame: &Frame) {
        let Some(message) = self.messages.iter_mut().find(|message| message.id == frame.id) else { return };
        let counter = |frame: &Frame| message.counter.decode(frame.data());
        match message.last {
            Some(last) if counter(&last) == counter(frame) => {
                if last.data() != frame.data() && !message.twice {
                    message.twice = true;
                    message.in_a_row += 1;
                }
            }
            _ => {
                if !message.twice {
                    message.in_a_row = 0;
                }
                message.twice = false;
                message.last = Some(*frame);
            }
        }
    }

    /// The identifier that two nodes send.
    pub fn found(&self) -> Option<FrameId> {
        self.messages.iter().find(|message| message.in_a_row >= ENOUGH).map(|message| message.id)
    }

    /// A preparation begins.
    pub fn forget(&mut self) {
        for message in &mut self.messages {
            (message.last, message.twice, message.in_a_row) = (None, false, 0);
        }
    }
}

/// What is to be said of it.
pub(super) fn told(id: FrameId) -> String {
    format!(
        "expected one answer of frame {id} to each command, got two that differ: two nodes have this identifier, take one off the bus"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const DBC: &str = "BU_: A\n\nBO_ 5 M: 2 A\n SG_ Value : 0|8@1+ (1,0) [0|255] \"\" A\n SG_ Counter : 8|8@1+ (1,0) [0|255] \"\" A\n";
    const SETTINGS: &str = "interface = \"vcan0\"\ndbc = \"\"\nsensors.angle_deg = { signal = \"M.Value\", counter = \"M.Counter\" }\n\
                            command = { brake_open = \"\", bypass_open = \"\" }\n";

    fn twins() -> Twins {
        let settings: CanSettings = toml::from_str(SETTINGS).expect("written by hand above");
        Twins::new(&settings, &Database::parse(DBC, "a.dbc").expect("written by hand above"))
    }

    fn frame(value: u8, counter: u8) -> Frame {
        Frame::new(FrameId::Standard(5), &[value, counter]).expect("two bytes fit")
    }

    #[test]
    fn two_nodes_are_found_in_whatever_order_they_answer() {
        let mut twins = twins();
        for tick in 0..ENOUGH as u8 {
            assert_eq!(twins.found(), None);
            let (first, second) = if tick % 2 == 0 { (10, 77) } else { (77, 10) };
            twins.see(&frame(first, tick));
            twins.see(&frame(second, tick));
        }
        assert_eq!(twins.found(), Some(FrameId::Standard(5)));
        assert!(told(FrameId::Standard(5)).contains("frame 005"));
        twins.forget();
        assert_eq!(twins.found(), None);
    }

    #[test]
    fn one_node_is_never_two_though_frames_are_repeated_or_damaged_now_and_then() {
        let mut twins = twins();
        for tick in 0..200u8 {
            twins.see(&frame(tick / 3, tick));
            twins.see(&frame(tick / 3, tick));
            if tick % 3 != 0 {
                twins.see(&frame(200, tick));
            }
        }
        assert_eq!(twins.found(), None);
    }
}
