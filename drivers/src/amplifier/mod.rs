//! What pump amplifiers speak: one protocol a file, no I/O.
