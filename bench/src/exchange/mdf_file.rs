//! A run as ASAM MDF 4.1 (`.mf4`): a finished, sorted file, one channel group for the samples, one for the events, one for the
//! amplifier's reports. Records are written in pieces as they come; what describes them stands behind, and the header is written last.
//!
//! A writer of its own: the crate there is (`mf4-rs` 3.8) writes no file history, which the standard asks of every file, and holds
//! texts in memory.

use super::content::Content;
use super::mdf_blocks::{self as blocks, Slot};
use super::output::{Output, unwritten};
use super::source::Source;
use super::table::{Block, Column, Kind as Holds, Values};
use crate::failure::{Failure, Kind};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Bytes of a piece of data: what memory holds at a time.
const PIECE: usize = 1 << 20;

/// Writes a run: `samples` ([`Content::Rows`] or [`Content::Raw`]), and the other tables where they hold anything.
///
/// # Errors
/// The target exists, the run can't be read to its end, the system refuses (2). Nothing is left behind.
pub fn write(source: &Source, samples: Content, target: &Path) -> Result<PathBuf, Failure> {
    let refused = |e: io::Error| unwritten(target, &e);
    let mut file = MdfFile::create(target)?;
    let mut groups = vec![file.group(source, samples)?];
    if source.has_items() {
        for content in [Content::Events, Content::Amplifier] {
            let group = file.group(source, content)?;
            if group.records > 0 {
                groups.push(group);
            }
        }
    }
    file.describe(&groups, &source.facts()).map_err(refused)?;
    file.output.commit()
}

struct MdfFile {
    output: Output,
    /// Where the next byte goes.
    at: u64,
}

/// The data of a table, written.
struct Group {
    content: Content,
    columns: Vec<Column>,
    records: u64,
    data: Pieces,
    /// Texts, column by column; empty for others.
    texts: Vec<Pieces>,
}

/// Content that stands in pieces.
struct Pieces {
    kind: &'static [u8; 2],
    open: Vec<u8>,
    /// Address, and bytes of content before it.
    written: Vec<(u64, u64)>,
    /// Bytes of content in what is written.
    bytes: u64,
}

impl Pieces {
    fn new(kind: &'static [u8; 2]) -> Pieces {
        Pieces { kind, open: Vec::new(), written: Vec::new(), bytes: 0 }
    }

    /// Bytes of content so far.
    fn len(&self) -> u64 {
        self.bytes + self.open.len() as u64
    }
}

impl MdfFile {
    fn create(target: &Path) -> Result<MdfFile, Failure> {
        let mut file = MdfFile { output: Output::create(target)?, at: 0 };
        let begun = file.append(&blocks::identification()).and_then(|_| file.append(&blocks::header(0, 0, 0)));
        begun.map_err(|e| unwritten(target, &e))?;
        Ok(file)
    }

    /// Appends a block and says where it stands.
    fn append(&mut self, block: &[u8]) -> io::Result<u64> {
        let address = self.at.next_multiple_of(8);
        let padding = [0; 8];
        self.output.write_all(&padding[..(address - self.at) as usize])?;
        self.output.write_all(block)?;
        self.at = address + block.len() as u64;
        Ok(address)
    }

    fn close_piece(&mut self, pieces: &mut Pieces) -> io::Result<()> {
        if pieces.open.is_empty() {
            return Ok(());
        }
        let length = pieces.open.len() as u64;
        let address = self.append(&blocks::piece_head(pieces.kind, length))?;
        self.output.write_all(&pieces.open)?;
        self.at += length;
        pieces.written.push((address, pieces.bytes));
        pieces.bytes += length;
        pieces.open.clear();
        Ok(())
    }

    /// Writes the data of a table.
    fn group(&mut self, source: &Source, content: Content) -> Result<Group, Failure> {
        let columns = content.columns();
        let texts = columns.iter().map(|_| Pieces::new(b"SD")).collect();
        let mut group = Group { content, columns, records: 0, data: Pieces::new(b"DT"), texts };
        let target = self.output.target().to_owned();
        for block in source.blocks(content)? {
            let block = block.map_err(|e| Failure::of(Kind::Input, &e))?;
            self.records(&mut group, &block).map_err(|e| unwritten(&target, &e))?;
        }
        let Group { data, texts, .. } = &mut group;
        let closed = std::iter::once(data).chain(texts).try_for_each(|pieces| self.close_piece(pieces));
        closed.map_err(|e| unwritten(&target, &e))?;
        Ok(group)
    }

