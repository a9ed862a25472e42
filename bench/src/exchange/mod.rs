//! Recordings to other tools' formats and back.
