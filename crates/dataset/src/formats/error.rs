//! What can be wrong with a dataset file.

use std::{
    fmt::Display,
    path::{Path, PathBuf},
};

use unopose_core::{files::FileError, geometry::IntrinsicsError};

/// Why a dataset file could not be read or written. Every message names the file, and the field where there is one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] FileError),
    /// A file or folder could not be read.
    #[error("{path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Reason of the operating system.
        source: std::io::Error,
    },
    /// An image could not be decoded or encoded.
    #[error("{path}: not a readable image: {source}")]
    Image {
        /// File, or what stands for it in memory.
        path: PathBuf,
        /// Reason of the image library.
        source: image::ImageError,
    },
    /// A JSON file is broken, or a field is missing or of the wrong type.
    #[error("{path}: {source}")]
    Json {
        /// File, or the member of a shard.
        path: PathBuf,
        /// Reason with line and column.
        source: serde_json::Error,
    },
    /// A result table is broken.
    #[error("{path}: {source}")]
    Csv {
        /// File of the table.
        path: PathBuf,
        /// Reason with the line.
        source: csv::Error,
    },
    /// The intrinsics of a camera cannot be used.
    #[error("{place}: {source}")]
    Intrinsics {
        /// File, then the entry inside it.
        place: String,
        /// Which value is wrong.
        source: IntrinsicsError,
    },
    /// A value that parses but cannot be right.
    #[error("{place}: {field} is {value}, expected {expected}")]
    Field {
        /// File, then the entry inside it.
        place: String,
        /// Name of the field in the file.
        field: String,
        /// The value met.
        value: String,
        /// What a right value is like.
        expected: String,
    },
    /// Something that has to be there is not.
    #[error("{place}: {missing} not found{hint}")]
    Missing {
        /// File or folder where it was looked for.
        place: String,
        /// What was looked for.
        missing: String,
        /// What is there instead, in brackets; may be empty.
        hint: String,
    },
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

    /// A file or folder that could not be read.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }

    /// The kind of fault in a few words, without place and values: the same for equal faults of different files.
    pub fn cause(&self) -> String {
        match self {
            Self::Write(FileError { source, .. }) | Self::Io { source, .. } => source.to_string(),
            Self::Image { .. } => "not a readable image".into(),
            Self::Json { .. } => "broken JSON".into(),
            Self::Csv { .. } => "broken table".into(),
            Self::Intrinsics { .. } => "unusable intrinsics".into(),
            Self::Field { field, .. } => format!("wrong {field}"),
            Self::Missing { missing, .. } => {
                let kind = missing.split(|c: char| c == '/' || c.is_ascii_digit()).next().unwrap_or_default();
                format!("{} not found", kind.trim_end())
            }
        }
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
