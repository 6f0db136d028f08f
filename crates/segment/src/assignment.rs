//! From scores to detections: each proposal goes to the object it scores best for, then the proposals of an object that
//! overlap a better one are dropped. An object that got nothing takes the best proposal that is
//! not the best one of another object.

use unopose_core::frame::BoundingBox;

use super::proposal::Proposal;

/// Proposals of one object whose boxes overlap more than this are the same instance.
const BOX_OVERLAP: f64 = 0.25;
/// Masks that overlap more than this show the same object, which is only one of those looked for.
const SAME_PLACE: f64 = 0.5;
/// Scores below this are no detection at all.
const MIN_SCORE: f64 = 0.01;

/// A proposal given to an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Assignment {
    /// Index in the list of objects.
    pub object: usize,
    /// Index in the list of proposals.
    pub proposal: usize,
    /// The matcher's score of the pair, in [0, 1].
    pub score: f64,
}

/// Detections by descending score; `scores` is `[objects][proposals]`.
pub fn assign(proposals: &[Proposal], scores: &[Vec<f64>]) -> Vec<Assignment> {
    let best = |proposal: usize| {
        let of_objects = scores.iter().enumerate().filter_map(|(object, row)| {
            let score = *row.get(proposal)?;
            Some(Assignment { object, proposal, score })
        });
        of_objects.max_by(|a, b| a.score.total_cmp(&b.score).then(b.object.cmp(&a.object)))
    };
    let mut assigned: Vec<Assignment> =
        (0..proposals.len()).filter_map(best).filter(|a| a.score >= MIN_SCORE).collect();
    assigned.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.proposal.cmp(&b.proposal)));
    let mut kept: Vec<Assignment> = Vec::new();
    for candidate in assigned {
        let bounds = &proposals[candidate.proposal].bounds;
        let same = |other: &&Assignment| {
            other.object == candidate.object
                && box_iou(bounds, &proposals[other.proposal].bounds) > BOX_OVERLAP
        };
        if kept.iter().find(same).is_none() {
            kept.push(candidate);
        }
    }
    // By descending score, so the first of an object is its best.
    let mut taken: Vec<Assignment> = Vec::new();
    for one in &kept {
        if taken.iter().all(|other| other.object != one.object) {
            taken.push(*one);
        }
    }
    for (object, row) in scores.iter().enumerate() {
        if taken.iter().all(|other| other.object != object)
            && let Some(found) = best_free(proposals, row, object, &taken)
        {
            taken.push(found);
            kept.push(found);
        }
    }
    kept.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.proposal.cmp(&b.proposal)));
    kept
}

/// The best proposal for an object that is not where one of `taken` is.
fn best_free(proposals: &[Proposal], row: &[f64], object: usize, taken: &[Assignment]) -> Option<Assignment> {
    let free = |proposal: usize| {
        let mask = &proposals[proposal].mask;
        taken.iter().all(|other| proposals[other.proposal].mask.iou(mask) <= SAME_PLACE)
    };
    let candidates = row.iter().enumerate().filter(|(_, score)| **score >= MIN_SCORE);
    let mut candidates: Vec<(usize, f64)> = candidates.map(|(proposal, &score)| (proposal, score)).collect();
    candidates.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let (proposal, score) = candidates.into_iter().find(|&(proposal, _)| free(proposal))?;
    Some(Assignment { object, proposal, score })
}

/// Indices of boxes, given best first, that overlap no kept better one by more than `overlap`.
pub fn non_maximum_suppression(boxes: &[BoundingBox], overlap: f64) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for (index, bounds) in boxes.iter().enumerate() {
        if kept.iter().all(|&other| box_iou(bounds, &boxes[other]) <= overlap) {
            kept.push(index);
        }
    }
    kept
}

/// Intersection over union of two boxes.
pub fn box_iou(a: &BoundingBox, b: &BoundingBox) -> f64 {
    let side = |from: u32, to: u32| f64::from(to.saturating_sub(from));
    let area = |b: &BoundingBox| side(b.col_min, b.col_max) * side(b.row_min, b.row_max);
    let both = side(a.col_min.max(b.col_min), a.col_max.min(b.col_max))
        * side(a.row_min.max(b.row_min), a.row_max.min(b.row_max));
    let either = area(a) + area(b) - both;
    if either > 0.0 { both / either } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use unopose_core::frame::Mask;

    use super::*;

    fn square(col: u32, side: u32) -> Proposal {
        let mut mask = Mask::empty(40, 20);
        for row in 0..side {
            for c in col..col + side {
                mask.data[(row * 40 + c) as usize] = true;
            }
        }
        Proposal::new(mask, 1.0).unwrap()
    }

    #[test]
    fn each_proposal_goes_to_its_best_object_once() {
        // The first two overlap by 8 x 10 of 12 x 10: 2/3.
        let proposals = [square(0, 10), square(2, 10), square(20, 10)];
        let scores = [vec![0.9, 0.8, 0.3], vec![0.2, 0.7, 0.6]];
        let found = assign(&proposals, &scores);
        let expected = [
            Assignment { object: 0, proposal: 0, score: 0.9 },
            Assignment { object: 1, proposal: 2, score: 0.6 },
        ];
        assert_eq!(found, expected);
        // The second object has nothing of its own: it takes the second best of the first, but not its best place.
        let found = assign(&proposals, &[vec![0.9, 0.8, 0.5], vec![0.2, 0.7, 0.3]]);
        let expected = [
            Assignment { object: 0, proposal: 0, score: 0.9 },
            Assignment { object: 0, proposal: 2, score: 0.5 },
            Assignment { object: 1, proposal: 2, score: 0.3 },
        ];
        assert_eq!(found, expected);
        let found = assign(&proposals, &[vec![0.9, 0.8, 0.0], vec![0.2, 0.7, 0.005]]);
        assert_eq!(found, [Assignment { object: 0, proposal: 0, score: 0.9 }]);
        assert!((box_iou(&proposals[0].bounds, &proposals[1].bounds) - 80.0 / 120.0).abs() < 1e-12);
        assert!(assign(&proposals, &[vec![0.0, 0.001, 0.009]]).is_empty());
        let boxes = proposals.map(|p| p.bounds);
        assert_eq!(non_maximum_suppression(&boxes, 0.6), [0, 2]);
        assert_eq!(non_maximum_suppression(&boxes, 0.7), [0, 1, 2]);
    }
}
