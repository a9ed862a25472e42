//! `bench completions SHELL`

use super::help::command;
use crate::failure::Failure;
use crate::progress::Progress;
use clap_complete::{Shell, generate};

/// Print the completions of a shell
///
/// bash: `bench completions bash > ~/.local/share/bash-completion/completions/bench`;
/// zsh: to a file `_bench` in a folder of $fpath; fish: `bench completions fish > ~/.config/fish/completions/bench.fish`;
/// elvish and PowerShell: from the file that the shell reads at its start.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Whose
    shell: Shell,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let mut script = Vec::new();
    generate(args.shell, &mut command(), "bench", &mut script);
    progress.result(String::from_utf8_lossy(&script).trim_end());
    Ok(())
}
