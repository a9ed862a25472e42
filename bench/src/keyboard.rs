//! The terminal that started the run: emergency stop, stop, and the confirmations of people at the rig.

use crate::progress::{Progress, Prompt};
use rt_core::{Amount, Confirmation, Refusal, Switches, Waiting};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::read;
use rustix::process::getpgrp;
use rustix::stdio::stdin;
use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, isatty, tcgetattr, tcgetpgrp, tcsetattr,
};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// What is said before a run on a terminal.
pub const HELP: &str = "keys: space or Esc = emergency stop (trips, latches), q = stop";

/// An Enter so soon after a request was meant for something else: nobody has read it yet.
const TOO_SOON: Duration = Duration::from_millis(300);
/// The loop judges a confirmation within a tick; one that is held up for longer has no answer.
const VERDICT_PATIENCE: Duration = Duration::from_secs(2);
/// Longest amount that is typed.
const MOST_TYPED: usize = 16;

/// How the terminal was before; it must be so again, however the process ends.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);
static ENDED: AtomicBool = AtomicBool::new(false);
static WATCHED: AtomicBool = AtomicBool::new(false);

/// While it lives, keys throw the switches.
pub struct Keyboard {
    thread: Option<JoinHandle<()>>,
}

impl Keyboard {
    /// Watches the keys; `None` where stdin is no terminal, one that can't be asked for single keys, or one in whose background this process
    /// is: its keys are another's.
    pub fn watch(switches: &'static Switches, progress: &Progress) -> Option<Keyboard> {
        if !isatty(stdin()) || tcgetpgrp(stdin()).is_ok_and(|foreground| foreground != getpgrp()) {
            return None;
        }
        let before = tcgetattr(stdin()).ok()?;
        let single = single_keys(&before);
        tcsetattr(stdin(), OptionalActions::Now, &single).ok()?;
        *BEFORE.lock().unwrap_or_else(|poisoned| poisoned.into_inner()) = Some(before);
        ENDED.store(false, Ordering::Relaxed);
        let progress = progress.clone();
        let listen = move || listen(&mut Keys::new(switches), &progress);
        let thread = thread::Builder::new().name("keyboard".to_owned()).spawn(listen).ok();
        WATCHED.store(thread.is_some(), Ordering::Relaxed);
        Some(Keyboard { thread })
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        ENDED.store(true, Ordering::Relaxed);
        WATCHED.store(false, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It looks at the flag several times a second.
            let _ = thread.join();
        }
        restore();
    }
}

/// Keys come one by one and are not shown. Ctrl-C stays a signal; Ctrl-Z and Ctrl-\ become keys, as they must not halt or kill what drives a
/// rig.
fn single_keys(before: &Termios) -> Termios {
    let mut single = before.clone();
    single.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
    // 0 is `_POSIX_VDISABLE`.
    single.special_codes[SpecialCodeIndex::VSUSP] = 0;
    single.special_codes[SpecialCodeIndex::VQUIT] = 0;
    single
}

/// Ctrl-\ where it is a key.
const QUIT: u8 = 0x1c;

/// Whether people can confirm by a key.
pub fn watched() -> bool {
    WATCHED.load(Ordering::Relaxed)
}

/// Gives the terminal back as it was. For the exit of the process, too.
pub fn restore() {
    if let Some(before) = BEFORE.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take() {
        // A terminal that is gone needs nothing.
        let _ = tcsetattr(stdin(), OptionalActions::Now, &before);
    }
}

fn listen(keys: &mut Keys, progress: &Progress) {
    let mut key = [0_u8; 16];
    let prompt = progress.prompt();
    while !ENDED.load(Ordering::Relaxed) {
        // A confirmation is answered within a tick or so; the emergency stop is heard meanwhile.
        let look_ns = if keys.offered.is_some() { 2_000_000 } else { 50_000_000 };
        let look = Timespec { tv_sec: 0, tv_nsec: look_ns };
        let keyboard = stdin();
        let mut ready = [PollFd::new(&keyboard, PollFlags::IN)];
        let pressed = matches!(poll(&mut ready, Some(&look)), Ok(1..));
        keys.look(Instant::now());
        if pressed {
            match read(keyboard, &mut key) {
                Ok(0) | Err(_) => return,
                Ok(count) => key[..count].iter().for_each(|&key| keys.pressed(key, Instant::now())),
            }
        }
        keys.said.drain(..).for_each(|line| progress.say(&line));
        keys.show(&prompt);
    }
}

/// What was pressed so far, and what became of it.
struct Keys {
    switches: &'static Switches,
    /// The request that is shown, and since when.
    open: Option<(Waiting, Instant)>,
    typed: String,
    /// A confirmation is with the loop since then.
    offered: Option<Instant>,
    said: Vec<String>,
}

impl Keys {
    fn new(switches: &'static Switches) -> Self {
        Keys { switches, open: None, typed: String::new(), offered: None, said: Vec::new() }
    }

    /// What is asked for now, and what the loop says to what was offered.
    fn look(&mut self, now: Instant) {
        let slot = &self.switches.confirmations;
        if let Some(since) = self.offered {
            let verdict = match slot.verdict() {
                None if now.duration_since(since) >= VERDICT_PATIENCE && slot.withdraw() => {
                    Some(Err(Refusal::NoAnswer))
                }
                verdict => verdict,
            };
            if let Some(verdict) = verdict {
                self.offered = None;
                self.said.push(match verdict {
                    Ok(_) => "confirmed".to_owned(),
                    Err(refusal) => format!("not taken: {refusal}"),
                });
            }
        }
        let open = slot.waiting();
        if open != self.open.map(|(open, _)| open) {
            self.open = open.map(|open| (open, now));
            self.typed.clear();
        }
    }

