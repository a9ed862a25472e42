//! A run that is to be exported: an MCAP recording, or a CSV run of a campaign.

use super::content::{self, Content};
use super::table::Block;
use crate::failure::{Failure, Kind};
use recordings::{
    CampaignError, CsvRows, Item, McapReader, Plane, Protocol, Recording, Role, Rows, RunEntry, RunMetadata,
};
use std::path::{Path, PathBuf};

/// Rows of a block at most.
const BLOCK_ROWS: usize = 4096;

/// A run that is to be exported.
pub struct Source {
    path: PathBuf,
    said: Said,
}

enum Said {
    /// The recording's own words, and the role that its campaign gives it.
    Mcap(Box<RunMetadata>),
    /// A run as CSV holds no words; these are the campaign's.
    Csv { protocol: Protocol, role: Role, plane: Plane },
}

/// Blocks of a table.
pub type Blocks = Box<dyn Iterator<Item = Result<Block, CampaignError>>>;

impl Source {
    /// Opens a recording.
    ///
    /// # Errors
    /// No recording of this project's format (2).
    pub fn open(path: &Path) -> Result<Source, Failure> {
        let name = path.to_string_lossy();
        if name.ends_with(".csv") || name.ends_with(".csv.gz") {
            let message = format!(
                "{name}: expected an MCAP recording or a campaign folder, got a CSV file, which does not say what its run is; \
                 `bench import` makes a recording of it"
            );
            return Err(Failure::new(Kind::Input, message));
        }
        let reader = McapReader::open(path).map_err(|e| Failure::of(Kind::Input, &e))?;
        Ok(Source { path: path.to_owned(), said: Said::Mcap(Box::new(reader.run().clone())) })
    }

    /// Opens a run of the campaign in `dir`.
    ///
    /// # Errors
    /// The recording can't be read, or says another protocol or plane than the campaign (2).
    pub fn of_campaign(dir: &Path, entry: &RunEntry) -> Result<Source, Failure> {
        let path = dir.join(&entry.file);
        let RunEntry { protocol, role, plane, .. } = *entry;
        if !entry.file.ends_with(".mcap") {
            return Ok(Source { path, said: Said::Csv { protocol, role, plane } });
        }
        let source = Source::open(&path)?;
        let Said::Mcap(mut run) = source.said else { return Ok(source) };
        if (run.protocol, run.plane) != (protocol, plane) {
            let message = format!(
                "{}: expected \"{protocol}\" and \"{plane}\" as in campaign.toml, got \"{}\" and \"{}\"; correct campaign.toml, \
                 or use the recording that belongs there",
                path.display(),
                run.protocol,
                run.plane
            );
            return Err(Failure::new(Kind::Input, message));
        }
        run.role = role;
        Ok(Source { path, said: Said::Mcap(run) })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Which experiment it is.
    pub fn protocol(&self) -> Protocol {
        match &self.said {
            Said::Mcap(run) => run.protocol,
            Said::Csv { protocol, .. } => *protocol,
        }
    }

    /// What is known of the run, by the names of the recording format's metadata.
    pub fn facts(&self) -> Vec<(String, String)> {
        let file = self.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut facts = vec![("source".to_owned(), file)];
        let mut say = |key: &str, value: &str| {
            if !value.is_empty() {
                facts.push((key.to_owned(), value.to_owned()));
            }
        };
        match &self.said {
            Said::Csv { protocol, role, plane } => {
                say("protocol", protocol.as_str());
                say("role", role.as_str());
                say("plane", plane.as_str());
            }
            Said::Mcap(run) => {
                say("name", &run.name);
                say("protocol", run.protocol.as_str());
                say("role", run.role.as_str());
                say("plane", run.plane.as_str());
                say("program", &run.program);
                say("profile", &run.profile);
                say("calibration", &run.calibration);
                let maps = [("host", &run.host), ("note", &run.notes), ("file", &run.files)];
                for (kind, texts) in maps {
                    texts.iter().for_each(|(name, text)| say(&format!("{kind}.{name}"), text));
                }
            }
        }
        facts
    }

    /// The contract's columns, block by block.
    ///
    /// # Errors
    /// The run can't be opened (2). The stream ends with an error where the file is damaged, has losses, or is no run of its
    /// protocol.
    pub fn rows(&self) -> Result<Box<dyn Iterator<Item = Result<Recording, CampaignError>>>, Failure> {
        let failed = |e: CampaignError| Failure::of(Kind::Input, &e);
        Ok(match &self.said {
            Said::Csv { protocol, .. } => Box::new(CsvRows::open(&self.path, *protocol).map_err(failed)?),
            Said::Mcap(_) => Box::new(Rows::open(&self.path).map_err(failed)?),
        })
    }

    /// A table, block by block; every block has at least one row.
    ///
    /// # Errors
    /// As [`rows`](Self::rows); of a CSV run there are rows only (2). Samples of a run with losses are given for what they are.
    pub fn blocks(&self, content: Content) -> Result<Blocks, Failure> {
        if content == Content::Rows {
            return Ok(Box::new(self.rows()?.map(|rows| rows.map(content::of_rows))));
        }
        if matches!(self.said, Said::Csv { .. }) {
            let message = format!(
                "{}: expected an MCAP recording, got a CSV run, which holds the contract's columns only; leave out --raw, \
                 --events and --amplifier",
                self.path.display()
            );
            return Err(Failure::new(Kind::Input, message));
        }
        let reader = McapReader::open(&self.path).map_err(|e| Failure::of(Kind::Input, &e))?;
        Ok(Box::new(Items { reader, content, done: false }))
    }

    /// The tables that there may be besides the rows.
    pub fn has_items(&self) -> bool {
        matches!(self.said, Said::Mcap(_))
    }
}

/// Items of one kind in blocks.
struct Items {
    reader: McapReader,
    content: Content,
    done: bool,
}

impl Iterator for Items {
    type Item = Result<Block, CampaignError>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut block = Block::empty(&self.content.columns());
        while !self.done && block.rows() < BLOCK_ROWS {
            match self.reader.next() {
                None => self.done = true,
                Some(Err(error)) => {
                    self.done = true;
                    return Some(Err(error));
                }
                Some(Ok(item)) => match (self.content, item) {
                    (Content::Raw, Item::Sample(sample)) => content::push_sample(&mut block, &sample),
                    (Content::Events, Item::Event(event)) => content::push_event(&mut block, &event),
                    (Content::Amplifier, Item::Amplifier(report)) => content::push_report(&mut block, &report),
                    _ => {}
                },
            }
        }
        (block.rows() > 0).then_some(Ok(block))
    }
}
