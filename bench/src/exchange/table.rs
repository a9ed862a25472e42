//! What every exported file holds: columns with names and units, in blocks of rows.

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Floating-point number of 64 bits; NaN = missing.
    Number,
    /// Whole number, never negative.
    Natural,
    /// Whole number.
    Integer,
    /// Yes or no.
    Flag,
    /// Text in UTF-8.
    Text,
}

/// A column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name, with the unit in it where it has one.
    pub name: &'static str,
    /// Unit as it is written in figures; empty: none.
    pub unit: &'static str,
    /// One sentence without a full stop.
    pub about: &'static str,
    /// What it holds.
    pub kind: Kind,
}

/// Values of one column.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Of [`Kind::Number`].
    Number(Vec<f64>),
    /// Of [`Kind::Natural`].
    Natural(Vec<u64>),
    /// Of [`Kind::Integer`].
    Integer(Vec<i64>),
    /// Of [`Kind::Flag`].
    Flag(Vec<bool>),
    /// Of [`Kind::Text`].
    Text(Vec<String>),
}

/// One value.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// See [`Kind::Number`].
    Number(f64),
    /// See [`Kind::Natural`].
    Natural(u64),
    /// See [`Kind::Integer`].
    Integer(i64),
    /// See [`Kind::Flag`].
    Flag(bool),
    /// See [`Kind::Text`].
    Text(String),
}

impl Values {
    /// An empty column of this kind.
    pub fn empty(kind: Kind) -> Values {
        match kind {
            Kind::Number => Values::Number(Vec::new()),
            Kind::Natural => Values::Natural(Vec::new()),
            Kind::Integer => Values::Integer(Vec::new()),
            Kind::Flag => Values::Flag(Vec::new()),
            Kind::Text => Values::Text(Vec::new()),
        }
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Values::Number(values) => values.len(),
            Values::Natural(values) => values.len(),
            Values::Integer(values) => values.len(),
            Values::Flag(values) => values.len(),
            Values::Text(values) => values.len(),
        }
    }

    /// No values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Appends a value of the column's kind.
    ///
    /// # Panics
    /// The value is of another kind: a defect of whoever described the column.
    pub fn push(&mut self, cell: Cell) {
        match (self, cell) {
            (Values::Number(values), Cell::Number(value)) => values.push(value),
            (Values::Natural(values), Cell::Natural(value)) => values.push(value),
            (Values::Integer(values), Cell::Integer(value)) => values.push(value),
            (Values::Flag(values), Cell::Flag(value)) => values.push(value),
            (Values::Text(values), Cell::Text(value)) => values.push(value),
            (values, cell) => panic!("{cell:?} does not belong among {values:?}"),
        }
    }

    /// Moves the values of `other`, which is of the same kind, behind these.
    ///
    /// # Panics
    /// It is of another kind: a defect of whoever described the column.
    pub fn append(&mut self, other: Values) {
        match (self, other) {
            (Values::Number(values), Values::Number(mut more)) => values.append(&mut more),
            (Values::Natural(values), Values::Natural(mut more)) => values.append(&mut more),
            (Values::Integer(values), Values::Integer(mut more)) => values.append(&mut more),
            (Values::Flag(values), Values::Flag(mut more)) => values.append(&mut more),
            (Values::Text(values), Values::Text(mut more)) => values.append(&mut more),
            (values, other) => panic!("{other:?} does not belong behind {values:?}"),
        }
    }
}

/// Some rows: the values of each column, as many each.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// In the order of the columns.
    pub values: Vec<Values>,
}

impl Block {
    /// No rows of these columns.
    pub fn empty(columns: &[Column]) -> Block {
        Block { values: columns.iter().map(|column| Values::empty(column.kind)).collect() }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.values.first().map_or(0, Values::len)
    }

    /// Moves the rows of `other` behind these.
    pub fn append(&mut self, other: Block) {
        for (values, more) in self.values.iter_mut().zip(other.values) {
            values.append(more);
        }
    }
}
