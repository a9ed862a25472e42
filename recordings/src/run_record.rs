//! The record `rec_bench.run` on its own, for a logger in another process: what a run is, as bytes.

use std::collections::BTreeMap;

use mcap::records::Record;

use crate::run_metadata::RunMetadata;
use crate::{ending, wire};

/// Bytes of a record before its content: the opcode and the length.
const HEAD: usize = 9;

impl RunMetadata {
    /// The MCAP record `rec_bench.run` that a recording of this run has, opcode and length included.
    pub fn to_record(&self) -> Vec<u8> {
        ending::metadata(wire::RUN_RECORD, &wire::run_fields(self))
    }

    /// The run of such a record.
    ///
    /// # Errors
    /// What was expected and what came: it is another record, or its checksum does not prove it.
    pub fn from_record(bytes: &[u8]) -> Result<RunMetadata, String> {
        let refused = |got: String| format!("expected the record {:?}, got {got}", wire::RUN_RECORD);
        let (head, body) = bytes.split_at_checked(HEAD).ok_or_else(|| refused(format!("{} bytes", bytes.len())))?;
        match mcap::parse_record(head[0], body) {
            Ok(Record::Metadata(record)) if record.name == wire::RUN_RECORD => {
                let fields: &BTreeMap<String, String> = &record.metadata;
                wire::run_of(fields).map_err(|bad| format!("{}: expected {}, got {}", bad.key, bad.expected, bad.got))
            }
            Ok(_) => Err(refused("another one".to_owned())),
            Err(error) => Err(refused(format!("\"{error}\""))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Plane, Protocol, Role};

    fn run() -> RunMetadata {
        RunMetadata {
            profile: "name = \"ä\"\n".to_owned(),
            files: [("rig.toml".to_owned(), "[rig]\n".repeat(50_000)), ("rig.dbc".to_owned(), String::new())].into(),
            calibration: "gain = 2\n".to_owned(),
            host: [("hostname".to_owned(), "rig-1".to_owned())].into(),
            program: "rec-bench".to_owned(),
            notes: [("setup".to_owned(), "seed = \"1\"".to_owned())].into(),
            ..RunMetadata::new("a", Protocol::ConstantFlow, Role::Identify, Plane::Vertical)
        }
    }

    #[test]
    fn a_run_s_record_is_read_back() {
        assert_eq!(RunMetadata::from_record(&run().to_record()), Ok(run()));
    }

    #[test]
    fn what_was_cut_or_changed_is_refused() {
        let bytes = RunMetadata { files: BTreeMap::new(), ..run() }.to_record();
        for length in 0..bytes.len() {
            assert!(RunMetadata::from_record(&bytes[..length]).is_err(), "cut to {length}");
        }
        let words = b"rig-1";
        let at = bytes.windows(words.len()).position(|window| window == words).expect("it is in there");
        let mut changed = bytes.clone();
        changed[at] = b'p';
        assert!(RunMetadata::from_record(&changed).is_err());
    }
}
