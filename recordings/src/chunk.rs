//! A chunk of an MCAP file: proven by its checksum, then its records one by one, where they stand.

use mcap::McapError;
use mcap::records::{Record, op};

use crate::sample_message::SLACK;

/// No record or chunk of ours comes near this; a damaged length must not ask for more memory.
pub(crate) const LONGEST: usize = 64 * 1024 * 1024;

/// Bytes before each record: its opcode and its length.
pub(crate) const RECORD_HEADER: usize = 9;

/// Bytes of a message record before the message: channel, sequence number, log time, publish time.
const MESSAGE_HEADER: usize = 22;

/// The chunk that is being read. Its memory serves one chunk after the other.
#[derive(Default)]
pub(crate) struct Chunk {
    unpacker: Option<zstd::bulk::Decompressor<'static>>,
    /// Its records, and [`SLACK`] bytes at least.
    unpacked: Vec<u8>,
    /// Bytes of its records.
    length: usize,
    /// Where the next record stands.
    at: usize,
}

/// A record within a chunk.
pub(crate) enum Inner<'c> {
    /// A message; `length` bytes from the start of `window` on, which goes on behind it by [`SLACK`] bytes at least.
    Message { channel: u16, window: &'c [u8], length: usize },
    /// Another one: opcode and content.
    Other(u8, &'c [u8]),
}

impl<'c> Inner<'c> {
    /// The bytes of a message.
    pub fn message(window: &'c [u8], length: usize) -> &'c [u8] {
        window.get(..length).expect("the window holds the whole message")
    }
}

impl Chunk {
    /// Takes the next chunk, by the content of its record. Nothing of it is given before its checksum is proven.
    ///
    /// # Errors
    /// Lengths that do not fit, another packing, or a checksum that is not that of the records.
    pub fn open(&mut self, record: &[u8]) -> Result<(), McapError> {
        (self.length, self.at) = (0, 0);
        let Record::Chunk { header, data } = mcap::parse_record(op::CHUNK, record)? else {
            return Err(McapError::UnexpectedEoc);
        };
        let length = usize::try_from(header.uncompressed_size).ok().filter(|length| *length <= LONGEST);
        let length = length.ok_or(McapError::ChunkTooLarge(header.uncompressed_size))?;
        // What an earlier chunk left behind this one is never taken for a part of it.
        if self.unpacked.len() < length + SLACK {
            self.unpacked.resize(length + SLACK, 0);
        }
        let unpacked = &mut self.unpacked[..length];
        let bytes = match header.compression.as_str() {
            "zstd" => {
                let unpacker = match &mut self.unpacker {
                    Some(unpacker) => unpacker,
                    none => none.insert(zstd::bulk::Decompressor::new()?),
                };
                unpacker
                    .decompress_to_buffer(&data, unpacked)
                    .map_err(|error| McapError::DecompressionError(error.to_string()))?
            }
            "" if data.len() == length => {
                unpacked.copy_from_slice(&data);
                length
            }
            "" => data.len(),
            other => return Err(McapError::UnsupportedCompression(other.to_owned())),
        };
        if bytes != length {
            return Err(McapError::DecompressionError(format!("expected {length} bytes, got {bytes}")));
        }
        let (saved, calculated) = (header.uncompressed_crc, crc32fast::hash(unpacked));
        // Zero says that there is none; ours have one.
        if saved != 0 && saved != calculated {
            return Err(McapError::BadChunkCrc { saved, calculated });
        }
        self.length = length;
        Ok(())
    }

    /// Back to the first record.
    pub fn rewind(&mut self) {
        self.at = 0;
    }

    /// The next record; `None`: the chunk is at its end, or none was opened.
    ///
    /// # Errors
    /// A record that is longer than what is left of the chunk.
    #[inline]
    pub fn next_record(&mut self) -> Result<Option<Inner<'_>>, McapError> {
        if self.at == self.length {
            return Ok(None);
        }
        let records = &self.unpacked[..self.length];
        let rest = records.get(self.at..).unwrap_or_default();
        let Some((opcode, rest)) = rest.split_first() else { return Err(McapError::UnexpectedEoc) };
        let Some((length, rest)) = rest.split_first_chunk() else { return Err(McapError::UnexpectedEoc) };
        let length = u64::from_le_bytes(*length);
        if length > rest.len() as u64 {
            self.at = self.length;
            return Err(McapError::UnexpectedEoc);
        }
        let begin = self.at + RECORD_HEADER;
        let length = length as usize; // no more than what is in memory
        self.at = begin + length;
        if *opcode != op::MESSAGE {
            return Ok(Some(Inner::Other(*opcode, &records[begin..begin + length])));
        }
        if length < MESSAGE_HEADER {
            self.at = self.length;
            return Err(McapError::UnexpectedEoc);
        }
        let channel = u16::from_le_bytes([rest[0], rest[1]]);
        let window = &self.unpacked[begin + MESSAGE_HEADER..];
        Ok(Some(Inner::Message { channel, window, length: length - MESSAGE_HEADER }))
    }
}
