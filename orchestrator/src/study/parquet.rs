//! A study's table as a Parquet file, which keeps the types of its columns: read back from the CSV file, in groups of rows,
//! so that memory is bounded whatever the number of jobs.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result};
use parquet::basic::{LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;

/// Rows that are in memory at once.
const GROUP: usize = 1 << 16;
/// Columns of words, whatever their cells look like.
const WORDS: [&str; 5] = ["job", "gains", "resolved_gains", "digest", "state"];

/// What all cells of a column are, but for the empty ones, which are null.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// No cell has said anything yet.
    Open,
    Flag,
    Whole,
    Number,
    Word,
}

impl Kind {
    fn with(self, cell: &str) -> Self {
        let is = |kind| match kind {
            Self::Flag => cell.parse::<bool>().is_ok(),
            Self::Whole => cell.parse::<i64>().is_ok(),
            Self::Number => cell.parse::<f64>().is_ok(),
            Self::Word | Self::Open => true,
        };
        match self {
            _ if cell.is_empty() => self,
            Self::Open => [Self::Flag, Self::Whole, Self::Number, Self::Word]
                .into_iter()
                .find(|kind| is(*kind))
                .unwrap_or(Self::Word),
            Self::Whole if !is(Self::Whole) && is(Self::Number) => Self::Number,
            kind if is(kind) => kind,
            _ => Self::Word,
        }
    }

    fn column(self, name: &str) -> Result<Type> {
        let (physical, logical) = match self {
            Self::Flag => (Physical::BOOLEAN, None),
            Self::Whole => (Physical::INT64, None),
            Self::Number => (Physical::DOUBLE, None),
            Self::Word | Self::Open => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let column = Type::primitive_type_builder(name, physical)
            .with_repetition(Repetition::OPTIONAL)
            .with_logical_type(logical);
        Ok(column.build()?)
    }
}

/// Writes the table beside its CSV file, with the ending `.parquet`; returns where.
///
/// # Errors
/// If the one cannot be read, or the other not be written.
pub(crate) fn write(table: &Path) -> Result<PathBuf> {
    let path = table.with_extension("parquet");
    let part = table.with_extension("parquet.part");
    write_to(table, &part).with_context(|| format!("{} cannot be written", path.display()))?;
    fs::rename(&part, &path)?;
    Ok(path)
}

fn write_to(table: &Path, part: &Path) -> Result<()> {
    let mut reader = csv::Reader::from_path(table)?;
    let names: Vec<String> = reader.headers()?.iter().map(str::to_owned).collect();
    let first = |name: &String| match WORDS.contains(&name.as_str()) {
        true => Kind::Word,
        false => Kind::Open,
    };
    let mut kinds: Vec<Kind> = names.iter().map(first).collect();
    for row in reader.records() {
        for (kind, cell) in kinds.iter_mut().zip(row?.iter()) {
            *kind = kind.with(cell);
        }
    }
    let columns = names.iter().zip(&kinds).map(|(name, kind)| kind.column(name).map(Arc::new));
    let schema = Type::group_type_builder("study").with_fields(columns.collect::<Result<_>>()?);
    // The same bytes whichever build wrote them.
    let properties = WriterProperties::builder().set_created_by("pathtune".to_owned()).build();
    let file = File::create(part)?;
    let mut writer =
        SerializedFileWriter::new(file, Arc::new(schema.build()?), Arc::new(properties))?;
    let mut rows = csv::Reader::from_path(table)?.into_records();
    loop {
        let group = rows.by_ref().take(GROUP).collect::<Result<Vec<_>, _>>()?;
        if group.is_empty() {
            break;
        }
        let mut written = writer.next_row_group()?;
        for (index, kind) in kinds.iter().enumerate() {
            let cells: Vec<&str> = group.iter().map(|row| row.get(index).unwrap_or("")).collect();
            write_column(&mut written, *kind, &cells)?;
        }
        written.close()?;
    }
    writer.close()?;
    Ok(())
}

fn write_column(
    group: &mut SerializedRowGroupWriter<'_, File>,
    kind: Kind,
    cells: &[&str],
) -> Result<()> {
    let levels: Vec<i16> = cells.iter().map(|cell| i16::from(!cell.is_empty())).collect();
    let full = cells.iter().copied().filter(|cell| !cell.is_empty());
    let mut column = group.next_column()?.context("a column more than the table has")?;
    match kind {
        Kind::Flag => {
            let values = full.map(str::parse).collect::<Result<Vec<bool>, _>>()?;
            column.typed::<BoolType>().write_batch(&values, Some(&levels), None)?;
        }
        Kind::Whole => {
            let values = full.map(str::parse).collect::<Result<Vec<i64>, _>>()?;
            column.typed::<Int64Type>().write_batch(&values, Some(&levels), None)?;
        }
        Kind::Number => {
            let values = full.map(str::parse).collect::<Result<Vec<f64>, _>>()?;
            column.typed::<DoubleType>().write_batch(&values, Some(&levels), None)?;
        }
        Kind::Word | Kind::Open => {
            let values: Vec<ByteArray> = full.map(ByteArray::from).collect();
            column.typed::<ByteArrayType>().write_batch(&values, Some(&levels), None)?;
        }
    }
    column.close()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::file::reader::{FileReader, SerializedFileReader};

    #[test]
    fn a_column_is_what_all_its_cells_are() {
        let kind = |cells: &[&str]| cells.iter().fold(Kind::Open, |kind, cell| kind.with(cell));
        assert_eq!(kind(&["", "true", "false"]), Kind::Flag);
        assert_eq!(kind(&["1", "", "-3"]), Kind::Whole);
        assert_eq!(kind(&["1", "2.5", "3"]), Kind::Number);
        assert_eq!(kind(&["1", "true"]), Kind::Word);
        assert_eq!(kind(&["true", "2"]), Kind::Word);
        assert_eq!(kind(&["", ""]), Kind::Open);
    }

    #[test]
    fn the_table_comes_back_with_its_types_and_gaps() {
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("study.csv");
        let text = "index,job,seed,value,arrived\n0,12,1,0.25,true\n1,34,2,,\n2,56,3,1,false\n";
        fs::write(&table, text).unwrap();
        let path = write(&table).unwrap();
        let first = fs::read(&path).unwrap();
        write(&table).unwrap();
        assert_eq!(fs::read(&path).unwrap(), first, "the same table, the same bytes");
        let reader = SerializedFileReader::new(File::open(&path).unwrap()).unwrap();
        let rows = reader.get_row_iter(None).unwrap().map(|row| row.unwrap().to_string());
        assert_eq!(
            rows.collect::<Vec<_>>(),
            [
                "{index: 0, job: \"12\", seed: 1, value: 0.25, arrived: true}",
                "{index: 1, job: \"34\", seed: 2, value: null, arrived: null}",
                "{index: 2, job: \"56\", seed: 3, value: 1.0, arrived: false}",
            ]
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
