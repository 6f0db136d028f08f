//! Matching with the checkpoint of the pose network: size, colours, features of its colour encoder, and how well the image
//! agrees with the pose that the network finds.
//!
//! The cheap parts order the proposals; only the best ones get a pose. The weights were chosen on synthetic scenes.

mod consistency;
mod histogram;

use rayon::prelude::*;
use unopose_core::frame::{Mask, MaskedView, RgbdFrame};
use unopose_dataset::protocol::MIN_DETECTION_SCORE;
use unopose_infer::{PoseEstimator, Query, Reference};
use unopose_pairs::registration::PairEstimator;

use super::{Matcher, Proposal, SegmentError};
use consistency::ColoredPoints;
use histogram::ColorHistogram;

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
    pub estimator: &'a PoseEstimator,
}

/// One reference view as [`GeometricMatcher`] keeps it.
pub struct GeometricObject {
    reference: Reference,
    histogram: ColorHistogram,
    features: Vec<f32>,
    points: ColoredPoints,
    /// Mean radius of the view's points, metres.
    mean_radius: f64,
}

impl Matcher for GeometricMatcher<'_> {
    type Object = GeometricObject;

    fn name(&self) -> String {
        "checkpoint".into()
    }

    fn fingerprint(&self) -> String {
        format!("checkpoint 1 {POSED} {DESCRIBED} {}", self.estimator.fingerprint())
    }

    /// As for given detections.
    fn instance_score(&self) -> f64 {
        MIN_DETECTION_SCORE
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
            reference,
            features,
        })
    }

    fn scores(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        objects: &[&GeometricObject],
    ) -> Result<Vec<Vec<f64>>, SegmentError> {
        let described: Vec<(ColorHistogram, f64)> = proposals
            .par_iter()
            .map(|p| (ColorHistogram::new(&frame.rgb, &p.mask), mean_radius(&frame.masked_points(&p.mask))))
            .collect();
        // Size and colours.
        let cheap: Vec<Vec<f64>> = objects
            .iter()
            .map(|object| {
                described
                    .iter()
                    .map(|(histogram, mean_radius)| {
                        size_likeness(*mean_radius, object.mean_radius)
                            * histogram.similarity(&object.histogram).sqrt()
                    })
                    .collect()
            })
            .collect();
        let wanted: Vec<Vec<usize>> = cheap.iter().map(|row| best(row, DESCRIBED)).collect();
        let mut any: Vec<usize> = wanted.iter().flatten().copied().collect();
        any.sort_unstable();
        any.dedup();
        let masks: Vec<&Mask> = any.iter().map(|&p| &proposals[p].mask).collect();
        let mut features: Vec<Option<Vec<f32>>> = vec![None; proposals.len()];
        for (&p, found) in any.iter().zip(self.estimator.color_features(frame, &masks)?) {
            features[p] = found;
        }
        let mut scores = Vec::with_capacity(objects.len());
        for ((object, row), wanted) in objects.iter().zip(&cheap).zip(wanted) {
            let mut ordered = vec![0.0; proposals.len()];
            for p in wanted {
                let likeness = features[p].as_ref().map_or(0.0, |f| cosine(f, &object.features));
                ordered[p] = row[p] * (0.5 + 0.5 * likeness.clamp(0.0, 1.0));
            }
            scores.push(self.pose_scores(frame, proposals, object, &ordered));
        }
        Ok(scores)
    }
}

impl GeometricMatcher<'_> {
    /// Final scores of the best of `ordered`; the others stay 0.
    fn pose_scores(
        &self,
        frame: &RgbdFrame,
        proposals: &[Proposal],
        object: &GeometricObject,
        ordered: &[f64],
    ) -> Vec<f64> {
        let chosen = best(ordered, POSED);
        let queries: Vec<Query<'_>> = chosen
            .iter()
            .map(|&p| Query { reference: &object.reference, frame, mask: &proposals[p].mask })
            .collect();
        let estimates = self.estimator.estimate_batch(&queries);
        let reach = (REACH * object.reference.radius()).max(MIN_REACH);
        let mut scores = vec![0.0; proposals.len()];
        for (&p, estimate) in chosen.iter().zip(estimates) {
            let Ok(estimate) = estimate else { continue };
            let mask = &proposals[p].mask;
            let seen = object.points.consistency(frame, mask, &estimate.t_query_reference, reach);
            let agreement = seen.surface * seen.inside * seen.covered;
            let appearance = ordered[p] * (0.3 + 0.7 * seen.color);
            scores[p] =
                (agreement.max(0.0).sqrt() * appearance * (0.4 + 0.6 * estimate.score)).clamp(0.0, 1.0);
        }
        scores
    }
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
