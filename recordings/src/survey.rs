//! What a damaged recording still holds: every record that proves itself, wherever it stands.
//!
//! The file is walked record by record. Where no sound record stands, damage begins, and it lasts to the next chunk or
//! metadata record that can be proven: a chunk by its checksum, our metadata by theirs.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;

use mcap::records::{Record, op};
use mcap::{MAGIC, parse_record};
use rt_core::LossCertificate;

use crate::chunk::{Chunk, Inner, LONGEST, RECORD_HEADER};
use crate::run_metadata::RunMetadata;
use crate::{ending, wire};

/// Fields of a chunk before its packed bytes, packed by zstd.
const CHUNK_HEADER: u64 = 44;
/// Bytes that are looked through at a time, and by how much two looks overlap.
const WINDOW: usize = 1024 * 1024;
const OVERLAP: usize = 64;

/// The records of a file that prove themselves.
#[derive(Default)]
pub(crate) struct Survey {
    /// The file's length.
    pub bytes: u64,
    /// What it says about its run.
    pub run: Option<RunMetadata>,
    /// Its certificate, where that carries a checksum.
    pub certificate: Option<LossCertificate>,
    /// Chunks, whole and with the right checksum.
    pub chunks: Vec<Range<u64>>,
    /// Bytes that are no sound record.
    pub damage: Vec<Range<u64>>,
    /// The end of an MCAP file stands where it belongs.
    pub ended: bool,
    /// From here on nothing looks like a chunk or like our metadata, as far as is known.
    quiet_from: Option<u64>,
    chunk: Chunk,
}

impl Survey {
    pub fn of(file: &File) -> io::Result<Survey> {
        let bytes = file.metadata()?.len();
        let mut survey = Survey { bytes, ..Survey::default() };
        let begin = MAGIC.len() as u64;
        let sound_begin = bytes >= begin && read(file, 0..begin)? == MAGIC;
        let (mut at, mut damaged_from) = if sound_begin { (begin, None) } else { (0, Some(0)) };
        while at < bytes {
            if let Some(end) = survey.record(file, at)? {
                survey.damage.extend(damaged_from.take().map(|from| from..at));
                at = end;
            } else {
                damaged_from.get_or_insert(at);
                at = survey.candidate(file, at + 1)?;
            }
        }
        survey.damage.extend(damaged_from.map(|from| from..bytes));
        Ok(survey)
    }

    /// Notes the record at `at` and says where it ends; `None`: no sound record stands there.
    fn record(&mut self, file: &File, at: u64) -> io::Result<Option<u64>> {
        let left = self.bytes - at;
        if left == MAGIC.len() as u64 && read(file, at..self.bytes)? == MAGIC {
            self.ended = true;
            return Ok(Some(self.bytes));
        }
        if left < RECORD_HEADER as u64 {
            return Ok(None);
        }
        let header = read(file, at..at + RECORD_HEADER as u64)?;
        let length = u64::from_le_bytes(header[1..].try_into().expect("nine bytes were read"));
        if length > (LONGEST as u64).min(left - RECORD_HEADER as u64) {
            return Ok(None);
        }
        let end = at + RECORD_HEADER as u64 + length;
        let opcode = header[0];
        let sound = match opcode {
            op::CHUNK => {
                let sound = open_chunk(&mut self.chunk, &read(file, at..end)?).is_some();
                if sound {
                    self.chunks.push(at..end);
                }
                sound
            }
            op::METADATA => self.metadata(&read(file, at..end)?),
            // A list of pairs whose own length must fit.
            op::MESSAGE_INDEX if length >= 6 => {
                let fields = read(file, at + RECORD_HEADER as u64..at + RECORD_HEADER as u64 + 6)?;
                let list = u32::from_le_bytes([fields[2], fields[3], fields[4], fields[5]]);
                u64::from(list) == length - 6 && list.is_multiple_of(16)
            }
            op::HEADER => at == MAGIC.len() as u64 && is_header(&read(file, at + RECORD_HEADER as u64..end)?),
            op::DATA_END => length == 4,
            op::FOOTER => length == 20,
            // The summary, and the event that closes a recording which was cut short. Nothing is taken from them; only
            // near the end of the file are they passed over.
            op::SCHEMA
            | op::CHANNEL
            | op::CHUNK_INDEX
            | op::STATISTICS
            | op::METADATA_INDEX
            | op::SUMMARY_OFFSET
            | op::MESSAGE => self.candidate(file, at + 1)? >= end,
            _ => false,
        };
        Ok(sound.then_some(end))
    }

