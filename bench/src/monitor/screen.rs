//! The terminal: drawn at most 20 times a second, given back as it was however the monitor ends.

use super::listener::Listener;
use super::state::State;
use super::view::{Look, draw};
use crate::failure::{Failure, Kind};
use crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::DefaultTerminal;
use recordings::Severity;
use rt_core::{Answer, RunCommand, send_command};
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

/// Between two pictures.
const FRAME: Duration = Duration::from_millis(50);
/// Shortest wait for a key; with none at all nobody would look for one.
const KEY_WAIT: Duration = Duration::from_millis(1);
/// The loop hears a command within a tick; this long its answer may take.
const PATIENCE: Duration = Duration::from_secs(3);

/// Shows `instance` until a key or `end` ends it.
///
/// # Errors
/// The terminal can't be had or is gone, the instance can't be listened to (4).
pub fn show(instance: &str, look: Look, end: &AtomicBool) -> Result<(), Failure> {
    // Before the terminal changes: what is refused is told on an ordinary one.
    let mut listener = Listener::open(instance).map_err(|e| Failure::of(Kind::Device, &e))?;
    let mut screen = Screen::open().map_err(|e| failed("take over the terminal", &e))?;
    let mut monitor = Monitor { state: State::new(instance), look, answers: mpsc::channel() };
    let mut due = Instant::now();
    while !end.load(Ordering::Relaxed) {
        listener.look(&mut monitor.state).map_err(|e| Failure::of(Kind::Device, &e))?;
        monitor.hear();
        let Monitor { state, look, .. } = &monitor;
        let drawn = screen.terminal.draw(|frame| draw(frame, state, look, Instant::now()));
        drawn.map_err(|e| failed("draw", &e))?;
        due = (due + FRAME).max(Instant::now());
        loop {
            // Where the machine is so slow that the next picture is due already, a key is still heard.
            let left = due.saturating_duration_since(Instant::now());
            if !event::poll(left.max(KEY_WAIT)).map_err(|e| failed("wait for a key", &e))? {
                break;
            }
            match event::read().map_err(|e| failed("read a key", &e))? {
                Event::Key(key) => match monitor.pressed(key) {
                    Wish::GoOn => {}
                    Wish::Afresh => screen.terminal.clear().map_err(|e| failed("clear the screen", &e))?,
                    Wish::Quit => return Ok(()),
                },
                // The next picture has the new size.
                Event::Resize(..) => {}
                _ => {}
            }
            if left.is_zero() {
                break;
            }
        }
    }
    Err(Failure::new(Kind::Interrupted, "interrupted; the run goes on"))
}

fn failed(what: &str, error: &io::Error) -> Failure {
    Failure::new(Kind::Device, format!("terminal: can't {what}: {error}"))
}

/// While it lives, the terminal is the monitor's. A panic gives it back, too, before its message.
pub struct Screen {
    /// To draw on.
    pub terminal: DefaultTerminal,
}

impl Screen {
    /// Takes the terminal of stdout.
    ///
    /// # Errors
    /// It can't be had; it is as it was then.
    pub fn open() -> io::Result<Screen> {
        match ratatui::try_init() {
            Ok(terminal) => Ok(Screen { terminal }),
            Err(error) => {
                // Half of it may have been taken already.
                let _ = ratatui::try_restore();
                Err(error)
            }
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // A terminal that is gone needs nothing.
        let _ = self.terminal.show_cursor();
        let _ = ratatui::try_restore();
    }
}

/// What a key asks of the screen.
#[derive(Debug, PartialEq, Eq)]
enum Wish {
    GoOn,
    Afresh,
    Quit,
}

struct Monitor {
    state: State,
    look: Look,
    /// What became of commands, from the threads that wait for it.
    answers: (mpsc::Sender<Said>, mpsc::Receiver<Said>),
}

type Said = (Severity, String);

impl Monitor {
    fn pressed(&mut self, key: KeyEvent) -> Wish {
        if key.kind == KeyEventKind::Release {
            return Wish::GoOn;
        }
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        match key.code {
            KeyCode::Char('c') if control => return Wish::Quit,
            KeyCode::Char('l') if control => return Wish::Afresh,
            KeyCode::Char('q') | KeyCode::Esc => return Wish::Quit,
            KeyCode::Char('+' | '=') => self.look.wider(),
            KeyCode::Char('-') => self.look.narrower(),
            KeyCode::Tab => self.look.turn(),
            KeyCode::Char('s') => self.command(RunCommand::Stop, "stop"),
            KeyCode::Char('E') => self.command(RunCommand::EmergencyStop, "emergency stop"),
            _ => {}
        }
        Wish::GoOn
    }

