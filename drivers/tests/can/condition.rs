//! The condition of a bus: what error frames say of it, and a bus that goes and comes back.

use crate::bus::{Bus, COMMAND, Node, SENSOR, frame, ip, link, next, on_each, texts, until, until_state};
use drivers::can::{BusState, Condition, Interface, Wanted};
use drivers::journal::{JournalReader, Severity};

#[test]
fn error_frames_tell_the_condition_and_nothing_is_sent_off_the_bus() {
    on_each(|bus| {
        let errors = ErrorSource::on(bus);
        let mut journal = JournalReader::default();
        let mut link = link(bus, &mut journal);
        errors.meet();
        let is = |condition| move |state: &BusState| state.condition == condition;
        errors.send(libc::CAN_ERR_CRTL | libc::CAN_ERR_CNT, [0, 0x08, 0, 0, 0, 0, 96, 3]);
        let state = until_state(&link, "warning", is(Condition::Warning));
        assert_eq!(state.error_counters, Some((96, 3)));
        // By its counters alone, with a bus error.
        errors.send(libc::CAN_ERR_ACK | libc::CAN_ERR_BUSERROR | libc::CAN_ERR_CNT, [0, 0, 0, 0, 0, 0, 128, 3]);
        until_state(&link, "passive", is(Condition::Passive));
        errors.send(libc::CAN_ERR_BUSOFF, [0; 8]);
        let state = until_state(&link, "off", is(Condition::BusOff));
        assert_eq!((state.errors, state.error_counters), (3, Some((128, 3))));
        // What the counters say does not end it.
        errors.send(libc::CAN_ERR_BUSERROR | libc::CAN_ERR_CNT, [0, 0, 0, 0, 0, 0, 0, 0]);
        until_state(&link, "the next error", |state| state.errors == 4);
        assert_eq!(link.state().condition, Condition::BusOff);
        let sent = link.state().sent;
        for n in 1..=50 {
            link.send(&[frame(COMMAND, &[n])]);
            until_state(&link, "not sent", |state| state.unsent == u64::from(n));
        }
        assert_eq!(link.state().sent, sent);
        errors.send(libc::CAN_ERR_RESTARTED, [0; 8]);
        until_state(&link, "restarted", is(Condition::Active));
        link.send(&[frame(COMMAND, &[99])]);
        until_state(&link, "sent", |state| state.sent == sent + 1);
        // Nothing of what was commanded while it was off.
        assert_eq!(errors.receive_data(), 99);
        drop(link);
        let texts = texts(&mut journal);
        let starts = |n: usize, begin: &str, has: &str| {
            assert!(texts[n].starts_with(begin) && texts[n].contains(has), "{n}: {texts:#?}");
        };
        starts(0, "Warning", ": error-warning: controller problem: tx warning; error counters: tx=96, rx=3");
        starts(1, "Warning", ": error-passive: no ack");
        starts(2, "Error", ": bus-off: bus off");
        starts(3, "Info", ": error-active: restarted");
        if matches!(bus.interface, Interface::SocketCan(_)) {
            starts(2, "Error", "`ip link set vcan0 type can restart` (by itself: `restart-ms 100`)");
        }
        assert!(texts[4..].iter().all(|text| text.contains("error frames, first: ")), "{texts:#?}");
    });
}

/// Says what a controller would.
enum ErrorSource {
    SocketCan(socketcan::CanSocket),
    Unix { listener: std::os::fd::OwnedFd, peer: std::cell::OnceCell<std::os::fd::OwnedFd> },
}

impl ErrorSource {
    fn on(bus: &Bus) -> ErrorSource {
        use rustix::net::{AddressFamily, SocketAddrUnix, SocketType, bind, listen, socket};
        use socketcan::Socket;
        match &bus.interface {
            Interface::SocketCan(name) => ErrorSource::SocketCan(socketcan::CanSocket::open(name).unwrap()),
            Interface::Unix(path) => {
                let listener = socket(AddressFamily::UNIX, SocketType::SEQPACKET, None).unwrap();
                bind(&listener, &SocketAddrUnix::new(path).unwrap()).unwrap();
                listen(&listener, 1).unwrap();
                ErrorSource::Unix { listener, peer: std::cell::OnceCell::new() }
            }
        }
    }

    fn meet(&self) {
        if let ErrorSource::Unix { listener, peer } = self {
            peer.set(rustix::net::accept(listener).unwrap()).unwrap();
        }
    }

    fn send(&self, classes: u32, data: [u8; 8]) {
        use socketcan::Socket;
        let error = socketcan::CanErrorFrame::new_error(classes, &data).unwrap();
        match self {
            ErrorSource::SocketCan(socket) => socket.write_frame(&socketcan::CanFrame::Error(error)).unwrap(),
            ErrorSource::Unix { peer, .. } => {
                let mut bytes = [0; 16];
                bytes[..4].copy_from_slice(&(classes | libc::CAN_ERR_FLAG).to_ne_bytes());
                bytes[4] = 8;
                bytes[8..].copy_from_slice(&data);
                rustix::io::write(peer.get().unwrap(), &bytes).unwrap();
            }
        }
    }

    /// The first byte of the next frame.
    fn receive_data(&self) -> u8 {
        use socketcan::{EmbeddedFrame, Socket};
        match self {
            ErrorSource::SocketCan(socket) => socket.read_frame().unwrap().data()[0],
            ErrorSource::Unix { peer, .. } => {
                let mut bytes = [0; 16];
                assert_eq!(rustix::io::read(peer.get().unwrap(), &mut bytes[..]).unwrap(), 16);
                bytes[8]
            }
        }
    }
}

#[test]
fn a_bus_that_is_lost_is_found_again() {
    on_each(|bus| {
        let mut journal = JournalReader::default();
        let mut node = Node::on(bus, Wanted::All);
        let mut link = link(bus, &mut journal);
        node.meet(&mut link);
        for round in 0..2 {
            match &bus.interface {
                Interface::Unix(_) => drop(node),
                Interface::SocketCan(name) => ip(&["link", "set", name, "down"]),
            }
            // Commands go on at the loop's rate, and are not kept.
            let mut n = 0;
            until_state(&link, "down", |state| state.condition == Condition::Down);
            until("commands that are dropped", || {
                n += 1;
                link.send(&[frame(COMMAND, &[round, n as u8])]);
                (link.state().unsent > 300 * u64::from(round + 1)).then_some(())
            });
            node = match &bus.interface {
                Interface::Unix(_) => Node::on(bus, Wanted::All),
                Interface::SocketCan(name) => {
                    ip(&["link", "set", name, "up"]);
                    Node::on(bus, Wanted::All)
                }
            };
            until("active again", || {
                link.send(&[frame(COMMAND, &[round, 1])]);
                (link.state().condition == Condition::Active).then_some(())
            });
            link.send(&[frame(COMMAND, &[round, 200])]);
            while node.receive().frame.data() != [round, 200] {}
            node.send(&frame(SENSOR, &[round]));
            assert_eq!(next(&mut link).frame.data(), [round]);
        }
        drop(link);
        let entries = journal.read();
        let told = |severity, what: &str| {
            entries.iter().filter(|entry| entry.severity == severity && entry.text.contains(what)).count()
        };
        assert_eq!((told(Severity::Error, ": down: "), told(Severity::Info, "there again")), (2, 2), "{entries:#?}");
        assert!(entries.len() <= 8, "{entries:#?}");
    });
}
