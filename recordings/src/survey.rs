//! What a damaged recording still holds: every record that proves itself, wherever it stands.
//!
//! The file is walked record by record. Where no sound record stands, damage begins, and it lasts to the next chunk or
//! metadata record that can be proven: a chunk by its checksum, our metadata by theirs.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::os::unix::fs::FileExt;

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, parse_record};
use rt_core::LossCertificate;

use crate::run_metadata::RunMetadata;
use crate::{ending, wire};

/// No record or chunk of ours comes near this; a damaged length must not ask for more memory.
const LONGEST: u64 = 64 * 1024 * 1024;
/// Opcode and length before each record.
const RECORD_HEADER: u64 = 9;
/// Fields of a chunk before its packed bytes, packed by zstd.
const CHUNK_HEADER: u64 = 44;
/// Bytes that are looked through at a time, and by how much two looks overlap.
const WINDOW: usize = 1024 * 1024;
const OVERLAP: usize = 64;

/// The records of a file that prove themselves.
#[derive(Debug, Default)]
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
        if left < RECORD_HEADER {
            return Ok(None);
        }
        let header = read(file, at..at + RECORD_HEADER)?;
        let length = u64::from_le_bytes(header[1..].try_into().expect("nine bytes were read"));
        if length > LONGEST.min(left - RECORD_HEADER) {
            return Ok(None);
        }
        let end = at + RECORD_HEADER + length;
        let opcode = header[0];
        let sound = match opcode {
            op::CHUNK => {
                let sound = chunk_records(&read(file, at..end)?, |_| ()).is_some();
                if sound {
                    self.chunks.push(at..end);
                }
                sound
            }
            op::METADATA => self.metadata(&read(file, at..end)?),
            // A list of pairs whose own length must fit.
            op::MESSAGE_INDEX if length >= 6 => {
                let fields = read(file, at + RECORD_HEADER..at + RECORD_HEADER + 6)?;
                let list = u32::from_le_bytes([fields[2], fields[3], fields[4], fields[5]]);
                u64::from(list) == length - 6 && list.is_multiple_of(16)
            }
            op::HEADER => at == MAGIC.len() as u64 && length < 4096,
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
        let Ok(Record::Metadata(found)) = parse_record(op::METADATA, &bytes[RECORD_HEADER as usize..]) else {
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

/// Hands the records of a chunk (the whole record, with its header) to `take`, once its checksum is proven. `None`: it
/// is not sound; `take` has not been called then.
pub(crate) fn chunk_records(chunk: &[u8], mut take: impl FnMut(Record<'_>)) -> Option<()> {
    // A chunk without a checksum is not ours: nothing would prove its content.
    let Ok(Record::Chunk { header, data }) = parse_record(op::CHUNK, chunk.get(RECORD_HEADER as usize..)?) else {
        return None;
    };
    let whole = CHUNK_HEADER - 4 + header.compression.len() as u64 + header.compressed_size;
    if header.uncompressed_crc == 0
        || header.compression != "zstd"
        || whole != chunk.len() as u64 - RECORD_HEADER
        || data.len() as u64 != header.compressed_size
    {
        return None;
    }
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(LONGEST as usize);
    let mut reader = LinearReader::new_with_options(options);
    let mut given = 0;
    // The checksum covers all records of the chunk; should one not parse in spite of it, the chunk is not one of ours.
    let mut sound = true;
    loop {
        match reader.next_event() {
            None => return sound.then_some(()),
            Some(Err(_)) => return None,
            Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                let bytes = &chunk[given..chunk.len().min(given + wanted)];
                reader.insert(bytes.len())[..bytes.len()].copy_from_slice(bytes);
                reader.notify_read(bytes.len());
                given += bytes.len();
            }
            Some(Ok(LinearReadEvent::Record { opcode: opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE), data })) => {
                match parse_record(opcode, data) {
                    Ok(record) => take(record),
                    Err(_) => sound = false,
                }
            }
            Some(Ok(LinearReadEvent::Record { .. })) => sound = false,
        }
    }
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