    fn records(&mut self, group: &mut Group, block: &Block) -> io::Result<()> {
        for row in 0..block.rows() {
            for (values, texts) in block.values.iter().zip(&mut group.texts) {
                let record = &mut group.data.open;
                match values {
                    Values::Number(values) => record.extend(values[row].to_le_bytes()),
                    Values::Natural(values) => record.extend(values[row].to_le_bytes()),
                    Values::Integer(values) => record.extend(values[row].to_le_bytes()),
                    Values::Flag(values) => record.push(u8::from(values[row])),
                    Values::Text(values) => {
                        record.extend(texts.len().to_le_bytes());
                        // A zero byte would end the text.
                        let text = values[row].replace('\0', "");
                        texts.open.extend((text.len() as u32 + 1).to_le_bytes());
                        texts.open.extend_from_slice(text.as_bytes());
                        texts.open.push(0);
                        if texts.open.len() >= PIECE {
                            self.close_piece(texts)?;
                        }
                    }
                }
            }
            group.records += 1;
            if group.data.open.len() >= PIECE {
                self.close_piece(&mut group.data)?;
            }
        }
        Ok(())
    }

    /// Writes what describes the data, and the header at last.
    fn describe(&mut self, groups: &[Group], facts: &[(String, String)]) -> io::Result<()> {
        let mut next = 0;
        for group in groups.iter().rev() {
            next = self.data_group(group, next)?;
        }
        let comment = self.append(&blocks::text(b"MD", &header_comment(facts)))?;
        let tool = self.append(&blocks::text(b"MD", &history_comment()))?;
        let history = self.append(&blocks::history(tool))?;
        self.output.seek(SeekFrom::Start(blocks::HEADER_AT))?;
        self.output.write_all(&blocks::header(next, history, comment))
    }

    fn data_group(&mut self, group: &Group, next_group: u64) -> io::Result<u64> {
        let record_bytes = group.columns.iter().map(|column| slot(column, false).bytes).sum();
        let mut offset: u32 = record_bytes;
        let mut next = 0;
        for (index, (column, texts)) in group.columns.iter().zip(&group.texts).enumerate().rev() {
            let slot = slot(column, index == 0);
            offset -= slot.bytes;
            let mut words = [0; 3];
            for (word, said) in words.iter_mut().zip([column.name, column.unit, column.about]) {
                if !said.is_empty() {
                    *word = self.append(&blocks::text(b"TX", said))?;
                }
            }
            let signal_data = self.list(texts)?;
            next = self.append(&blocks::channel(next, slot, offset, signal_data, words))?;
        }
        let name = self.append(&blocks::text(b"TX", group.content.name()))?;
        let about = self.append(&blocks::text(b"TX", group.content.about()))?;
        let channels = self.append(&blocks::channel_group(next, name, about, group.records, record_bytes))?;
        let data = self.list(&group.data)?;
        self.append(&blocks::data_group(next_group, channels, data))
    }

    /// The address under which content in pieces is found; 0: there is none.
    fn list(&mut self, pieces: &Pieces) -> io::Result<u64> {
        match pieces.written.as_slice() {
            [] => Ok(0),
            [(address, _)] => Ok(*address),
            several => self.append(&blocks::list(several)),
        }
    }
}

fn slot(column: &Column, first: bool) -> Slot {
    let (channel, data, bytes) = match column.kind {
        Holds::Number if first => (2, 4, 8),
        Holds::Number => (0, 4, 8),
        Holds::Natural => (0, 0, 8),
        Holds::Integer => (0, 2, 8),
        Holds::Flag => (0, 0, 1),
        Holds::Text => (1, 7, 8),
    };
    Slot { channel, data, bytes }
}

fn header_comment(facts: &[(String, String)]) -> String {
    let properties: String =
        facts.iter().map(|(key, value)| format!("<e name=\"{}\">{}</e>", escaped(key), escaped(value))).collect();
    format!(
        "<HDcomment><TX>Recording of a rec-bench run. Missing values are NaN.</TX>\
         <common_properties>{properties}</common_properties></HDcomment>"
    )
}

fn history_comment() -> String {
    format!(
        "<FHcomment><TX>exported from a recording</TX><tool_id>rec-bench</tool_id><tool_vendor>rec-bench</tool_vendor>\
         <tool_version>{}</tool_version></FHcomment>",
        env!("CARGO_PKG_VERSION")
    )
}

/// For XML: what it can't hold at all is shown as such.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\n' | '\t' => out.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}
