//! Matching with the checkpoint of the pose network: size, colours, features of its colour encoder, and how well the image
//! agrees with the pose that the network finds.
//!
//! The cheap parts order the proposals; only the best ones get a pose. A checkpoint with a fitted [`MatchScore`] in its metadata
//! gives the probability that a proposal is the object; without one the parts are combined by hand.

mod consistency;
mod histogram;
mod match_score;
mod recut;

pub use match_score::{MatchEvidence, MatchFeature, MatchScore, ObservedMatch, PresenceReport, RIGHT_IOU};

use std::path::Path;

use rayon::prelude::*;
use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::protocol::MIN_DETECTION_SCORE;
use unopose_infer::{PoseEstimator, Query, Reference};
use unopose_pairs::registration::PairEstimator;

use super::{Comparison, Matcher, Proposal, SegmentError};
use consistency::{ColoredPoints, Consistency};
use histogram::ColorHistogram;
use recut::ReferenceSurface;

/// Proposals of an image that get a pose for each object.
const POSED: usize = 8;
/// Proposals that are described by the colour encoder for each object.
const DESCRIBED: usize = 20;
/// Logarithm of the size ratio at which the size counts half.
const HALF_SIZE: f64 = 0.45;
/// Largest distance of a point on the surface from what is measured, radii of the object.
const REACH: f32 = 0.12;
/// Its lower limit, the noise of a sensor, metres.
const MIN_REACH: f32 = 0.006;

/// Compares by the checkpoint of the pose network.
pub struct GeometricMatcher<'a> {
    /// The loaded pose network.
    estimator: &'a PoseEstimator,
    /// Of its checkpoint.
    score: Option<MatchScore>,
}

/// A proposal that was given a pose.
#[derive(Clone, Copy, Debug)]
pub struct PosedProposal {
    /// Index of the proposal.
    pub proposal: usize,
    /// What speaks for it.
    pub evidence: MatchEvidence,
    /// Reference camera to query camera.
    pub t_query_reference: Pose,
}

/// One reference view as [`GeometricMatcher`] keeps it.
pub struct GeometricObject {
    reference: Reference,
    histogram: ColorHistogram,
    features: Vec<f32>,
    points: ColoredPoints,
    surface: ReferenceSurface,
    /// Mean radius of the view's points, metres.
    mean_radius: f64,
}

impl Matcher for GeometricMatcher<'_> {
    type Object = GeometricObject;

    fn name(&self) -> String {
        "checkpoint".into()
    }

    fn fingerprint(&self) -> String {
        let score = self.score.as_ref().map(|score| score.to_metadata().1).unwrap_or_default();
        let score = crc32fast::hash(score.as_bytes());
        format!("checkpoint 2 {POSED} {DESCRIBED} {score:08x} {}", self.estimator.fingerprint())
    }

    /// The fitted threshold, else as for given detections.
    fn instance_score(&self) -> f64 {
        self.score.as_ref().map_or(MIN_DETECTION_SCORE, |score| score.threshold)
    }

    fn knows_absence(&self) -> bool {
        self.score.is_some()
    }

    /// Only the first view is used.
    fn object(&self, views: &[MaskedView]) -> Result<GeometricObject, SegmentError> {
        let missing = || SegmentError::Reference { reason: "there is none".into() };
        let MaskedView { frame, mask } = *views.first().ok_or_else(missing)?;
        if mask.count() == 0 {
            return Err(SegmentError::Reference { reason: "all of it is background".into() });
        }
        let reference = self.estimator.reference(frame, mask)?;
        let features = self.estimator.color_features(frame, &[mask])?.pop().flatten().unwrap_or_default();
        Ok(GeometricObject {
            histogram: ColorHistogram::new(&frame.rgb, mask),
            mean_radius: mean_radius(&frame.masked_points(mask)),
            points: ColoredPoints::new(frame, mask),
            surface: ReferenceSurface::new(frame, mask, reference.radius()),
            reference,
            features,
        })
    }

    fn compare(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&GeometricObject],
    ) -> Result<Vec<Vec<Comparison>>, SegmentError> {
        let posed = self.evidence(frame, proposals, objects)?;
        let compared = |posed: Vec<PosedProposal>| {
            let mut compared = vec![Comparison::default(); proposals.len()];
            for PosedProposal { proposal, evidence, t_query_reference } in posed {
                let fitted = self.score.as_ref().map(|score| score.probability(&evidence));
                let score = fitted.unwrap_or_else(|| unfitted(&evidence));
                compared[proposal] = Comparison { score, t_query_reference: Some(t_query_reference) };
            }
            compared
        };
        Ok(posed.into_iter().map(compared).collect())
    }

    fn recut(
        &self,
        frame: &RgbdFrame,
        mask: &Mask,
        object: &GeometricObject,
        t_query_reference: &Pose,
    ) -> Option<Mask> {
        object.surface.recut(frame, mask, t_query_reference, object.reach())
    }
}

