//! What the table of commands consists of: from it come the command line, its help, the completions and the manual pages.

/// What a user wants to do; the order is that of `bench --help`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Something moves.
    Run,
    /// A run of another process, or of another machine.
    Watch,
    /// Files that runs have left.
    Recordings,
    /// What the recordings say of the rig.
    Model,
    /// Before a rig is run.
    Machine,
    /// The program itself.
    Program,
}

impl Group {
    /// All of them, in order.
    pub const ALL: [Group; 6] =
        [Group::Run, Group::Watch, Group::Recordings, Group::Model, Group::Machine, Group::Program];

    /// Its heading.
    pub fn title(self) -> &'static str {
        match self {
            Group::Run => "Run experiments",
            Group::Watch => "Watch and record",
            Group::Recordings => "Look at recordings",
            Group::Model => "Model and diagnosis",
            Group::Machine => "Machine and wires",
            Group::Program => "This program",
        }
    }
}

/// A command line that can be copied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Example {
    /// As it is typed, words separated by blanks.
    pub line: &'static str,
    /// What it does.
    pub what: &'static str,
}

/// One command.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// As it is typed.
    pub name: &'static str,
    /// Where it stands in the help.
    pub group: Group,
    /// At least one.
    pub examples: &'static [Example],
}

/// Makes the command line's enum, the dispatch and the list of a table, one entry a command:
/// `Variant(module) in Group: "bench ..." => "what it does", ...;`
macro_rules! commands {
    ($($variant:ident($module:ident) in $group:ident: $($line:literal => $what:literal),+;)+) => {
        #[derive(Debug, Subcommand)]
        enum Command {
            $($variant($module::Args),)+
        }

        /// All commands, in the order of the help.
        pub const COMMANDS: &[Entry] = &[$(Entry {
            name: stringify!($module),
            group: Group::$group,
            examples: &[$(Example { line: $line, what: $what }),+],
        }),+];

        /// Runs what the command line asks for.
        pub fn run(cli: &Cli, progress: &Progress) -> Result<(), Failure> {
            match &cli.command {
                $(Command::$variant(args) => $module::run(args, progress),)+
            }
        }
    };
}
pub(super) use commands;