    /// Sent from a thread of its own: the picture goes on while the answer is waited for.
    fn command(&mut self, command: RunCommand, name: &'static str) {
        if !self.look.controls() {
            let text = format!("no {name}: start the monitor with --control for that, or use `bench stop`");
            self.state.happenings.say(Severity::Warning, text);
            return;
        }
        self.state.happenings.say(Severity::Warning, format!("{name} is sent"));
        let (instance, answers) = (self.state.instance.clone(), self.answers.0.clone());
        let send = move || {
            let said = match send_command(&instance, command, PATIENCE) {
                Ok(Answer { taken: Ok(_), .. }) => (Severity::Info, format!("{name} was taken by the run")),
                Ok(Answer { taken: Err(refusal), .. }) => {
                    (Severity::Error, format!("{name} was NOT taken, the run goes on: {refusal}"))
                }
                Err(error) => (Severity::Error, format!("{name} did not arrive: {error}")),
            };
            // A monitor that was left meanwhile shows nothing any more.
            let _ = answers.send(said);
        };
        if let Err(error) = thread::Builder::new().name("command".to_owned()).spawn(send) {
            self.state.happenings.say(Severity::Error, format!("{name} could not be sent: {error}"));
        }
    }

    fn hear(&mut self) {
        for (severity, text) in self.answers.1.try_iter() {
            self.state.happenings.say(severity, text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn monitor(control: bool) -> Monitor {
        monitor_of("keys", control)
    }

    fn monitor_of(name: &str, control: bool) -> Monitor {
        let state = State::new(&format!("test-monitor-{name}-{}", std::process::id()));
        Monitor { state, look: Look::new(control, false), answers: mpsc::channel() }
    }

    fn key(code: KeyCode) -> KeyEvent {
        KeyEvent::new(code, KeyModifiers::NONE)
    }

    #[test]
    fn keys_that_would_stop_the_run_are_refused_unless_asked_for() {
        for code in [KeyCode::Char('s'), KeyCode::Char('E')] {
            let mut monitor = monitor(false);
            assert_eq!(monitor.pressed(key(code)), Wish::GoOn);
            let said: Vec<_> = monitor.state.latest(9).iter().map(|h| h.text.clone()).collect();
            assert_eq!(said.len(), 1);
            assert!(said[0].contains("--control"), "{said:?}");
        }
    }

    #[test]
    fn a_command_that_nobody_hears_is_said() {
        let mut monitor = monitor(true);
        assert_eq!(monitor.pressed(key(KeyCode::Char('s'))), Wish::GoOn);
        let (severity, text) = monitor.answers.1.recv().expect("the thread answers");
        assert_eq!(severity, Severity::Error);
        assert!(text.starts_with("stop did not arrive") && text.contains("no running service"), "{text}");
    }

    #[test]
    fn a_command_that_was_refused_is_not_told_as_taken() {
        let mut monitor = monitor_of("refused", true);
        let instance = monitor.state.instance.clone();
        crate::refusing::refusing(&instance, rt_core::Refusal::ReadOnly, || {
            assert_eq!(monitor.pressed(key(KeyCode::Char('E'))), Wish::GoOn);
            let (severity, text) = monitor.answers.1.recv().expect("the thread answers");
            assert_eq!(severity, Severity::Error);
            assert!(text.starts_with("emergency stop was NOT taken") && text.contains("read-only"), "{text}");
        });
    }

    #[test]
    fn keys_to_leave_and_to_look() {
        let mut monitor = monitor(false);
        for code in [KeyCode::Char('q'), KeyCode::Esc] {
            assert_eq!(monitor.pressed(key(code)), Wish::Quit);
        }
        assert_eq!(monitor.pressed(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL)), Wish::Quit);
        assert_eq!(monitor.pressed(KeyEvent::new(KeyCode::Char('l'), KeyModifiers::CONTROL)), Wish::Afresh);
        let before = monitor.look;
        monitor.pressed(key(KeyCode::Char('+')));
        assert_ne!(monitor.look, before);
        monitor.pressed(key(KeyCode::Char('-')));
        assert_eq!(monitor.look, before);
        // A small e is none: the emergency stop needs the shift key.
        assert_eq!(monitor.pressed(key(KeyCode::Char('e'))), Wish::GoOn);
        assert!(monitor.state.latest(9).is_empty());
    }
}
