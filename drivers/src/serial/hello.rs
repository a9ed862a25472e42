//! The first words with an amplifier, and what may be wrong where none answers.

use super::{LinkError, port};
use crate::amplifier::{AmplifierSettings, Firmware, Outbox, PROTOCOLS, Protocol, ProtocolKind, Told, protocol};
use std::io;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::time::{Instant, timeout_at};
use tokio_serial::SerialStream;

/// A hello is repeated so often: the amplifier may be starting, or half a frame may have come before ours.
pub(super) const REPEAT: Duration = Duration::from_millis(100);
/// The amplifier has so long to answer.
const WAIT: Duration = Duration::from_millis(2000);
/// And so long to answer in each of the other protocols.
const WAIT_OTHER: Duration = Duration::from_millis(300);
/// Bytes of what came that are kept to find out what they are.
const KEPT: usize = 4096;
/// Bytes of what came that a message shows.
const SHOWN: usize = 16;

/// Opens the port and asks who is there.
///
/// # Errors
/// What is wrong with the port; nobody answers; who answers speaks something else.
pub(super) async fn connect(
    settings: &AmplifierSettings,
    spoken: &mut dyn Protocol,
) -> Result<(SerialStream, Firmware), LinkError> {
    let kind = protocol(&settings.protocol)?;
    let mut stream = port::open(&settings.port, settings.baud)?;
    let failed = |source| LinkError::Port { port: settings.port.clone(), doing: "talking to the amplifier", source };
    let mut heard = Heard::default();
    if let Some(firmware) = ask(&mut stream, spoken, WAIT, &mut heard).await.map_err(failed)? {
        return Ok((stream, firmware));
    }
    let port = || settings.port.clone();
    let other = |kind: &'static ProtocolKind, spoken: &ProtocolKind| LinkError::OtherProtocol {
        port: port(),
        title: kind.title,
        spoken: spoken.name,
        spoken_title: spoken.title,
    };
    let mut hello = Outbox::new();
    spoken.hello(&mut hello);
    let echo = heard.kept.starts_with(hello.bytes());
    // Who echoes speaks every protocol.
    for candidate in PROTOCOLS.iter().filter(|candidate| candidate.name != kind.name && !echo) {
        // Its settings may be wrong, since they were not needed.
        let Ok(mut client) = (candidate.client)(settings) else { continue };
        client.hear(&heard.kept, &mut |_| {});
        let recognised = speaks(&*client, heard.kept.len());
        client.reset();
        // Asking is harmless: every protocol's hello reads a version, and a frame of another protocol is refused by its checksum.
        let mut answer = Heard::default();
        let asked =
            !recognised && ask(&mut stream, &mut *client, WAIT_OTHER, &mut answer).await.map_err(failed)?.is_some();
        if recognised || asked {
            return Err(other(kind, candidate));
        }
    }
    let (title, baud) = (kind.title, settings.baud);
    if heard.kept.is_empty() {
        return Err(LinkError::Silent { port: port(), title, baud, waited_ms: WAIT.as_millis() as u64 });
    }
    let remedy = if echo {
        "they are what was sent: TX and RX are connected to each other, or the adapter echoes (RS-485)"
    } else if spoken.garbled().sound > 0 {
        "something else on this line speaks the protocol; is it the amplifier's own port?"
    } else {
        "wrong baud rate, or the amplifier speaks another protocol"
    };
    let shown = &heard.kept[..heard.kept.len().min(SHOWN)];
    let first = shown.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ");
    Err(LinkError::Garbled {
        port: port(),
        title,
        baud,
        bytes: heard.bytes,
        sound: spoken.garbled().sound,
        first,
        remedy,
    })
}

/// Whether what came, so many bytes, is this protocol. A checksum of one byte accepts some noise, so most of it must be.
fn speaks(client: &dyn Protocol, bytes: usize) -> bool {
    let garbled = client.garbled();
    garbled.sound > 0 && garbled.skipped_bytes <= bytes as u64 / 2
}

/// What came.
#[derive(Default)]
struct Heard {
    bytes: usize,
    kept: Vec<u8>,
}

/// Says hello again and again; the answer, or `None` after `wait`.
async fn ask(
    stream: &mut SerialStream,
    spoken: &mut dyn Protocol,
    wait: Duration,
    heard: &mut Heard,
) -> io::Result<Option<Firmware>> {
    let mut hello = Outbox::new();
    let end = Instant::now() + wait;
    while Instant::now() < end {
        hello.clear();
        spoken.hello(&mut hello);
        match stream.try_write(hello.bytes()) {
            Ok(_) => {}
            // A port that takes no bytes: the next hello may find room.
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
            Err(e) => return Err(e),
        }
        let repeat = end.min(Instant::now() + REPEAT);
        let mut bytes = [0; 512];
        // The time is looked at too: a timeout never ends while there is always something to read.
        while Instant::now() < repeat {
            let Ok(read) = timeout_at(repeat, stream.read(&mut bytes)).await else { break };
            let read = read?;
            if read == 0 {
                return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the port was closed at its other end"));
            }
            heard.bytes += read;
            let room = KEPT - heard.kept.len();
            heard.kept.extend_from_slice(&bytes[..read.min(room)]);
            let mut firmware = None;
            spoken.hear(&bytes[..read], &mut |told| {
                if let Told::Hello(who) = told {
                    firmware = Some(who);
                }
            });
            if firmware.is_some() {
                return Ok(firmware);
            }
        }
    }
    Ok(None)
}
