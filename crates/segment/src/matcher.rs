//! How much a proposal looks like the object of a reference.

use unopose_core::frame::{MaskedView, RgbdFrame};

use super::{Proposal, SegmentError};

/// Compares proposals with objects.
pub trait Matcher: Sync {
    /// An object as this matcher keeps it.
    type Object: Send + Sync;

    /// Short, of letters, digits and dashes.
    fn name(&self) -> String;

    /// Everything that decides about a score besides the images.
    fn fingerprint(&self) -> String;

    /// Score above which each detection of an object is an instance of it; of an object that is nowhere scored so high, the
    /// best detection is.
    fn instance_score(&self) -> f64;

    /// Describes an object by its views: one reference, or templates of a model.
    fn object(&self, views: &[MaskedView]) -> Result<Self::Object, SegmentError>;

    /// Scores in [0, 1], `[objects][proposals]`.
    fn scores(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&Self::Object],
    ) -> Result<Vec<Vec<f64>>, SegmentError>;
}
