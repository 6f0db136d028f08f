//! The network behind the interface that it shares with classical registration.

use std::time::Instant;

use unopose_core::frame::MaskedView;
use unopose_pairs::registration::{PairEstimator, PairPose, RegistrationError};

use super::{InferError, PoseEstimator, Query, Refinement};

/// Without a cached reference: both views are prepared and encoded for every pair.
impl PairEstimator for PoseEstimator {
    fn name(&self) -> String {
        match self.refinement() {
            Refinement::None => "unopose".into(),
            refinement => format!("unopose-{refinement}"),
        }
    }

    /// Of the network, the seed and the refinement.
    fn fingerprint(&self) -> String {
        let network = self.network().unwrap_or_default();
        format!("{network} seed {} {:?}", self.seed(), self.refinement().settings())
    }

    fn estimate(&self, query: MaskedView, reference: MaskedView) -> Result<PairPose, RegistrationError> {
        self.pair_pose(query, reference, self.refinement())
    }

    fn estimate_refined(
        &self,
        query: MaskedView,
        reference: MaskedView,
        refinement: Refinement,
    ) -> Option<Result<PairPose, RegistrationError>> {
        Some(self.pair_pose(query, reference, refinement))
    }

    fn refines_itself(&self) -> bool {
        true
    }
}

impl PoseEstimator {
    fn pair_pose(
        &self,
        query: MaskedView,
        reference: MaskedView,
        refinement: Refinement,
    ) -> Result<PairPose, RegistrationError> {
        let start = Instant::now();
        let failed = |error: InferError| RegistrationError::Estimator(Box::new(error));
        let reference = self.reference(reference.frame, reference.mask).map_err(failed)?;
        let query = Query { reference: &reference, frame: query.frame, mask: query.mask };
        let estimate = self.estimate_refined(&[query], refinement).pop();
        let estimate = estimate.unwrap_or(Err(InferError::Incomplete)).map_err(failed)?;
        let seconds = start.elapsed().as_secs_f64();
        Ok(PairPose {
            t_query_reference: estimate.t_query_reference,
            score: estimate.score,
            seconds,
            confidence: estimate.confidence.map(|c| (c.probability, c.confident)),
        })
    }
}
