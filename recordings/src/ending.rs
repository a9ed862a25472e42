//! The shortest end that closes a recording: for a file whose system refuses to write on, where the library that writes
//! the records can't go back. No index, a few hundred bytes.

use std::collections::BTreeMap;

use mcap::records::op;

/// An event's message, by the number of its channel.
pub(crate) struct LooseMessage<'a> {
    pub channel: u16,
    pub sequence: u32,
    pub time_ns: u64,
    pub data: &'a [u8],
}

/// A message outside of chunks. Its channel must stand before it in the file.
pub(crate) fn message(message: &LooseMessage<'_>) -> Vec<u8> {
    let mut body = Vec::with_capacity(22 + message.data.len());
    body.extend(message.channel.to_le_bytes());
    body.extend(message.sequence.to_le_bytes());
    body.extend(message.time_ns.to_le_bytes());
    body.extend(message.time_ns.to_le_bytes());
    body.extend(message.data);
    record(op::MESSAGE, &body)
}

/// A metadata record.
pub(crate) fn metadata(name: &str, fields: &BTreeMap<String, String>) -> Vec<u8> {
    let mut map = Vec::new();
    for (key, value) in fields {
        string(&mut map, key);
        string(&mut map, value);
    }
    let mut body = Vec::new();
    string(&mut body, name);
    body.extend((map.len() as u32).to_le_bytes());
    body.extend(map);
    record(op::METADATA, &body)
}

/// End of the data, a footer that knows of no summary, the magic. `data_crc`: of every byte before.
pub(crate) fn end(data_crc: u32) -> Vec<u8> {
    let mut bytes = record(op::DATA_END, &data_crc.to_le_bytes());
    bytes.extend(record(op::FOOTER, &[0; 20]));
    bytes.extend(mcap::MAGIC);
    bytes
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(9 + body.len());
    bytes.push(opcode);
    bytes.extend((body.len() as u64).to_le_bytes());
    bytes.extend(body);
    bytes
}

fn string(bytes: &mut Vec<u8>, text: &str) {
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(text.as_bytes());
}
