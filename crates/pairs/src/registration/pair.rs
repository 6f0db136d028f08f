//! The one interface of everything that finds the pose between two masked views.

use std::time::Instant;

use unopose_core::{frame::MaskedView, geometry::Pose};

use super::{RegistrationError, refinement::Refinement};

/// The pose between two views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairPose {
    /// Reference camera to query camera, metres.
    pub t_query_reference: Pose,
    /// Confidence in [0, 1], comparable between the pairs of one estimator only.
    pub score: f64,
    /// Wall-clock time of this pair, reference included.
    pub seconds: f64,
    /// Probability that the pose is right and whether that is enough, from estimators that are calibrated.
    pub confidence: Option<(f64, bool)>,
}

/// Finds the pose of an object in a query view against one reference view.
pub trait PairEstimator: Sync {
    /// Short, of letters, digits and dashes.
    fn name(&self) -> String;

    /// Everything that decides about a pose besides the views: constants, seeds, a hash of the weights. Results are kept
    /// and found again by it.
    fn fingerprint(&self) -> String;

    /// The pose of the object in the query view relative to the reference view.
    fn estimate(&self, query: MaskedView, reference: MaskedView) -> Result<PairPose, RegistrationError>;

    /// The pose with a refinement that the estimator does itself, before it chooses among several poses. `None`: a refinement
    /// comes after it.
    fn estimate_refined(
        &self,
        _query: MaskedView,
        _reference: MaskedView,
        _refinement: Refinement,
    ) -> Option<Result<PairPose, RegistrationError>> {
        None
    }

    /// Whether [`Self::estimate_refined`] gives poses.
    fn refines_itself(&self) -> bool {
        false
    }
}

/// Registration of two clouds of points (metres, camera frames).
pub trait CloudRegistration: Sync {
    /// As [`PairEstimator::name`].
    fn name(&self) -> &'static str;

    /// As [`PairEstimator::fingerprint`]: the constants and seeds.
    fn fingerprint(&self) -> String;

    /// Reference to query camera, and a score in [0, 1].
    fn register(&self, query: &[[f32; 3]], reference: &[[f32; 3]]) -> Result<(Pose, f64), RegistrationError>;
}

/// What works on clouds works on views.
impl<R: CloudRegistration> PairEstimator for R {
    fn name(&self) -> String {
        CloudRegistration::name(self).to_owned()
    }

    fn fingerprint(&self) -> String {
        CloudRegistration::fingerprint(self)
    }

    fn estimate(&self, query: MaskedView, reference: MaskedView) -> Result<PairPose, RegistrationError> {
        let start = Instant::now();
        let (t_query_reference, score) = self.register(&query.points(), &reference.points())?;
        Ok(PairPose { t_query_reference, score, seconds: start.elapsed().as_secs_f64(), confidence: None })
    }
}

/// Any estimator with a local refinement after it.
#[derive(Clone, Copy)]
pub struct Refined<'a> {
    /// Gives the pose that is refined.
    pub estimator: &'a dyn PairEstimator,
    /// Applied to the masked clouds of both views.
    pub refinement: Refinement,
}

impl PairEstimator for Refined<'_> {
    fn name(&self) -> String {
        match self.refinement {
            Refinement::None => self.estimator.name(),
            refinement => format!("{}-{refinement}", self.estimator.name()),
        }
    }

    fn fingerprint(&self) -> String {
        format!("{} {}", self.estimator.fingerprint(), self.refinement.fingerprint())
    }

    fn estimate(&self, query: MaskedView, reference: MaskedView) -> Result<PairPose, RegistrationError> {
        if self.refinement != Refinement::None
            && let Some(pair) = self.estimator.estimate_refined(query, reference, self.refinement)
        {
            return pair;
        }
        let pair = self.estimator.estimate(query, reference)?;
        Ok(self.refine(pair, query, reference))
    }
}

impl Refined<'_> {
    /// The estimator's pose after the refinement, whose time is added.
    pub fn refine(&self, pair: PairPose, query: MaskedView, reference: MaskedView) -> PairPose {
        if self.refinement == Refinement::None {
            return pair;
        }
        let start = Instant::now();
        let (query, reference) = (query.points(), reference.points());
        let t_query_reference = self.refinement.apply(&query, &reference, &pair.t_query_reference);
        PairPose { t_query_reference, seconds: pair.seconds + start.elapsed().as_secs_f64(), ..pair }
    }
}
