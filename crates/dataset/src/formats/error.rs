//! What can be wrong with a dataset file.

use std::{
    fmt::Display,
    path::{Path, PathBuf},
};

use unopose_core::{files::FileError, geometry::IntrinsicsError};

/// Error of the `formats` room. Every message names the file, and the field where there is one.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    #[error(transparent)]
    Write(#[from] FileError),
    #[error("{path}: {source}")]
    Io { path: PathBuf, source: std::io::Error },
    #[error("{path}: not a readable image: {source}")]
    Image { path: PathBuf, source: image::ImageError },
    #[error("{path}: {source}")]
    Json { path: PathBuf, source: serde_json::Error },
    #[error("{path}: {source}")]
    Csv { path: PathBuf, source: csv::Error },
    #[error("{place}: {source}")]
    Intrinsics { place: String, source: IntrinsicsError },
    /// A value that parses but cannot be right. `place` is the file, then the entry inside it.
    #[error("{place}: {field} is {value}, expected {expected}")]
    Field { place: String, field: String, value: String, expected: String },
    /// Something that has to be there is not.
    #[error("{place}: {missing} not found{hint}")]
    Missing { place: String, missing: String, hint: String },
}

impl FormatError {
    /// A value met in `place` that is not what was expected.
    pub fn field(
        place: impl Display,
        field: impl Display,
        value: impl Display,
        expected: impl Display,
    ) -> Self {
        Self::Field {
            place: place.to_string(),
            field: field.to_string(),
            value: value.to_string(),
            expected: expected.to_string(),
        }
    }

    /// Something absent from `place`; `hint` (may be empty) says what is there instead.
    pub fn missing(place: impl Display, missing: impl Display, hint: impl Display) -> Self {
        let hint = hint.to_string();
        let hint = if hint.is_empty() { hint } else { format!(" ({hint})") };
        Self::Missing { place: place.to_string(), missing: missing.to_string(), hint }
    }

    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }

    /// The same error with `outer` (a file, an entry) put before its place.
    pub fn within(self, outer: impl Display) -> Self {
        let join = |inner: &dyn Display| format!("{outer}: {inner}");
        match self {
            Self::Write(FileError { path, source }) => {
                Self::Write(FileError { path: join(&path.display()).into(), source })
            }
            Self::Io { path, source } => Self::Io { path: join(&path.display()).into(), source },
            Self::Image { path, source } => Self::Image { path: join(&path.display()).into(), source },
            Self::Json { path, source } => Self::Json { path: join(&path.display()).into(), source },
            Self::Csv { path, source } => Self::Csv { path: join(&path.display()).into(), source },
            Self::Intrinsics { place, source } => Self::Intrinsics { place: join(&place), source },
            Self::Field { place, field, value, expected } => {
                Self::Field { place: join(&place), field, value, expected }
            }
            Self::Missing { place, missing, hint } => Self::Missing { place: join(&place), missing, hint },
        }
    }
}
