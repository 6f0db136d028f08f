//! How much a proposal looks like the object of a reference.

use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::Pose,
};

use super::{Proposal, SegmentError};

/// How much a proposal looks like an object.
#[derive(Clone, Copy, Debug, Default)]
pub struct Comparison {
    /// In [0, 1].
    pub score: f64,
    /// Reference camera to query camera, where the comparison found one.
    pub t_query_reference: Option<Pose>,
}

/// Compares proposals with objects.
pub trait Matcher: Sync {
    /// What this matcher keeps of an object.
    type Object: Send + Sync;

    /// A short name of letters, digits and dashes, for tables and folders.
    fn name(&self) -> String;

    /// Everything that decides about a score besides the images.
    fn fingerprint(&self) -> String;

    /// Detections of an object that score at least this are instances of it.
    fn instance_score(&self) -> f64;

    /// Whether an object of which no detection reaches [`Self::instance_score`] is not in the image. Otherwise the best
    /// detection is one.
    fn knows_absence(&self) -> bool;

    /// Describes an object by its views: one reference, or templates of a model.
    fn object(&self, views: &[MaskedView]) -> Result<Self::Object, SegmentError>;

    /// How much each proposal looks like each object, `[objects][proposals]`.
    fn compare(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&Self::Object],
    ) -> Result<Vec<Vec<Comparison>>, SegmentError>;

    /// The scores of [`Self::compare`] alone.
    fn scores(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&Self::Object],
    ) -> Result<Vec<Vec<f64>>, SegmentError> {
        let compared = self.compare(frame, proposals, objects)?;
        Ok(compared.into_iter().map(|row| row.into_iter().map(|c| c.score).collect()).collect())
    }

    /// The mask of an object in a pose, cut anew from the one that the pose was found with; `None` to leave it.
    fn recut(
        &self,
        frame: &RgbdFrame,
        mask: &Mask,
        object: &Self::Object,
        t_query_reference: &Pose,
    ) -> Option<Mask>;
}