    fn pressed(&mut self, key: u8, now: Instant) {
        match key {
            b' ' | 0x1b => self.switches.emergency_stop.store(true, Ordering::Relaxed),
            b'q' | QUIT => self.switches.stop.store(true, Ordering::Relaxed),
            b'\n' | b'\r' => self.enter(now),
            0x7f | 0x08 => _ = self.typed.pop(),
            // A comma is what some keyboards have for the point.
            b'0'..=b'9' | b'.' | b',' | b'-' | b'+' if self.asks_amount() && self.typed.len() < MOST_TYPED => {
                self.typed.push(if key == b',' { '.' } else { key as char });
            }
            _ => {}
        }
    }

    fn asks_amount(&self) -> bool {
        self.open.is_some_and(|(open, _)| open.amount.is_some())
    }

    fn enter(&mut self, now: Instant) {
        let Some((open, since)) = self.open.filter(|_| self.offered.is_none()) else { return };
        if now.duration_since(since) < TOO_SOON {
            self.said.push("not taken: that was too soon after the request; press Enter when it is done".to_owned());
            return;
        }
        let typed = std::mem::take(&mut self.typed);
        let volume_ml = match typed.parse::<f64>() {
            Ok(volume_ml) => Some(volume_ml),
            // Where the rig measures it itself none is needed; the loop knows.
            Err(_) if typed.is_empty() => None,
            Err(_) => {
                self.said.push(format!("not taken: expected a number in ml, got {typed:?}; type it again"));
                return;
            }
        };
        let confirmation = Confirmation { request: Some(open.request), volume_ml };
        if self.switches.confirmations.offer(confirmation) {
            self.offered = Some(now);
        } else {
            self.said.push("not taken: another confirmation is just under way".to_owned());
        }
    }

    fn show(&self, prompt: &Prompt) {
        match self.open {
            Some((Waiting { amount: Some(Amount::VolumeMl), .. }, _)) => prompt.show(&format!("  ml: {}_", self.typed)),
            Some(_) => prompt.show("  Enter = done"),
            None => prompt.hide(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::{Measurement, Tick};

    fn keys() -> Keys {
        Keys::new(Box::leak(Box::new(Switches::new())))
    }

    #[test]
    fn keys_throw_their_switches_and_no_others() {
        for (key, stop, emergency) in [
            (b'q', true, false),
            (QUIT, true, false),
            (0x1a, false, false),
            (b' ', false, true),
            (0x1b, false, true),
            (b'x', false, false),
            (b'\n', false, false),
        ] {
            let mut keys = keys();
            keys.pressed(key, Instant::now());
            let switches = keys.switches;
            let thrown = (switches.stop.load(Ordering::Relaxed), switches.emergency_stop.load(Ordering::Relaxed));
            assert_eq!(thrown, (stop, emergency), "key {key}");
            assert_eq!(keys.offered, None, "nothing is asked");
        }
    }

    #[test]
    fn of_the_keys_that_are_signals_only_ctrl_c_stays_one() {
        let terminal = std::fs::File::open("/dev/ptmx").expect("the system has terminals");
        let before = tcgetattr(&terminal).expect("it is one");
        let single = single_keys(&before);
        let codes = [SpecialCodeIndex::VSUSP, SpecialCodeIndex::VQUIT, SpecialCodeIndex::VINTR];
        assert!(codes.iter().all(|&code| before.special_codes[code] != 0), "{before:?}");
        assert_eq!(codes.map(|code| single.special_codes[code]), [0, 0, before.special_codes[SpecialCodeIndex::VINTR]]);
        assert!(single.local_modes.contains(LocalModes::ISIG) && !single.local_modes.contains(LocalModes::ICANON));
    }

    /// Types while this is asked for; what the loop then takes.
    fn typed(keys: &mut Keys, amount: Option<Amount>, text: &[u8], after: Duration) -> Option<Confirmation> {
        let waiting = Some(Waiting { request: 3, amount });
        let slot = &keys.switches.confirmations;
        let take = || slot.take(Tick::at(9), waiting, &Measurement::NONE);
        assert_eq!(take(), None);
        let begun = Instant::now();
        keys.look(begun);
        text.iter().for_each(|&key| keys.pressed(key, begun + after));
        let taken = take();
        keys.look(begun + after);
        taken
    }

    #[test]
    fn enter_confirms_what_is_shown_and_brings_the_amount_that_was_typed() {
        let later = Duration::from_secs(1);
        let confirmed = |volume_ml| Some(Confirmation { request: Some(3), volume_ml });
        let volume = Some(Amount::VolumeMl);
        assert_eq!(typed(&mut keys(), None, b"12\n", later), confirmed(None), "digits where none are asked");
        assert_eq!(typed(&mut keys(), volume, b"1,2x53\x7f\r", later), confirmed(Some(1.25)));
        for (text, after, says) in [
            (&b"1.2.3\n"[..], later, "1.2.3"),
            (b"\n", later, "expected the amount"),
            (b"4\n", Duration::ZERO, "too soon"),
        ] {
            let mut keys = keys();
            assert_eq!(typed(&mut keys, volume, text, after), None);
            assert!(keys.said.iter().any(|line| line.contains(says)), "{says}: {:?}", keys.said);
        }
    }
}
