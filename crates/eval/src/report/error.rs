//! Why a figure could not be written.

use std::path::PathBuf;

use unopose_core::files::FileError;

#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    #[error("cannot draw {}: {message}", path.display())]
    Draw { path: PathBuf, message: String },
    #[error(transparent)]
    Write(#[from] FileError),
}
