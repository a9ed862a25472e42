//! What a configuration asks of its wires: bytes on the serial port and bits on the bus, against what these carry.
