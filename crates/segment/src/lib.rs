//! UNOSeg: where is the object of one reference view in another image?
//!
//! A [`ProposalGenerator`] finds candidate masks of everything in an image, a [`Matcher`] compares them with the objects
//! looked for, and every proposal goes to the object it scores best for; [`UnoSeg`] is the three steps together and
//! [`segment_targets`] runs it on a target list. [`RegionProposals`] and [`GeometricMatcher`] need no downloaded weights.
//! [`DinoMatcher`] compares by published DINOv2 weights, also with [`Templates`] of a CAD model; [`SamProposals`] takes
//! published weights of Segment Anything.

mod any_matcher;
mod assignment;
mod dataset;
mod dino;
mod error;
mod generator;
mod geometric;
mod lab;
mod learned;
mod listed;
mod matcher;
mod objects;
mod observe;
mod prompt;
mod proposal;
mod recall;
mod region_merging;
pub mod sam;
mod templates;
mod unoseg;

pub use any_matcher::{AnyMatcher, AnyObject};
pub use dataset::{DatasetSegmentation, segment_targets};
pub use dino::{DinoMatcher, DinoObject};
pub use error::SegmentError;
pub use generator::ProposalGenerator;
pub use geometric::{
    GeometricMatcher, GeometricObject, MatchEvidence, MatchFeature, MatchScore, ObservedMatch, PosedProposal,
    PresenceReport, RIGHT_IOU,
};
pub use learned::{LearnedProposals, MaskEvidence, Objectness, ObservedMask};
pub use listed::ListedProposals;
pub use matcher::{Comparison, Matcher};
pub use objects::{ObjectKey, ObjectViews};
pub use observe::{observe_masks, observe_matches};
pub use prompt::Prompt;
pub use proposal::{ImageKey, MAX_PROPOSALS, Proposal};
pub use recall::{ProposalScores, proposal_scores};
pub use region_merging::RegionProposals;
pub use sam::SamProposals;
pub use templates::Templates;
pub use unoseg::{FoundObject, ImageSegmentation, UnoSeg};
