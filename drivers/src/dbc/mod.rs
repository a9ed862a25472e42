//! CAN databases (DBC) compiled to shifts and masks, no I/O.