impl<'a> GeometricMatcher<'a> {
    /// With the score in the estimator's checkpoint, if it has one.
    pub fn new(estimator: &'a PoseEstimator) -> Result<Self, SegmentError> {
        let score = MatchScore::from_metadata(estimator.metadata(), Path::new(estimator.source()))?;
        Ok(Self { estimator, score })
    }

    /// What speaks for the most promising proposals being each object, `[objects]`.
    pub fn evidence(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&GeometricObject],
    ) -> Result<Vec<Vec<PosedProposal>>, SegmentError> {
        let described: Vec<(ColorHistogram, f64)> = proposals
            .par_iter()
            .map(|p| (ColorHistogram::new(&frame.rgb, &p.mask), mean_radius(&frame.masked_points(&p.mask))))
            .collect();
        let alike = |object: &GeometricObject| -> Vec<MatchEvidence> {
            let of =
                |((histogram, mean_radius), proposal): (&(ColorHistogram, f64), &Proposal)| MatchEvidence {
                    size: size_likeness(*mean_radius, object.mean_radius),
                    histogram: histogram.similarity(&object.histogram),
                    proposal: proposal.score.into(),
                    ..MatchEvidence::default()
                };
            described.iter().zip(proposals).map(of).collect()
        };
        let mut evidence: Vec<Vec<MatchEvidence>> = objects.iter().map(|object| alike(object)).collect();
        let order = |row: &[MatchEvidence], rank: fn(&MatchEvidence) -> f64, count: usize| {
            best(&row.iter().map(rank).collect::<Vec<f64>>(), count)
        };
        let wanted: Vec<Vec<usize>> =
            evidence.iter().map(|row| order(row, MatchEvidence::size_and_colors, DESCRIBED)).collect();
        let mut any: Vec<usize> = wanted.iter().flatten().copied().collect();
        any.sort_unstable();
        any.dedup();
        let masks: Vec<&Mask> = any.iter().map(|&p| &proposals[p].mask).collect();
        let mut features: Vec<Option<Vec<f32>>> = vec![None; proposals.len()];
        for (&p, found) in any.iter().zip(self.estimator.color_features(frame, &masks)?) {
            features[p] = found;
        }
        let mut posed = Vec::with_capacity(objects.len());
        for ((object, row), wanted) in objects.iter().zip(&mut evidence).zip(wanted) {
            for &p in &wanted {
                row[p].appearance = features[p].as_ref().map_or(0.0, |f| cosine(f, &object.features));
            }
            let of_wanted: Vec<MatchEvidence> = wanted.iter().map(|&p| row[p]).collect();
            let chosen = order(&of_wanted, MatchEvidence::without_pose, POSED);
            let chosen = chosen.into_iter().map(|i| (wanted[i], of_wanted[i])).collect();
            posed.push(self.posed(frame, proposals, object, chosen));
        }
        Ok(posed)
    }

    /// The proposals that get a pose, with what it says.
    fn posed(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        object: &GeometricObject,
        chosen: Vec<(usize, MatchEvidence)>,
    ) -> Vec<PosedProposal> {
        let queries: Vec<Query<'_>> = chosen
            .iter()
            .map(|(p, _)| Query { reference: &object.reference, frame, mask: &proposals[*p].mask })
            .collect();
        let estimates = self.estimator.estimate_batch(&queries);
        let judged = chosen.iter().zip(estimates).filter_map(|(&(proposal, evidence), estimate)| {
            let estimate = estimate.ok()?;
            let (mask, t_query_reference) = (&proposals[proposal].mask, estimate.t_query_reference);
            let seen = object.points.consistency(frame, mask, &t_query_reference, object.reach());
            let Consistency { surface, inside, covered, color } = seen;
            let evidence =
                MatchEvidence { surface, inside, covered, color, pose: estimate.evidence, ..evidence };
            Some(PosedProposal { proposal, evidence, t_query_reference })
        });
        judged.collect()
    }
}

