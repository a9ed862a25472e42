//! The help: commands in groups, examples, exit codes, out of the table of commands.

use super::list::{Entry, Example, Group};
use super::{COMMANDS, Cli};
use crate::failure::EXIT_CODES;
use clap::{Arg, ArgAction, Command, CommandFactory, FromArgMatches};
use std::any::TypeId;

/// Width at which the list of commands is broken; clap breaks everything else there.
const COLUMNS: usize = 100;

/// Parses the process's arguments; ends with 2 on bad usage, with 0 on `--help` and `--version`.
pub fn parse() -> Cli {
    let matches = command().get_matches();
    Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}

/// The command line with its help.
pub fn command() -> Command {
    let plain = Cli::command();
    let template =
        format!("{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{}{{options}}{{after-help}}", groups(&plain));
    let with_help = COMMANDS.iter().fold(plain, |command, entry| {
        command.mut_subcommand(entry.name, |sub| with_examples(sub, &format!("bench {}", entry.name), entry.examples))
    });
    // The template says the commands itself.
    with_negative_numbers(with_help).help_template(template).after_help(after())
}

/// Lets every option that is a number take `-1`. What is out of range is refused as that then, and not as an option that nobody knows.
fn with_negative_numbers(command: Command) -> Command {
    let names: Vec<String> = command.get_subcommands().map(|sub| sub.get_name().to_owned()).collect();
    let command = names.into_iter().fold(command, |command, name| command.mut_subcommand(name, with_negative_numbers));
    command.mut_args(|arg| if is_number(&arg) { arg.allow_negative_numbers(true) } else { arg })
}

/// Whether it is an option whose value is a number.
fn is_number(arg: &Arg) -> bool {
    let types = [
        TypeId::of::<f64>(),
        TypeId::of::<u8>(),
        TypeId::of::<u16>(),
        TypeId::of::<u32>(),
        TypeId::of::<u64>(),
        TypeId::of::<usize>(),
        TypeId::of::<i32>(),
    ];
    let takes_value = matches!(arg.get_action(), ArgAction::Set | ArgAction::Append);
    takes_value && !arg.is_positional() && types.iter().any(|number| arg.get_value_parser().type_id() == *number)
}

/// The examples of a command that begin with these words; a subcommand has those that are its own.
pub(super) fn examples_of<'a>(entry: &'a Entry, words: &str) -> impl Iterator<Item = &'a Example> {
    let begin = format!("{words} ");
    entry.examples.iter().filter(move |example| example.line == begin.trim_end() || example.line.starts_with(&begin))
}

fn with_examples(command: Command, words: &str, examples: &[Example]) -> Command {
    let own = |e: &&Example| e.line == words || e.line.starts_with(&format!("{words} "));
    let lines: Vec<String> =
        examples.iter().filter(own).map(|Example { line, what }| format!("  # {what}\n  {line}")).collect();
    let names: Vec<String> = command.get_subcommands().map(|sub| sub.get_name().to_owned()).collect();
    let command = names.into_iter().fold(command, |command, name| {
        let words = format!("{words} {name}");
        command.mut_subcommand(name, |sub| with_examples(sub, &words, examples))
    });
    if lines.is_empty() { command } else { command.after_help(format!("Examples:\n{}", lines.join("\n"))) }
}

/// The commands by group, each with the first line of its help.
fn groups(command: &Command) -> String {
    let width = COMMANDS.iter().map(|entry| entry.name.len()).max().unwrap_or(0) + 4;
    let mut text = String::new();
    for group in Group::ALL {
        let entries: Vec<&Entry> = COMMANDS.iter().filter(|entry| entry.group == group).collect();
        if entries.is_empty() {
            continue;
        }
        text += &format!("{}:\n", group.title());
        for entry in entries {
            let mut begin = format!("  {:<w$}", entry.name, w = width - 2);
            for line in broken(&about(command, entry.name), COLUMNS - width) {
                text += &format!("{begin}{line}\n");
                begin = " ".repeat(width);
            }
        }
        text.push('\n');
    }
    text + "Options:\n"
}

/// The first line of a command's help.
pub(super) fn about(command: &Command, name: &str) -> String {
    command.find_subcommand(name).and_then(|sub| sub.get_about()).map(ToString::to_string).unwrap_or_default()
}

fn after() -> String {
    let codes: Vec<String> = EXIT_CODES.iter().map(|(code, meaning)| format!("  {code:>3}  {meaning}")).collect();
    format!(
        "`bench COMMAND --help` says more, with examples. RUST_LOG=info tells what happens within.\n\nExit codes:\n{}",
        codes.join("\n")
    )
}

