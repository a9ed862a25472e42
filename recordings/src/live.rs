//! The channel of the samples for programs that show them as they come: topic, schema and messages are those of a recording, so that a
//! picture that was arranged for one serves the other.

use rt_core::Sample;

use crate::wire;

/// Topic of the samples.
pub const TOPIC: &str = wire::SAMPLE_TOPIC;
/// Name of the message in the schema.
pub const SCHEMA_NAME: &str = wire::SAMPLE_SCHEMA;
/// Encoding of messages and schema.
pub const ENCODING: &str = wire::ENCODING;
/// The schema: a protobuf descriptor set.
pub const SCHEMA: &[u8] = wire::SCHEMA;

/// Replaces `bytes` by the message of this sample.
pub fn encode(sample: &Sample, bytes: &mut Vec<u8>) {
    wire::encode_sample(sample, bytes);
}
