//! Figures and tables as plain data: what is to be shown, without how it is drawn.

use serde::Serialize;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mark {
    /// Measured data.
    Points,
    /// Model.
    Line,
    /// A second model (before an effect was added, say).
    Dashed,
}

/// One curve or cloud. `x` and `y` have the same length; `NaN` in `y` breaks the line.
#[derive(Clone, Debug, Serialize)]
pub struct Series {
    /// Legend entry.
    pub name: String,
    /// How it is drawn.
    pub mark: Mark,
    /// Series that belong together (data and model of one pressure, say) carry the same group and get one colour.
    pub group: usize,
    /// Abscissa, in the unit of the figure's `x_label`.
    pub x: Vec<f64>,
    /// Ordinate, in the unit of the figure's `y_label`.
    pub y: Vec<f64>,
}

/// One figure of the report.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Anchor in the page, unique: `pump_map`.
    pub id: String,
    /// Section of the report: figures of one section stand together, in order of first appearance.
    pub section: String,
    /// What it shows.
    pub title: String,
    /// How to read it; names the paper's figure it is the counterpart of.
    pub caption: String,
    /// With unit.
    pub x_label: String,
    /// With unit.
    pub y_label: String,
    /// The curves.
    pub series: Vec<Series>,
}

/// One table of the report. Each row has as many cells as there are columns.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Section of the report.
    pub section: String,
    /// What it shows.
    pub title: String,
    /// How to read it.
    pub caption: String,
    /// Heads of the columns, with units.
    pub columns: Vec<String>,
    /// Cells, formatted.
    pub rows: Vec<Vec<String>>,
}
