//! Why a benchmark fails.

use std::path::PathBuf;

use unopose_core::files::FileError;
use unopose_dataset::{formats::FormatError, mesh::MeshError, protocol::ProtocolError};
use unopose_eval::{metrics::EvalError, report::ReportError};
use unopose_nn::checkpoint::CheckpointError;
use unopose_pairs::data::DataError;
use unopose_segment::SegmentError;

/// Error of a benchmark.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BenchError {
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] FileError),
    /// Dataset, list, detections or kept results cannot be read.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The poses cannot be scored.
    #[error(transparent)]
    Eval(#[from] EvalError),
    /// Curves or overlays cannot be drawn.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// A list cannot be built.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// A model cannot be read.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// An ablation names something that is none of [`INGREDIENTS`](super::INGREDIENTS).
    #[error("unknown ingredient {name:?}, expected some of {expected}")]
    Ingredient {
        /// The unknown name.
        name: String,
        /// All known names, separated by commas.
        expected: String,
    },
    /// Masks cannot be found.
    #[error(transparent)]
    Segment(#[from] SegmentError),
    /// Weights cannot be read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// A vision transformer has fewer blocks than are to be run.
    #[error("{} has {depth} blocks, expected at least {blocks}", path.display())]
    Blocks {
        /// The weights.
        path: PathBuf,
        /// Blocks that were asked for.
        blocks: usize,
        /// Blocks that there are.
        depth: usize,
    },
    /// A view of a pair cannot be prepared.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An ablation without a network.
    #[error("an ablation compares networks, but none is among the methods")]
    NoNetwork,
}
