//! Opening a bus: what keeps it from being opened, and who may.

use crate::bus::{Bus, COMMAND, Node, SENSOR, frame, ip, link, until};
use crate::vcan;
use drivers::can::{CanError, CanLink, Condition, End, FrameId, Heard, Interface, Port, Wanted};
use drivers::journal::JournalReader;
use std::time::Duration;

#[test]
fn what_keeps_a_bus_from_being_opened_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str| {
        let interface: Interface = name.parse().unwrap();
        match CanLink::open(&interface, &[SENSOR], || {}, JournalReader::default().journal("can")) {
            Err(error) => error,
            Ok(_) => panic!("{name} was opened"),
        }
    };
    let path = |file: &str| format!("unix:{}", folder.path().join(file).display());
    let absent = refused(&path("absent"));
    assert!(matches!(absent, CanError::NobodyThere { .. }) && absent.to_string().contains("bench emulate"), "{absent}");
    // What a process left that has ended.
    let left = std::os::unix::net::UnixListener::bind(folder.path().join("left")).unwrap();
    let other = refused(&path("left"));
    assert!(other.to_string().contains("a socket of another kind"), "{other}");
    drop(left);
    assert!(matches!(refused(&path("left")), CanError::NobodyThere { .. }));
    let long = refused(&path(&"x".repeat(120)));
    assert!(matches!(long, CanError::System { .. }) && long.to_string().contains("too long"), "{long}");
    // The other way round: a path that is taken, and one that only looks so.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let bind = |file: &str| Port::open(&path(file).parse().unwrap(), Wanted::All, End::Binds);
        let first = bind("bus").unwrap();
        let second = bind("bus").err().expect("taken").to_string();
        assert!(second.contains("another process listens there"), "{second}");
        drop(first);
        assert!(!folder.path().join("bus").exists(), "its file goes with it");
        std::fs::write(folder.path().join("file"), "precious").unwrap();
        let file = bind("file").err().expect("taken").to_string();
        assert!(file.contains("a file that is no socket"), "{file}");
        assert_eq!(std::fs::read(folder.path().join("file")).unwrap(), b"precious");
        drop(bind("left").expect("nobody is there any more"));
    });
    if vcan::vcan().is_none() {
        let none = refused("can7");
        assert!(matches!(none, CanError::NoCan { .. } | CanError::NoSuchInterface { .. }), "{none}");
        return;
    }
    let none = refused("can7").to_string();
    assert!(none.contains("no network interface can7") && none.contains("vcan0"), "{none}");
    let kind = refused("lo").to_string();
    assert!(kind.contains("lo is no CAN interface (link type 772") && kind.contains("vcan0"), "{kind}");
    ip(&["link", "set", "vcan1", "down"]);
    let down = refused("vcan1");
    assert!(matches!(&down, CanError::Down { .. }) && down.to_string().contains("`ip link set vcan1 up`"), "{down}");
    ip(&["link", "set", "vcan1", "up"]);
    let many: Vec<FrameId> = (0..600).map(FrameId::Standard).collect();
    let interface = Interface::SocketCan("vcan1".into());
    let many = CanLink::open(&interface, &many, || {}, JournalReader::default().journal("can")).err();
    assert!(matches!(many, Some(CanError::TooManyWanted { count: 600, most: 512, .. })));
}

#[test]
fn a_second_peer_is_turned_away_and_the_next_one_is_let_in() {
    let bus = Bus::unix();
    let node = Node::on(&bus, Wanted::All);
    let mut journal = JournalReader::default();
    let mut first = link(&bus, &mut journal);
    node.meet(&mut first);
    let mut second = link(&bus, &mut journal);
    until("turned away", || {
        first.send(&[frame(COMMAND, &[1])]);
        node.receive();
        (second.state().condition == Condition::Down).then_some(())
    });
    drop(first);
    until("let in", || {
        second.send(&[frame(COMMAND, &[2])]);
        let heard =
            node.runtime.block_on(async { tokio::time::timeout(Duration::from_millis(5), node.port.receive()).await });
        heard.is_ok_and(|heard| matches!(heard, Ok(Heard::Frame(heard)) if heard.frame.data() == [2])).then_some(())
    });
}
