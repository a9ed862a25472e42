//! The plants that the engine knows, one file each. Adding one = one file + one line in [`PLANTS`].

pub mod rec;
