//! How much a proposal looks like the object of a reference.

use unopose_core::frame::{MaskedView, RgbdFrame};

use super::{Proposal, SegmentError};

/// Compares proposals with objects.
pub trait Matcher: Sync {
    /// What this matcher keeps of an object.
    type Object: Send + Sync;

    /// A short name of letters, digits and dashes, for tables and folders.
    fn name(&self) -> String;

    /// Everything that decides about a score besides the images.
    fn fingerprint(&self) -> String;

    /// Detections of an object that score higher than this are instances of it. Where none does, only the best detection
    /// is one.
    fn instance_score(&self) -> f64;

    /// Describes an object by its views: one reference, or templates of a model.
    fn object(&self, views: &[MaskedView]) -> Result<Self::Object, SegmentError>;

    /// How much each proposal looks like each object, in [0, 1], `[objects][proposals]`.
    fn scores(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&Self::Object],
    ) -> Result<Vec<Vec<f64>>, SegmentError>;
}
