//! The network behind the interface that it shares with classical registration.

use std::{
    hash::{DefaultHasher, Hash, Hasher},
    path::Path,
    time::Instant,
};

use super::{InferError, PoseEstimator};
use crate::registration::{MaskedView, PairEstimator, PairPose, RegistrationError};

/// Without a cached reference: both views are prepared and encoded for every pair.
impl PairEstimator for PoseEstimator {
    fn name(&self) -> String {
        match self.refinement() {
            super::Refinement::None => "unopose".into(),
            refinement => format!("unopose-{refinement}"),
        }
    }

    /// Of the file of the weights; of the program itself when they are compiled in.
    fn fingerprint(&self) -> String {
        let source = Path::new(self.source());
        let program = std::env::current_exe().unwrap_or_default();
        let file = if source.is_file() { source } else { &program };
        let mut hasher = DefaultHasher::new();
        std::fs::read(file).unwrap_or_default().hash(&mut hasher);
        let config = serde_json::to_string(self.config()).unwrap_or_default();
        let (refinement, color) = (self.refinement().settings(), self.reference_color());
        format!("{:016x} seed {} {refinement:?} {color} {config}", hasher.finish(), self.seed())
    }

    fn estimate(&self, query: MaskedView, reference: MaskedView) -> Result<PairPose, RegistrationError> {
        let start = Instant::now();
        let failed = |error: InferError| RegistrationError::Estimator(Box::new(error));
        let reference = self.reference(reference.frame, reference.mask).map_err(failed)?;
        let mask = std::slice::from_ref(query.mask);
        let estimate = PoseEstimator::estimate(self, &reference, query.frame, mask).pop();
        let estimate = estimate.unwrap_or(Err(InferError::NotFinite)).map_err(failed)?;
        let seconds = start.elapsed().as_secs_f64();
        Ok(PairPose { t_query_reference: estimate.t_query_reference, score: estimate.score, seconds })
    }
}
