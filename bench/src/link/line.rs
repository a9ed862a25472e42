//! The far end's line to the rig's: a zenoh session and what it listens to. Where the rig's end is silent the whole line is given up and another
//! one is opened, under another name.
//!
//! Left to itself zenoh connects again under the same name. Where the rig's end has not given the old connection up by then it takes the new one for
//! one more way to the same peer, with the numbers that the old one had given to keys: samples then arrive as signs of life, and commands nowhere.
//! A new name can't be taken for the old one.

use super::{broken, key, session};
use crate::failure::Failure;
use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::{Session, Wait};

/// A line on which nothing comes for so long is given up: before zenoh does that by itself (`super::LEASE_MS`).
const DEAD: Duration = Duration::from_secs(2);

/// What comes from the network.
pub enum Incoming {
    /// Samples, as [`recordings::carry`] puts them together.
    Samples(ZBytes),
    /// [`super::State`]
    State(ZBytes),
}

/// See the module.
pub struct Line<'a> {
    address: &'a str,
    remote: &'a str,
    sender: SyncSender<Incoming>,
    now: Mutex<Open>,
}

/// Of the present session. The subscribers end with it.
struct Open {
    session: Session,
    listening: [Subscriber<()>; 2],
    since: Instant,
}

impl<'a> Line<'a> {
    /// A line to instance `remote` at this address; what comes goes to `sender`, and what finds no room there is dropped.
    ///
    /// # Errors
    /// zenoh refuses (4). That nobody is there is none.
    pub fn open(address: &'a str, remote: &'a str, sender: SyncSender<Incoming>) -> Result<Self, Failure> {
        let now = Mutex::new(open(address, remote, &sender)?);
        Ok(Line { address, remote, sender, now })
    }

    /// For queries. A session that is given up meanwhile answers none.
    pub fn session(&self) -> Session {
        self.present().session.clone()
    }

    /// Opens another line where this one has been silent for too long. `heard`: when something came last.
    ///
    /// # Errors
    /// As [`Line::open`].
    pub fn keep(&self, heard: Option<Instant>) -> Result<(), Failure> {
        let since = self.present().since;
        if heard.map_or(since, |heard| heard.max(since)).elapsed() < DEAD {
            return Ok(());
        }
        let fresh = open(self.address, self.remote, &self.sender)?;
        close(std::mem::replace(&mut *self.present(), fresh));
        Ok(())
    }

    /// # Errors
    /// zenoh refuses (4).
    pub fn close(self) -> Result<(), Failure> {
        let Open { session, listening, .. } = self.now.into_inner().unwrap_or_else(PoisonError::into_inner);
        drop(listening);
        session.close().wait().map_err(|e| broken("closing", &e))
    }

    fn present(&self) -> MutexGuard<'_, Open> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn open(address: &str, remote: &str, sender: &SyncSender<Incoming>) -> Result<Open, Failure> {
    let session = session(&[], &[address.to_owned()])?;
    let listening = [
        listen(&session, remote, "sample", sender.clone(), Incoming::Samples)?,
        listen(&session, remote, "state", sender.clone(), Incoming::State)?,
    ];
    Ok(Open { session, listening, since: Instant::now() })
}

/// Gives a line up. To say goodbye on one that is dead takes its time, and nobody waits for it.
fn close(old: Open) {
    std::thread::spawn(move || {
        drop(old.listening);
        if let Err(error) = old.session.close().wait() {
            tracing::debug!(%error, "closing a line that was given up");
        }
    });
}

/// Hands what is published under a key to the channel.
fn listen(
    session: &Session,
    remote: &str,
    part: &str,
    sender: SyncSender<Incoming>,
    wrap: fn(ZBytes) -> Incoming,
) -> Result<Subscriber<()>, Failure> {
    let take = move |sample: zenoh::sample::Sample| {
        if let Err(TrySendError::Full(_)) = sender.try_send(wrap(sample.payload().clone())) {
            tracing::debug!("what came over the link was dropped: this machine is too slow");
        }
    };
    session.declare_subscriber(key(remote, part)).callback(take).wait().map_err(|e| broken("subscribing", &e))
}
