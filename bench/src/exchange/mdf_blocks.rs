//! The blocks of an ASAM MDF 4.1 file, as bytes. Each block: `##` and two letters, four zero bytes, its length, the number of its
//! links, the links (addresses in the file, 0 = none), its data. Little endian; every block begins at a multiple of 8.

/// Where the header block stands: after the identification.
pub const HEADER_AT: u64 = 64;
/// Of a block without links and data.
pub const EMPTY: u64 = 24;

/// The first 64 bytes of a file: a finished one of version 4.10.
pub fn identification() -> Vec<u8> {
    let mut bytes = Vec::with_capacity(64);
    bytes.extend_from_slice(b"MDF     4.10    recbench");
    bytes.extend([0; 4]);
    bytes.extend(410u16.to_le_bytes());
    bytes.extend([0; 34]);
    bytes
}

/// A block of its links and its data.
pub fn block(kind: &[u8; 2], links: &[u64], data: &[u8]) -> Vec<u8> {
    let length = EMPTY + 8 * links.len() as u64 + data.len() as u64;
    let mut bytes = head(kind, length, links.len() as u64);
    links.iter().for_each(|link| bytes.extend(link.to_le_bytes()));
    bytes.extend_from_slice(data);
    bytes
}

/// What stands before a block's links.
fn head(kind: &[u8; 2], length: u64, links: u64) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0).min(1 << 20));
    bytes.extend_from_slice(b"##");
    bytes.extend_from_slice(kind);
    bytes.extend([0; 4]);
    bytes.extend(length.to_le_bytes());
    bytes.extend(links.to_le_bytes());
    bytes
}

/// Plain text (`TX`) or XML (`MD`), ended by a zero byte.
pub fn text(kind: &[u8; 2], content: &str) -> Vec<u8> {
    // A zero byte would end the text.
    let mut data = content.replace('\0', "").into_bytes();
    data.push(0);
    block(kind, &[], &data)
}

/// Header of the file. No start time is known: a recording does not depend on the clock.
pub fn header(first_group: u64, history: u64, comment: u64) -> Vec<u8> {
    // Start time, its zone and quality, start angle and distance: none.
    block(b"HD", &[first_group, history, 0, 0, 0, comment], &[0; 32])
}

/// Entry of the file's history, which every file has.
pub fn history(comment: u64) -> Vec<u8> {
    block(b"FH", &[0, comment], &[0; 16])
}

/// A data group of one channel group.
pub fn data_group(next: u64, channel_group: u64, data: u64) -> Vec<u8> {
    // No record numbers: the records are those of one channel group.
    block(b"DG", &[next, channel_group, data, 0], &[0; 8])
}

/// A channel group.
pub fn channel_group(first_channel: u64, name: u64, comment: u64, records: u64, record_bytes: u32) -> Vec<u8> {
    let mut data = Vec::with_capacity(32);
    data.extend(0u64.to_le_bytes());
    data.extend(records.to_le_bytes());
    data.extend([0; 8]);
    data.extend(record_bytes.to_le_bytes());
    data.extend([0; 4]);
    block(b"CG", &[0, first_channel, name, 0, 0, comment], &data)
}

/// How a channel's values stand in a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// 0 = a value; 1 = the place of a text in the signal data; 2 = the time.
    pub channel: u8,
    /// 0 = unsigned, 2 = signed, 4 = floating point, 7 = text in UTF-8.
    pub data: u8,
    /// Bytes in the record.
    pub bytes: u32,
}

/// A channel. `signal_data`: where its texts stand.
pub fn channel(next: u64, slot: Slot, offset: u32, signal_data: u64, [name, unit, comment]: [u64; 3]) -> Vec<u8> {
    const SYNC_TIME: u8 = 1;
    let sync = if slot.channel == 2 { SYNC_TIME } else { 0 };
    let mut data = vec![slot.channel, sync, slot.data, 0];
    data.extend(offset.to_le_bytes());
    data.extend((8 * slot.bytes).to_le_bytes());
    // Flags, invalidation bit, precision, attachments: none. Then ranges that no flag declares.
    data.extend([0; 12]);
    data.extend([0; 48]);
    block(b"CN", &[next, 0, name, 0, 0, signal_data, unit, comment], &data)
}

/// What stands before the bytes of a piece of data (`DT`) or of texts (`SD`).
pub fn piece_head(kind: &[u8; 2], content: u64) -> Vec<u8> {
    head(kind, EMPTY + content, 0)
}

/// The list of pieces: where each one stands, and how many bytes of content precede it.
pub fn list(pieces: &[(u64, u64)]) -> Vec<u8> {
    let links: Vec<u64> = [0].into_iter().chain(pieces.iter().map(|(address, _)| *address)).collect();
    let mut data = vec![0; 4];
    data.extend((pieces.len() as u32).to_le_bytes());
    pieces.iter().for_each(|(_, before)| data.extend(before.to_le_bytes()));
    block(b"DL", &links, &data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_the_standard_s_lengths() {
        let lengths = [
            (identification().len(), 64),
            (header(0, 0, 0).len(), 104),
            (history(0).len(), 56),
            (data_group(0, 0, 0).len(), 64),
            (channel_group(0, 0, 0, 0, 0).len(), 104),
            (channel(0, Slot { channel: 0, data: 4, bytes: 8 }, 0, 0, [0; 3]).len(), 160),
        ];
        for (length, standard) in lengths {
            assert_eq!(length, standard);
        }
        assert_eq!(&list(&[(4096, 0), (8192, 4000)])[16..24], &3u64.to_le_bytes(), "a list has a link to the next one");
    }
}
