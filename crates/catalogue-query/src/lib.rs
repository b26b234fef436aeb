//! Questions in SQL to a catalogue of frames ([`realitysim_catalogue`]), answered in this process.
//!
//! DataFusion plans and answers them; the catalogue is its table `frames`. Folders that cannot hold a row that is asked for, and row groups whose
//! statistics exclude it, are not read. This is a crate of its own, outside of the default build, because DataFusion takes longer to compile than all
//! the rest.
//!
//! ```rust
//! use realitysim_catalogue::{CatalogueRow, FileHead, parquet_of_rows};
//! use realitysim_catalogue_query::query;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let row = CatalogueRow { x_m: Some(1.25), valid: true, ..CatalogueRow::default() };
//! # let folder = tempfile::tempdir()?;
//! # let catalogue = folder.path();
//! let session = catalogue.join("field=kid-2020/date=2026-11-28/robot=r1");
//! std::fs::create_dir_all(&session)?;
//! std::fs::write(session.join("a.parquet"), parquet_of_rows(&FileHead::default(), &[row])?)?;
//! let answer = query(catalogue, "select robot, max(x_m) as furthest from frames group by robot")?;
//! assert_eq!(answer.json_lines()?, "{\"robot\":\"r1\",\"furthest\":1.25}\n");
//! # Ok(())
//! # }
//! ```

use std::path::{Path, PathBuf};
use std::sync::Arc;

use datafusion::arrow::array::RecordBatch;
use datafusion::arrow::datatypes::DataType;
use datafusion::arrow::error::ArrowError;
use datafusion::arrow::json::LineDelimitedWriter;
use datafusion::arrow::util::pretty::pretty_format_batches;
use datafusion::datasource::file_format::parquet::ParquetFormat;
use datafusion::datasource::listing::ListingOptions;
use datafusion::error::DataFusionError;
use datafusion::execution::context::SQLOptions;
use datafusion::execution::runtime_env::RuntimeEnvBuilder;
use datafusion::prelude::{SessionConfig, SessionContext};
use thiserror::Error;

use realitysim_catalogue::{CatalogueError, catalogue_files};

/// Name of the catalogue as a table.
pub const TABLE: &str = "frames";

/// Why a question has no answer.
#[derive(Debug, Error)]
pub enum QueryError {
    /// There is no catalogue.
    #[error(transparent)]
    Catalogue(#[from] CatalogueError),
    /// The text is no question that can be asked: a syntax error, a column that is not there, or a statement that changes something.
    #[error("{}: the table is {TABLE}, its columns stand in docs/reference/formats.md", first_line(.0))]
    Sql(DataFusionError),
    /// The catalogue cannot be read, or the answer takes more memory than there may be.
    #[error("{}: {}: `realitysim catalogue show` names files that are not whole", path.display(), first_line(source))]
    Execution {
        /// The catalogue's folder.
        path: PathBuf,
        /// What went wrong.
        source: DataFusionError,
    },
    /// The process may not have the threads that it needs.
    #[error("no thread to answer with: {0}")]
    Threads(std::io::Error),
}

/// The first line of an error; the others are a trace for the developers of the library.
fn first_line(error: &DataFusionError) -> String {
    error.strip_backtrace().lines().next().unwrap_or_default().to_owned()
}

/// The rows that answer a question.
#[derive(Debug)]
pub struct Answer {
    batches: Vec<RecordBatch>,
}

impl Answer {
    /// The rows as a table for people, with a line of names.
    ///
    /// # Errors
    ///
    /// Fails if a value has no text.
    pub fn table(&self) -> Result<String, ArrowError> {
        pretty_format_batches(&self.batches).map(|table| table.to_string())
    }

    /// The rows as JSON, an object on a line; what is null is left out.
    ///
    /// # Errors
    ///
    /// Fails if a column has a type that JSON has no form for.
    pub fn json_lines(&self) -> Result<String, ArrowError> {
        let mut writer = LineDelimitedWriter::new(Vec::new());
        writer.write_batches(&self.batches.iter().collect::<Vec<_>>())?;
        writer.finish()?;
        String::from_utf8(writer.into_inner()).map_err(|error| ArrowError::JsonError(error.to_string()))
    }
}

/// Answers a question to a catalogue. Only questions are answered: nothing is changed by any text.
///
/// # Errors
///
/// Fails if there is no catalogue, if `sql` is no question, or if a file of the catalogue cannot be read.
pub fn query(catalogue: &Path, sql: &str) -> Result<Answer, QueryError> {
    catalogue_files(catalogue)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(QueryError::Threads)?;
    let batches = runtime.block_on(answer(catalogue, sql))?;
    Ok(Answer { batches })
}

/// Most memory of an answer while it is made, bytes; sorting and grouping go on on the disk beyond.
const MAX_QUERY_BYTES: usize = 4 << 30;

async fn answer(catalogue: &Path, sql: &str) -> Result<Vec<RecordBatch>, QueryError> {
    let failed = |source| QueryError::Execution { path: catalogue.to_owned(), source };
    let runtime = RuntimeEnvBuilder::new().with_memory_limit(MAX_QUERY_BYTES, 1.0).build_arc().map_err(failed)?;
    let context = SessionContext::new_with_config_rt(SessionConfig::from_env().map_err(failed)?, runtime);
    register(&context, catalogue).await.map_err(failed)?;
    let only_questions = SQLOptions::new().with_allow_ddl(false).with_allow_dml(false).with_allow_statements(false);
    let frame = context.sql_with_options(sql, only_questions).await.map_err(QueryError::Sql)?;
    let schema = Arc::new(frame.schema().as_arrow().clone());
    let batches = frame.collect().await.map_err(failed)?;
    // An answer without rows has names all the same.
    Ok(if batches.is_empty() { vec![RecordBatch::new_empty(schema)] } else { batches })
}

/// Makes the catalogue a table, with the values in the names of its folders as columns. What is percent-encoded in them stays so.
async fn register(context: &SessionContext, catalogue: &Path) -> Result<(), DataFusionError> {
    let folders = [("field", DataType::Utf8), ("date", DataType::Date32), ("robot", DataType::Utf8)];
    let folders = folders.into_iter().map(|(name, kind)| (name.to_owned(), kind)).collect();
    let options = ListingOptions::new(Arc::new(ParquetFormat::default().with_enable_pruning(true)))
        .with_session_config_options(&context.copied_config())
        .with_table_partition_cols(folders);
    // The last slash says that it is a folder.
    let path = format!("{}/", std::path::absolute(catalogue)?.display());
    context.register_listing_table(TABLE, path, options, None, None).await
}

#[cfg(test)]
mod tests;
