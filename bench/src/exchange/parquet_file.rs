//! A table as Apache Parquet: one row group at a time, packed with snappy. Units and what is known of the run stand in the key-value
//! metadata of the file.

use super::content::Content;
use super::output::Output;
use super::source::Source;
use super::table::{self, Block, Column, Values};
use crate::failure::{Failure, Kind};
use parquet::basic::{Compression, LogicalType, Repetition, Type as Physical};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::ByteArray;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{Type, TypePtr};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rows of a row group: what memory holds at a time.
const GROUP_ROWS: usize = 1 << 16;

/// Writes one table of a run.
///
/// # Errors
/// The target exists, the run can't be read to its end, the system refuses (2). Nothing is left behind.
pub fn write(source: &Source, content: Content, target: &Path) -> Result<PathBuf, Failure> {
    let columns = content.columns();
    let refused = |e: ParquetError| {
        let message =
            format!("{}: expected to write it, got \"{e}\"; check the folder and the free space", target.display());
        Failure::new(Kind::Input, message)
    };
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_created_by("rec-bench".to_owned())
        .set_key_value_metadata(Some(metadata(source, content, &columns)))
        .build();
    let schema = schema(&columns).map_err(refused)?;
    let output = Output::create(target)?;
    let mut writer = SerializedFileWriter::new(output, schema, Arc::new(properties)).map_err(refused)?;
    let mut group = Block::empty(&columns);
    for block in source.blocks(content)? {
        group.append(block.map_err(|e| Failure::of(Kind::Input, &e))?);
        if group.rows() >= GROUP_ROWS {
            write_group(&mut writer, &group).map_err(refused)?;
            group = Block::empty(&columns);
        }
    }
    if group.rows() > 0 {
        write_group(&mut writer, &group).map_err(refused)?;
    }
    writer.into_inner().map_err(refused)?.commit()
}

fn schema(columns: &[Column]) -> Result<TypePtr, ParquetError> {
    let field = |column: &Column| -> Result<TypePtr, ParquetError> {
        let whole = |is_signed| Some(LogicalType::integer(64, is_signed));
        let (physical, logical) = match column.kind {
            table::Kind::Number => (Physical::DOUBLE, None),
            table::Kind::Natural => (Physical::INT64, whole(false)),
            table::Kind::Integer => (Physical::INT64, whole(true)),
            table::Kind::Flag => (Physical::BOOLEAN, None),
            table::Kind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        // Only a number can be missing.
        let repetition = if column.kind == table::Kind::Number { Repetition::OPTIONAL } else { Repetition::REQUIRED };
        let built = Type::primitive_type_builder(column.name, physical)
            .with_logical_type(logical)
            .with_repetition(repetition)
            .build()?;
        Ok(Arc::new(built))
    };
    let fields = columns.iter().map(field).collect::<Result<Vec<_>, _>>()?;
    Ok(Arc::new(Type::group_type_builder("rec_bench").with_fields(fields).build()?))
}

/// `unit.COLUMN`, `about.COLUMN`, `table`, and the run's words.
fn metadata(source: &Source, content: Content, columns: &[Column]) -> Vec<KeyValue> {
    let pair = |key: String, value: &str| KeyValue::new(key, value.to_owned());
    let mut pairs = vec![pair("table".to_owned(), content.name())];
    pairs.extend(source.facts().iter().map(|(key, value)| pair(key.clone(), value)));
    for column in columns {
        if !column.unit.is_empty() {
            pairs.push(pair(format!("unit.{}", column.name), column.unit));
        }
        pairs.push(pair(format!("about.{}", column.name), column.about));
    }
    pairs
}

fn write_group(writer: &mut SerializedFileWriter<Output>, group: &Block) -> Result<(), ParquetError> {
    let mut to = writer.next_row_group()?;
    for values in &group.values {
        let mut column = to.next_column()?.expect("the schema has a column for each of the table's");
        match (column.untyped(), values) {
            (ColumnWriter::DoubleColumnWriter(to), Values::Number(values)) => {
                let there: Vec<i16> = values.iter().map(|value| i16::from(!value.is_nan())).collect();
                let present: Vec<f64> = values.iter().copied().filter(|value| !value.is_nan()).collect();
                to.write_batch(&present, Some(&there), None)?;
            }
            (ColumnWriter::Int64ColumnWriter(to), Values::Natural(values)) => {
                // The format keeps the 64 bits; the column's logical type says that they have no sign.
                let bits: Vec<i64> = values.iter().map(|value| value.cast_signed()).collect();
                to.write_batch(&bits, None, None)?;
            }
            (ColumnWriter::Int64ColumnWriter(to), Values::Integer(values)) => {
                to.write_batch(values, None, None)?;
            }
            (ColumnWriter::BoolColumnWriter(to), Values::Flag(values)) => {
                to.write_batch(values, None, None)?;
            }
            (ColumnWriter::ByteArrayColumnWriter(to), Values::Text(values)) => {
                let bytes: Vec<ByteArray> = values.iter().map(|value| ByteArray::from(value.as_str())).collect();
                to.write_batch(&bytes, None, None)?;
            }
            _ => unreachable!("the schema is made from the same columns"),
        }
        column.close()?;
    }
    to.close().map(drop)
}
