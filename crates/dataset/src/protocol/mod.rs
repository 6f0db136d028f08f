//! The one-reference protocols: which view of an object is the reference of which target.
//!
//! [`Protocol`] names the paper's choices of a reference: at most 50 degrees away (main experiments), from another scene,
//! up to 90 degrees in nine bins, one view for all targets of an object ("one reference for a category"), a few views per
//! object (supplement). [`build_lists`] makes the lists of a BOP dataset, each entry with angle and overlap ratio. A draw
//! depends on the seed, the protocol and the target alone. [`TargetList`] joins a list with its dataset and detections;
//! [`ImageTargets`] and [`ImagePoses`] are the walk over it.

mod build;
mod choice;
mod error;
mod id_match;
mod instances;
mod overlap;
mod target_list;
mod target_poses;
mod target_walk;
mod unread_images;
mod usable_detections;

pub use build::{BuiltList, BuiltLists, ListInput, build_lists};
pub use choice::Protocol;
pub use error::ProtocolError;
pub use id_match::IdMatch;
use overlap::VisibleSurface;
pub use target_list::{TargetFiles, TargetList};
pub use target_poses::{ImagePoses, NO_DETECTION, Rejection, TargetPoses, best_outcome};
pub use target_walk::{ImageTargets, MIN_DETECTION_SCORE, ObjectTargets};
pub use unread_images::UnreadImages;
pub use usable_detections::{MaskProblem, SkippedDetection, UsableDetections};

/// Largest angle between target and reference view of the main protocol, degrees.
const MAIN_DEG: f64 = 50.0;
/// Width and number of the bins.
const BIN_DEG: f64 = 10.0;
const BINS: usize = 9;
/// Numbers of references per object of the supplement.
pub const REFERENCE_COUNTS: [usize; 5] = [8, 12, 16, 32, 42];

#[cfg(test)]
mod target_walk_tests;
#[cfg(test)]
mod tests;
