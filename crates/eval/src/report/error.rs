//! Why a figure could not be written.

use std::path::PathBuf;

use unopose_core::files::FileError;

/// Why a figure could not be drawn or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The drawing or its encoding failed.
    #[error("cannot draw {}: {message}", path.display())]
    Draw {
        /// File of the figure.
        path: PathBuf,
        /// Reason of the drawing library.
        message: String,
    },
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] FileError),
}
