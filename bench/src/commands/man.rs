//! `bench man --out DIR`

use super::COMMANDS;
use super::help::{about, examples_of};
use super::list::{Entry, Example, Group};
use crate::failure::{EXIT_CODES, Failure, Kind};
use crate::progress::Progress;
use clap::{Command, CommandFactory};
use clap_mangen::Man;
use clap_mangen::roff::{Roff, bold, roman};
use std::io;
use std::path::{Path, PathBuf};

/// Write the manual pages, one a command
///
/// Pages that are there already are written anew. `man -M DIR bench` reads them where DIR/man1 holds them.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to write to, such as ~/.local/share/man/man1
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let dir = &args.out;
    let unwritten = |what: &Path, error: &io::Error| {
        let message =
            format!("{}: expected to write it, got \"{error}\"; choose another folder with --out", what.display());
        Failure::new(Kind::Input, message)
    };
    std::fs::create_dir_all(dir).map_err(|e| unwritten(dir, &e))?;
    let pages = pages().map_err(|e| Failure::of(Kind::Internal, &e))?;
    for (name, text) in &pages {
        let file = dir.join(name);
        std::fs::write(&file, text).map_err(|e| unwritten(&file, &e))?;
    }
    progress.result(&format!("written: {} pages in {}", pages.len(), dir.display()));
    Ok(())
}

/// Name and text of each page.
///
/// # Errors
/// Writing to memory fails, which it does not.
fn pages() -> io::Result<Vec<(String, Vec<u8>)>> {
    let mut root = super::Cli::command().disable_help_subcommand(true);
    root.build();
    let mut pages = vec![("bench.1".to_owned(), first_page(&root)?)];
    for entry in COMMANDS {
        if let Some(sub) = root.find_subcommand(entry.name) {
            page(sub, entry, &format!("bench {}", entry.name), &mut pages)?;
        }
    }
    Ok(pages)
}

/// The page of a command, and those of its subcommands.
fn page(command: &Command, entry: &Entry, words: &str, pages: &mut Vec<(String, Vec<u8>)>) -> io::Result<()> {
    let name = words.replace(' ', "-");
    let man = titled(command, &name);
    let mut text = Vec::new();
    man.render_title(&mut text)?;
    man.render_name_section(&mut text)?;
    man.render_synopsis_section(&mut text)?;
    man.render_description_section(&mut text)?;
    man.render_options_section(&mut text)?;
    let own = |sub: &&Command| !sub.is_hide_set() && sub.get_name() != "help";
    if command.get_subcommands().any(|sub| own(&sub)) {
        man.render_subcommands_section(&mut text)?;
    }
    let mut end = Roff::new();
    end.control("SH", ["EXAMPLES"]);
    let examples: Vec<&Example> = examples_of(entry, words).collect();
    // What a subcommand has none of its own for, its command's show.
    let examples = if examples.is_empty() { entry.examples.iter().collect() } else { examples };
    for Example { line, what } in examples {
        end.control("TP", []);
        end.text([bold(*line)]);
        end.text([roman(*what)]);
    }
    exit_status(&mut end);
    see_also(&mut end);
    end.to_writer(&mut text)?;
    pages.push((format!("{name}.1"), text));
    for sub in command.get_subcommands().filter(own) {
        page(sub, entry, &format!("{words} {}", sub.get_name()), pages)?;
    }
    Ok(())
}

/// `bench(1)`: the commands by group.
fn first_page(root: &Command) -> io::Result<Vec<u8>> {
    let man = titled(root, "bench");
    let mut text = Vec::new();
    man.render_title(&mut text)?;
    man.render_name_section(&mut text)?;
    man.render_synopsis_section(&mut text)?;
    man.render_description_section(&mut text)?;
    let mut roff = Roff::new();
    roff.control("SH", ["COMMANDS"]);
    for group in Group::ALL {
        roff.control("SS", [group.title()]);
        for entry in COMMANDS.iter().filter(|entry| entry.group == group) {
            roff.control("TP", []);
            roff.text([bold(format!("bench-{}", entry.name)), roman("(1)")]);
            roff.text([roman(about(root, entry.name))]);
        }
    }
    roff.control("SH", ["EXAMPLES"]);
    for Example { line, what } in COMMANDS.iter().filter_map(|entry| entry.examples.first()) {
        roff.control("TP", []);
        roff.text([bold(*line)]);
        roff.text([roman(*what)]);
    }
    exit_status(&mut roff);
    roff.to_writer(&mut text)?;
    man.render_options_section(&mut text)?;
    man.render_version_section(&mut text)?;
    Ok(text)
}

fn titled(command: &Command, name: &str) -> Man {
    let source = format!("bench {}", env!("CARGO_PKG_VERSION"));
    Man::new(command.clone()).title(name).source(source).manual("rec-bench")
}

fn exit_status(roff: &mut Roff) {
    roff.control("SH", ["EXIT STATUS"]);
    for (code, meaning) in EXIT_CODES {
        roff.control("TP", []);
        roff.text([bold(code.to_string())]);
        roff.text([roman(*meaning)]);
    }
}

fn see_also(roff: &mut Roff) {
    roff.control("SH", ["SEE ALSO"]);
    roff.text([bold("bench"), roman("(1)")]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::help::command;

    #[test]
    fn every_command_has_a_page_with_its_options_examples_and_exit_status() {
        let pages = pages().expect("memory takes it");
        let with_help = command();
        let page = |name: &str| {
            let (_, text) = pages.iter().find(|(page, _)| page == name).unwrap_or_else(|| panic!("no page {name}"));
            // A hyphen that must not be broken is written with a backslash.
            String::from_utf8(text.clone()).expect("UTF-8").replace("\\-", "-")
        };
        let first = page("bench.1");
        for entry in COMMANDS {
            let text = page(&format!("bench-{}.1", entry.name));
            for section in ["NAME", "SYNOPSIS", "DESCRIPTION", "EXAMPLES", "\"EXIT STATUS\""] {
                assert_eq!(text.matches(&format!(".SH {section}\n")).count(), 1, "{section} in {text}");
            }
            for example in entry.examples {
                assert!(text.contains(example.line), "{} in {text}", example.line);
            }
            let sub = with_help.find_subcommand(entry.name).expect("it is in the table");
            for option in sub.get_arguments().filter(|a| !a.is_hide_set()).filter_map(|a| a.get_long()) {
                assert!(text.contains(&format!("--{option}")), "--{option} in {text}");
            }
            assert!(first.contains(&format!("bench-{}", entry.name)));
        }
        assert!(page("bench-profile-check.1").contains("bench profile check my.toml"));
        assert!(Group::ALL.iter().all(|group| first.contains(group.title())));
    }
}
