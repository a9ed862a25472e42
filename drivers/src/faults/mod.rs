//! Seeded fault injection around any device.
