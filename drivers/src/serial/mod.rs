//! The thread that owns the serial port of the pump amplifier.