/// Lines of at most `columns` characters, broken at blanks.
fn broken(text: &str, columns: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last_mut().expect("there is a first line");
        if line.is_empty() {
            line.push_str(word);
        } else if line.chars().count() + 1 + word.chars().count() <= columns {
            line.push(' ');
            line.push_str(word);
        } else {
            lines.push(word.to_owned());
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
    }

    #[test]
    fn the_table_holds_every_command_once_with_an_example() {
        let listed: Vec<&str> = COMMANDS.iter().map(|entry| entry.name).collect();
        let parsed: BTreeSet<String> = Cli::command().get_subcommands().map(|c| c.get_name().to_owned()).collect();
        assert_eq!(listed.len(), parsed.len());
        assert_eq!(listed.iter().map(ToString::to_string).collect::<BTreeSet<_>>(), parsed);
        for entry in COMMANDS {
            let own = examples_of(entry, &format!("bench {}", entry.name)).count();
            assert_eq!(own, entry.examples.len(), "an example of {} is another command's", entry.name);
            assert!(own > 0);
            assert!(Group::ALL.contains(&entry.group));
        }
    }

    #[test]
    fn every_example_is_one_that_the_program_takes() {
        for example in COMMANDS.iter().flat_map(|entry| entry.examples) {
            assert!(!example.line.contains(['"', '\'', '$', '|', ';']), "{}: words and blanks only", example.line);
            if let Err(error) = command().try_get_matches_from(example.line.split(' ')) {
                panic!("{}: {error}", example.line);
            }
        }
    }

    #[test]
    fn the_help_has_each_command_under_its_group_and_the_examples() {
        let help = command().render_help().to_string();
        let mut before = 0;
        for group in Group::ALL {
            let at = help.find(&format!("\n{}:\n", group.title())).unwrap_or_else(|| panic!("{group:?} in {help}"));
            assert!(at > before, "in order");
            before = at;
            let section = help[at..].split("\n\n").next().unwrap_or_default();
            for entry in COMMANDS.iter().filter(|entry| entry.group == group) {
                assert!(section.contains(&format!("\n  {} ", entry.name)), "{} in {section}", entry.name);
            }
        }
        assert!(help.contains("--version") && help.contains("130  interrupted"), "{help}");
        let listed = help.lines().filter(|line| line.starts_with("  "));
        assert!(listed.clone().count() > COMMANDS.len());
        assert!(listed.into_iter().all(|line| line.chars().count() <= COLUMNS), "{help}");
        let mut with_help = command();
        for entry in COMMANDS {
            let sub = with_help.find_subcommand_mut(entry.name).expect("it is in the table");
            let help = sub.render_long_help().to_string();
            for Example { line, what } in entry.examples {
                assert!(help.contains(line) && help.contains(what), "{line} in {help}");
            }
        }
    }

    #[test]
    fn a_subcommand_has_its_own_examples_only() {
        let mut command = command();
        let profile = command.find_subcommand_mut("profile").expect("it is there");
        let check = profile.find_subcommand_mut("check").expect("it is there").render_help().to_string();
        assert!(check.contains("bench profile check my.toml") && !check.contains("bench profile list"), "{check}");
    }

    #[test]
    fn a_number_below_zero_is_told_as_what_it_is() {
        for (line, expected) in [
            ("bench run square_h --seed -1", "expected a whole number from 0 to 18446744073709551615"),
            ("bench campaign --plan-only --seed -1", "expected a whole number from 0"),
            ("bench blind --cases -1", "-1 is not in 1..=100000"),
            ("bench profile check square_h --seed -1", "expected a whole number from 0"),
            ("bench service queue square_h --seed -1", "expected a whole number from 0"),
            ("bench emulate --serial a --can b --priority -5", "-5 is not in 1..=98"),
            ("bench record --out a.mcap --runs -1", "-1"),
            ("bench latency --seconds -1", "--seconds"),
        ] {
            let error = command().try_get_matches_from(line.split(' ')).expect_err(line).to_string();
            assert!(error.contains("invalid value '-") && error.contains(expected), "{line}: {error}");
            assert!(!error.contains("-- -"), "{line}: {error}");
        }
        // What is no number stays an option.
        let error = command().try_get_matches_from(["bench", "run", "square_h", "-1"]).expect_err("none").to_string();
        assert!(error.contains("unexpected argument"), "{error}");
    }

    #[test]
    fn a_name_that_no_instance_can_have_is_bad_usage_everywhere() {
        let mut asked = 0;
        for entry in COMMANDS {
            let example = entry.examples[0].line;
            let takes = |command: Command, name: &str| {
                command
                    .find_subcommand(name)
                    .is_some_and(|sub| sub.get_arguments().any(|arg| arg.get_id() == "instance"))
            };
            if !takes(command(), entry.name) {
                continue;
            }
            asked += 1;
            let arguments = example.split(' ').chain(["--instance", "a/b"]);
            let error = command().try_get_matches_from(arguments).expect_err(example);
            assert_eq!(error.exit_code(), 2);
            assert!(error.to_string().contains("instance name \"a/b\": expected 1..=64"), "{example}: {error}");
        }
        assert!(asked >= 8, "{asked}");
    }

    #[test]
    fn text_is_broken_at_blanks() {
        assert_eq!(broken("one two three", 7), ["one two", "three"]);
        assert_eq!(broken("longer than it", 4), ["longer", "than", "it"]);
        assert_eq!(broken("", 4), [""]);
    }
}