impl GeometricObject {
    /// Largest distance of a point on the surface from what is measured, metres.
    fn reach(&self) -> f32 {
        (REACH * self.reference.radius()).max(MIN_REACH)
    }
}

impl MatchEvidence {
    /// Order in which proposals are described by the colour encoder.
    fn size_and_colors(&self) -> f64 {
        self.size * self.histogram.sqrt()
    }

    /// Order in which proposals get a pose.
    fn without_pose(&self) -> f64 {
        self.size_and_colors() * (0.5 + 0.5 * self.appearance.clamp(0.0, 1.0))
    }
}

/// The score of a checkpoint without a fitted one, combined by hand.
fn unfitted(evidence: &MatchEvidence) -> f64 {
    let agreement = evidence.surface * evidence.inside * evidence.covered;
    let appearance = evidence.without_pose() * (0.3 + 0.7 * evidence.color);
    (agreement.max(0.0).sqrt() * appearance * (0.4 + 0.6 * evidence.pose.fit)).clamp(0.0, 1.0)
}

/// Indices of the `count` largest values above 0, largest first.
fn best(values: &[f64], count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).filter(|&i| values[i] > 0.0).collect();
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]).then(a.cmp(&b)));
    order.truncate(count);
    order
}

/// 1 for equal sizes; a proposal may be smaller, being occluded, more easily than larger.
fn size_likeness(query: f64, reference: f64) -> f64 {
    if !(query > 0.0 && reference > 0.0) {
        return 0.0;
    }
    let log = (query / reference).ln();
    let log = if log > 0.0 { 1.5 * log } else { log };
    (-(log / HALF_SIZE).powi(2) * std::f64::consts::LN_2).exp()
}

/// Mean distance to the mean.
fn mean_radius(points: &[[f32; 3]]) -> f64 {
    let count = points.len().max(1) as f64;
    let mean: [f64; 3] = std::array::from_fn(|i| points.iter().map(|p| f64::from(p[i])).sum::<f64>() / count);
    let distance = |p: &[f32; 3]| (0..3).map(|i| (f64::from(p[i]) - mean[i]).powi(2)).sum::<f64>().sqrt();
    points.iter().map(distance).sum::<f64>() / count
}

fn cosine(a: &[f32], b: &[f32]) -> f64 {
    let dot = |x: &[f32], y: &[f32]| x.iter().zip(y).map(|(x, y)| f64::from(x * y)).sum::<f64>();
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt().max(1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_orders() {
        assert_eq!(size_likeness(0.1, 0.1), 1.0);
        // A ratio of exp(-0.45) counts half, its inverse half to the power 1.5 squared.
        assert!((size_likeness(0.1 * (-0.45f64).exp(), 0.1) - 0.5).abs() < 1e-9);
        assert!((size_likeness(0.1 * 0.45f64.exp(), 0.1) - 0.5f64.powf(2.25)).abs() < 1e-9);
        assert_eq!(size_likeness(0.0, 0.1), 0.0);
        assert_eq!(best(&[0.2, 0.0, 0.9, 0.2], 3), [2, 0, 3]);
        let corners = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]];
        assert_eq!(mean_radius(&corners), 1.0);
        assert!((cosine(&[1.0, 0.0], &[1.0, 1.0]) - 0.5f64.sqrt()).abs() < 1e-6);
    }
}
