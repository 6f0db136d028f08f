//! Where accuracy is lost: every stage of an estimate against the truth, pair by pair.
//!
//! [`analyse`] runs the network on a target list whose poses are known and keeps one [`PairRecord`] per target: how many
//! coarse matches are right, what the best hypothesis would have been, how far the fine matches are off, what the overlap
//! predictor gets right, and the pose errors after each stage. [`write_findings`] puts them into tables by visibility,
//! rotation, size and texture; [`calibrate`] fits the confidence to them.

mod calibrate;
mod error;
mod findings;
mod local_frames;
mod measure;
mod record;
mod run;

pub use calibrate::{calibrate, judged, write_reliability};
pub use error::AnalysisError;
pub use findings::write_findings;
pub use record::PairRecord;
pub use run::analyse;