    /// Where from `from` on a chunk or one of our metadata records may begin; the file's end if nowhere.
    fn candidate(&mut self, file: &File, from: u64) -> io::Result<u64> {
        if self.quiet_from.is_some_and(|quiet_from| from >= quiet_from) {
            return Ok(self.bytes);
        }
        let mut begin = from;
        while begin < self.bytes {
            let window = read(file, begin..self.bytes.min(begin + WINDOW as u64))?;
            let last = begin + window.len() as u64 == self.bytes;
            // A record whose sign may reach beyond the window is found in the next one.
            let places = if last { window.len() } else { window.len() - OVERLAP };
            match sign(&window, places) {
                Some(place) => return Ok(begin + place as u64),
                None => begin += places as u64,
            }
        }
        self.quiet_from = Some(from);
        Ok(self.bytes)
    }

    fn metadata(&mut self, bytes: &[u8]) -> bool {
        let Ok(Record::Metadata(found)) = parse_record(op::METADATA, &bytes[RECORD_HEADER..]) else {
            return false;
        };
        if ending::metadata(&found.name, &found.metadata) != bytes {
            return false;
        }
        match found.name.as_str() {
            wire::RUN_RECORD => match wire::run_of(&found.metadata) {
                Ok(run) => {
                    self.run.get_or_insert(run);
                    true
                }
                Err(_) => false,
            },
            wire::LOSS_RECORD => {
                let proven = matches!(wire::is_proven(&found.metadata), Ok(true));
                match wire::loss_of(&found.metadata) {
                    Ok(certificate) => {
                        self.certificate = Some(certificate).filter(|_| proven);
                        true
                    }
                    Err(_) => false,
                }
            }
            _ => true,
        }
    }
}

/// Opens a chunk (the whole record, with its header) if it is one of ours and proves itself, all its records included.
pub(crate) fn open_chunk(chunk: &mut Chunk, record: &[u8]) -> Option<()> {
    // A chunk without a checksum is not ours: nothing would prove its content.
    let content = record.get(RECORD_HEADER..)?;
    let Ok(Record::Chunk { header, data }) = parse_record(op::CHUNK, content) else { return None };
    let whole = CHUNK_HEADER - 4 + header.compression.len() as u64 + header.compressed_size;
    if header.uncompressed_crc == 0
        || header.compression != "zstd"
        || whole != content.len() as u64
        || data.len() as u64 != header.compressed_size
    {
        return None;
    }
    chunk.open(content).ok()?;
    // The checksum covers all records of the chunk; should one not parse in spite of it, the chunk is not one of ours.
    while let Some(record) = chunk.next_record().ok()? {
        match record {
            Inner::Message { .. } => {}
            Inner::Other(opcode @ (op::SCHEMA | op::CHANNEL), data) => drop(parse_record(opcode, data).ok()?),
            Inner::Other(..) => return None,
        }
    }
    chunk.rewind();
    Some(())
}

/// Two texts and nothing else: a length that was damaged must not hide what stands behind.
fn is_header(content: &[u8]) -> bool {
    let Ok(Record::Header(header)) = parse_record(op::HEADER, content) else { return false };
    content.len() == 8 + header.profile.len() + header.library.len()
}

/// Bytes of the file.
pub(crate) fn read(file: &File, range: Range<u64>) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; usize::try_from(range.end - range.start).map_err(io::Error::other)?];
    file.read_exact_at(&mut bytes, range.start)?;
    Ok(bytes)
}

/// The place of the first sign of a chunk or of one of our metadata records.
fn sign(window: &[u8], places: usize) -> Option<usize> {
    (0..places).find(|&place| {
        let starts =
            |offset: usize, with: &[u8]| window.get(place + offset..).is_some_and(|rest| rest.starts_with(with));
        match window[place] {
            // Two lengths that agree, and the name of the packing between them.
            op::CHUNK if starts(37, b"\x04\0\0\0zstd") => {
                let number = |offset: usize| {
                    let bytes = window.get(place + offset..place + offset + 8)?;
                    Some(u64::from_le_bytes(bytes.try_into().expect("eight bytes were taken")))
                };
                number(45).and_then(|packed| packed.checked_add(CHUNK_HEADER)) == number(1)
            }
            op::METADATA => starts(9, b"\x0d\0\0\0rec_bench.run") || starts(9, b"\x0e\0\0\0rec_bench.loss"),
            _ => false,
        }
    })
}
