//! Samples as bytes that a program carries to another machine: messages of the recording's own schema (`rec_bench.v1.RigSample`), each
//! with its length before it as protobuf writes one. A program of another build reads what it knows of them.

use prost::{decode_length_delimiter, encode_length_delimiter};
use rt_core::Sample;

use crate::wire::{decode_sample, encode_sample};

/// Bytes that are no samples.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "byte {at}: expected samples as rec_bench.v1.RigSample, each with its length before it, got {got}; programs at both ends must be of one build"
)]
pub struct CarriedError {
    /// Where the message begins that is none.
    pub at: usize,
    /// What is wrong with it.
    pub got: String,
}

/// Appends a sample.
pub fn carry(sample: &Sample, bytes: &mut Vec<u8>) {
    let mut message = Vec::new();
    encode_sample(sample, &mut message);
    encode_length_delimiter(message.len(), bytes).expect("a Vec grows as far as a length needs");
    bytes.extend_from_slice(&message);
}

/// The samples of these bytes, in their order.
///
/// # Errors
/// See [`CarriedError`].
pub fn carried(bytes: &[u8]) -> Result<Vec<Sample>, CarriedError> {
    let mut samples = Vec::new();
    let mut rest = bytes;
    while !rest.is_empty() {
        let at = bytes.len() - rest.len();
        let wrong = |got: String| CarriedError { at, got };
        let length = decode_length_delimiter(&mut rest).map_err(|e| wrong(e.to_string()))?;
        let message = rest.get(..length).ok_or_else(|| wrong(format!("{} of {length} bytes", rest.len())))?;
        samples.push(decode_sample(message).map_err(wrong)?);
        rest = &rest[length..];
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_arrive_as_they_were_sent() {
        let sample = |tick: u64| Sample {
            tick,
            scheduled_ns: tick * rt_core::PERIOD_NS,
            angle_deg: -30.25,
            voltage_v: 0.1 + 0.2,
            age_ns: [1, 2, 3, 4, u32::MAX],
            flags: rt_core::flags::TRIPPED,
            ..Sample::BLANK
        };
        let mut bytes = Vec::new();
        (0..7).for_each(|tick| carry(&sample(tick), &mut bytes));
        let arrived = carried(&bytes).expect("as written");
        // NaN is not equal to itself: the text tells.
        assert_eq!(format!("{arrived:?}"), format!("{:?}", (0..7).map(sample).collect::<Vec<_>>()));
        assert_eq!(carried(&[]), Ok(Vec::new()));
    }

    #[test]
    fn bytes_that_are_cut_or_foreign_are_refused_with_the_place() {
        let mut bytes = Vec::new();
        carry(&Sample::BLANK, &mut bytes);
        let whole = bytes.len();
        carry(&Sample::BLANK, &mut bytes);
        for end in whole + 1..bytes.len() {
            let error = carried(&bytes[..end]).expect_err("cut");
            assert_eq!(error.at, whole, "{error}");
        }
        assert!(carried(b"hello, this is no sample").is_err());
    }

    #[test]
    fn a_sample_with_numbers_that_no_run_comes_to_is_refused() {
        for (sample, field) in [
            (Sample { tick: u64::MAX, ..Sample::BLANK }, "tick"),
            (Sample { scheduled_ns: u64::MAX, ..Sample::BLANK }, "scheduled_ns"),
        ] {
            let mut bytes = Vec::new();
            carry(&sample, &mut bytes);
            let error = carried(&bytes).expect_err("beyond");
            assert!(error.got.contains(field) && error.got.contains(&u64::MAX.to_string()), "{error}");
        }
    }
}
