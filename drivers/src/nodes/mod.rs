//! The emulated rig at the other end of both wires.
