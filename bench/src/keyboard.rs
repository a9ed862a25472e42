//! The emergency stop on the keyboard of the terminal that started the run.

use rt_core::Switches;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::read;
use rustix::stdio::stdin;
use rustix::termios::{LocalModes, OptionalActions, Termios, isatty, tcgetattr, tcsetattr};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};

/// What is said before a run on a terminal.
pub const HELP: &str = "keys: space or Esc = emergency stop (trips, latches), q = stop";

/// How the terminal was before; it must be so again, however the process ends.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);
static ENDED: AtomicBool = AtomicBool::new(false);

/// While it lives, keys throw the switches.
pub struct Keyboard {
    thread: Option<JoinHandle<()>>,
}

impl Keyboard {
    /// Watches the keys; `None` where stdin is no terminal, or one that can't be asked for single keys.
    pub fn watch(switches: &'static Switches) -> Option<Keyboard> {
        if !isatty(stdin()) {
            return None;
        }
        let before = tcgetattr(stdin()).ok()?;
        let mut single = before.clone();
        // Keys come one by one and are not shown; Ctrl-C stays a signal.
        single.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        tcsetattr(stdin(), OptionalActions::Now, &single).ok()?;
        *BEFORE.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = Some(before);
        ENDED.store(false, Ordering::Relaxed);
        let thread = thread::Builder::new().name("keyboard".to_owned()).spawn(move || listen(switches)).ok();
        Some(Keyboard { thread })
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        ENDED.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It looks at the flag several times a second.
            let _ = thread.join();
        }
        restore();
    }
}

/// Gives the terminal back as it was. For the exit of the process, too.
pub fn restore() {
    if let Some(before) = BEFORE.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take() {
        // A terminal that is gone needs nothing.
        let _ = tcsetattr(stdin(), OptionalActions::Now, &before);
    }
}

fn listen(switches: &Switches) {
    const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
    let mut key = [0_u8; 16];
    while !ENDED.load(Ordering::Relaxed) {
        let keyboard = stdin();
        let mut ready = [PollFd::new(&keyboard, PollFlags::IN)];
        if !matches!(poll(&mut ready, Some(&LOOK)), Ok(1..)) {
            continue;
        }
        match read(keyboard, &mut key) {
            Ok(0) | Err(_) => return,
            Ok(count) => key[..count].iter().for_each(|&key| pressed(key, switches)),
        }
    }
}

fn pressed(key: u8, switches: &Switches) {
    match key {
        b' ' | 0x1b => switches.emergency_stop.store(true, Ordering::Relaxed),
        b'q' => switches.stop.store(true, Ordering::Relaxed),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_throw_their_switches_and_no_others() {
        for (key, stop, emergency) in
            [(b'q', true, false), (b' ', false, true), (0x1b, false, true), (b'x', false, false)]
        {
            let switches = Switches::new();
            pressed(key, &switches);
            let thrown = (switches.stop.load(Ordering::Relaxed), switches.emergency_stop.load(Ordering::Relaxed));
            assert_eq!(thrown, (stop, emergency), "key {key}");
        }
    }
}
