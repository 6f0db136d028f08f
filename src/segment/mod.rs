//! UNOSeg: where is the object of one reference view in another image?
//!
//! A [`ProposalGenerator`] finds candidate masks of everything in an image, a descriptor compares each with the reference,
//! and the assignment turns the scores into detections.

mod embedded;
mod error;
mod proposal;

pub use embedded::EmbeddedProposals;
pub use error::SegmentError;
pub use proposal::{MAX_PROPOSALS, Proposal, ProposalGenerator};
