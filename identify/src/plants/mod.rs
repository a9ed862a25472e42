//! The plants that the engine knows, one file each. Adding one = one file + one line in [`PLANTS`] (docs/PLANTS.md).

use recordings::Role;

use crate::plant::Plant;
use crate::prepare::Stretch;

pub mod analysis;
mod classes;
mod emps;
pub mod rec;
pub mod report;
mod silverbox;
mod table;

pub use emps::{EMPS, Emps};
pub use silverbox::{SILVERBOX, Silverbox};
pub use table::{DataError, Table};

/// Every plant whose recordings are tables of their own. The REC rig has campaigns instead.
pub static PLANTS: &[&dyn TablePlant] = &[&SILVERBOX, &EMPS];

/// The plant with this id.
pub fn find(id: &str) -> Option<&'static dyn TablePlant> {
    PLANTS.iter().copied().find(|p| p.header().id == id)
}

/// Which file a table is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The one with the data that are fitted.
    Data,
    /// One of its own that is never fitted.
    Validation,
}

/// A part of a recording.
#[derive(Clone, Debug)]
pub struct Section {
    /// Name in reports.
    pub name: &'static str,
    /// Whether it is fitted or predicted; the latter in free run, never fitted.
    pub role: Role,
    /// Its stretches.
    pub stretches: Vec<Stretch>,
}

/// A plant whose recordings are tables.
pub trait TablePlant: Plant {
    /// How well the plant is known to be measured: share of a channel's RMS below which a misfit counts as noise, because
    /// sampling, measured inputs and so simple a model leave as much at best. The noise that the channel shows is added.
    fn resolution(&self) -> f64;

    /// Cuts a table into sections. [`Section::role`] says which are fitted; a plant whose benchmark splits one file returns both
    /// kinds of [`Source::Data`].
    ///
    /// # Errors
    /// Columns or rows are missing, or the plant has no file of this kind.
    fn sections(&self, table: &Table, source: Source) -> Result<Vec<Section>, DataError>;
}
