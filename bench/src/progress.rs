//! Progress on stderr: bars on a terminal, one plain line a finished step elsewhere.

use crate::failure::{Failure, Kind};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal, Write};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// All progress of a command. Clones share the screen.
#[derive(Clone)]
pub struct Progress {
    bars: MultiProgress,
    terminal: bool,
    /// Results go to stderr too: stdout holds something else.
    aside: bool,
    /// Why stdout did not take a result, the first time.
    refused: Arc<OnceLock<String>>,
}

/// A line at the bottom, for what is being typed; nothing where stderr is no terminal.
pub struct Prompt(ProgressBar);

/// One step under way.
pub struct Step {
    bar: ProgressBar,
    progress: Progress,
    name: String,
}

impl Progress {
    /// For the process's stderr.
    pub fn for_stderr() -> Self {
        Self::new(io::stderr().is_terminal())
    }

    fn new(terminal: bool) -> Self {
        let target = if terminal { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        Progress { bars: MultiProgress::with_draw_target(target), terminal, aside: false, refused: Arc::default() }
    }

    /// The same where `json` takes stdout: what is meant for people goes to stderr then, results included.
    pub fn beside(&self, json: bool) -> Self {
        Progress { aside: self.aside || json, ..self.clone() }
    }

    /// A result for scripts, as indented JSON on stdout. Where stdout does not take it, [`Progress::taken`] says so.
    ///
    /// # Errors
    /// It can't be written as JSON, which is a defect (1).
    pub fn json(&self, value: &impl serde::Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(value).map_err(|e| Failure::of(Kind::Internal, &e))?;
        self.out(&text);
        Ok(())
    }

    /// Begins a step of `total` units (0 = unknown).
    pub fn step(&self, name: impl Into<String>, total: u64) -> Step {
        let name = name.into();
        let bar = if total > 0 { ProgressBar::new(total) } else { ProgressBar::new_spinner() };
        let template =
            if total > 0 { "{msg:24} [{bar:30}] {percent:>3} %  {elapsed}" } else { "{msg:24} {spinner} {elapsed}" };
        bar.set_style(
            ProgressStyle::with_template(template).expect("the template is a literal that indicatif accepts"),
        );
        let bar = self.bars.add(bar);
        bar.set_message(name.clone());
        if self.terminal {
            bar.enable_steady_tick(Duration::from_millis(120));
        }
        Step { bar, progress: self.clone(), name }
    }

    /// A line for what is being typed.
    pub fn prompt(&self) -> Prompt {
        let bar = self.bars.add(ProgressBar::new_spinner());
        bar.set_style(ProgressStyle::with_template("{msg}").expect("the template is a literal that indicatif accepts"));
        Prompt(bar)
    }

    /// A line that stays, above the bars.
    pub fn say(&self, line: &str) {
        if self.terminal {
            // A terminal that went away is no reason to stop a run.
            let _ = self.bars.println(line);
        } else {
            let _ = writeln!(io::stderr(), "{line}");
        }
    }

    /// A line on stdout, where the results go, without tearing the bars. Where stdout does not take it, [`Progress::taken`] says so.
    pub fn result(&self, line: &str) {
        if self.aside {
            return self.say(line);
        }
        self.out(line);
    }

    fn out(&self, text: &str) {
        self.bars.suspend(|| {
            let mut stdout = io::stdout().lock();
            let written = writeln!(stdout, "{text}").and_then(|()| stdout.flush());
            // Who closes a pipe has read enough. Anything else is a result that is lost; what the command does to a rig, and its files, must
            // not suffer from that, so it is told at its end.
            if let Err(error) = written
                && error.kind() != io::ErrorKind::BrokenPipe
            {
                // The first refusal is the cause of those that follow.
                let _ = self.refused.set(error.to_string());
            }
        });
    }

    /// Whether stdout took all results.
    ///
    /// # Errors
    /// It did not (2).
    pub fn taken(&self) -> Result<(), Failure> {
        let Some(error) = self.refused.get() else { return Ok(()) };
        let message = format!(
            "stdout: expected to write the results, got \"{error}\"; make room where it leads to, or redirect it to another file, and repeat the command"
        );
        Err(Failure::new(Kind::Input, message))
    }
}

impl Prompt {
    /// Shows this text.
    pub fn show(&self, text: &str) {
        if self.0.message() != text {
            self.0.set_message(text.to_owned());
            self.0.tick();
        }
    }

    /// Shows nothing.
    pub fn hide(&self) {
        self.show("");
    }
}

impl Drop for Prompt {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}

impl Step {
    /// So many units are done in all.
    pub fn at(&self, done: u64) {
        self.bar.set_position(done);
    }

    /// What [`Step::at`] does, for another thread.
    pub fn counter(&self) -> impl Fn(u64) + Send + 'static {
        let bar = self.bar.clone();
        move |done| bar.set_position(done)
    }

    /// Ends the step without a word.
    pub fn finish(self) {}

    /// Ends the step with a line that stays.
    pub fn done(self, text: &str) {
        self.bar.finish_and_clear();
        self.progress.say(&format!("{}: {text}", self.name));
    }
}

impl Drop for Step {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Lets `tracing` write to stderr without tearing the bars.
impl Write for Progress {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bars.suspend(|| io::stderr().write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}
