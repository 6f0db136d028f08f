//! Coarse pose: hypotheses from sampled triplets of matches, the best one by its distances (paper, "Coarse Point
//! Matching"; numbers as in the release).

use rayon::prelude::*;

use super::{Assignment, Pose, columns::Columns, procrustes::vector, weighted_procrustes};
use crate::config::HypothesisConfig;

/// Draws per triplet before a degenerate one is given up.
const ATTEMPTS: usize = 8;
/// Smallest doubled area of a usable triangle relative to its longest squared edge.
const COLLINEAR: f64 = 0.02;

/// The winning hypothesis and what led to it.
#[derive(Clone, Debug)]
pub struct CoarsePose {
    /// Reference to query in the units of the clouds.
    pub pose: Pose,
    /// Matched query points over the sum of their distances to the reference, unless rescored; 0 when nothing matched.
    pub score: f64,
    /// All solved triplets.
    pub hypotheses: Vec<Hypothesis>,
    /// Indices into `hypotheses` with the smallest residuals, ascending.
    pub kept: Vec<usize>,
    /// Scores of the kept.
    pub kept_scores: Vec<f64>,
    /// Index of the winner in `kept`; `None` when there was no hypothesis to keep.
    pub best: Option<usize>,
}

/// One triplet of matches and its pose.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// Query point and reference point of each match.
    pub pairs: [(u32, u32); 3],
    /// Reference to query in the units of the clouds.
    pub pose: Pose,
    /// Mean distance of the three matches under the pose.
    pub residual: f64,
}

impl CoarsePose {
    /// Scores the kept hypotheses anew and lets the best of them win; the earlier one wins a draw.
    pub fn rescored(self, score: impl Fn(&Pose) -> f64 + Send + Sync) -> Self {
        let poses = self.kept.par_iter().with_min_len(8).map(|&h| &self.hypotheses[h].pose);
        let kept_scores: Vec<f64> = poses.map(score).collect();
        match (0..kept_scores.len()).reduce(|a, b| if kept_scores[b] > kept_scores[a] { b } else { a }) {
            Some(best) => Self {
                pose: self.hypotheses[self.kept[best]].pose,
                score: kept_scores[best],
                best: Some(best),
                kept_scores,
                ..self
            },
            None => self,
        }
    }
}

/// Cumulative distribution of the matches, `[N * M]`: weights^power of foreground pairs, summed in `f64`, rounded
/// to `f32`, divided by (the last + 1e-8).
pub fn match_distribution(assignment: &Assignment, power: f32) -> Vec<f32> {
    let mut sum = 0.0f64;
    let mut cumulative = Vec::with_capacity(assignment.queries() * assignment.references());
    for (i, &label) in assignment.label_query.iter().enumerate() {
        for (&w, &back) in assignment.row(i).iter().zip(&assignment.label_reference) {
            if label > 0 && back > 0 {
                sum += if power == 1.5 { w * w.sqrt() } else { w.powf(power) } as f64;
            }
            cumulative.push(sum as f32);
        }
    }
    let total = cumulative.last().copied().unwrap_or(0.0) + 1e-8;
    cumulative.iter_mut().for_each(|c| *c /= total);
    cumulative
}

/// Pose of `reference` in `query` from the assignment of their points.
///
/// Consecutive triples of `uniforms` (in [0, 1)) draw the matches by inverse distribution. With
/// `degenerate_allowed` every triplet is solved as drawn, as in the release; otherwise triplets that repeat a point
/// or are nearly collinear are drawn again a few times and then skipped. Without any hypothesis the answer is the
/// shift between the means with score 0.
///
/// # Panics
/// When the clouds' sizes differ from the assignment's.
pub fn coarse_pose(
    assignment: &Assignment,
    query: &[[f32; 3]],
    reference: &[[f32; 3]],
    config: &HypothesisConfig,
    mut uniforms: impl FnMut() -> f32,
    degenerate_allowed: bool,
) -> CoarsePose {
    assert_eq!((query.len(), reference.len()), (assignment.queries(), assignment.references()));
    let distribution = match_distribution(assignment, config.power);
    let matched = distribution.last().is_some_and(|&c| c > 0.0);
    let mut draw = || -> [(u32, u32); 3] {
        std::array::from_fn(|_| pair_at(&distribution, uniforms(), query.len(), reference.len()))
    };
    let triplets: Vec<[(u32, u32); 3]> = if query.is_empty() || reference.is_empty() {
        Vec::new()
    } else if degenerate_allowed {
        (0..config.proposals).map(|_| draw()).collect()
    } else if matched {
        (0..config.proposals)
            .filter_map(|_| (0..ATTEMPTS).map(|_| draw()).find(|t| is_determined(t, query, reference)))
            .collect()
    } else {
        Vec::new()
    };
    let hypotheses: Vec<Hypothesis> =
        triplets.into_par_iter().with_min_len(256).map(|pairs| solve(pairs, query, reference)).collect();

    let mut kept: Vec<usize> = (0..hypotheses.len()).collect();
    let by_residual =
        |a: &usize, b: &usize| hypotheses[*a].residual.total_cmp(&hypotheses[*b].residual).then(a.cmp(b));
    if config.kept < kept.len() {
        kept.select_nth_unstable_by(config.kept, by_residual);
        kept.truncate(config.kept);
    }
    kept.sort_unstable_by(by_residual);

    let matched_points: Vec<[f32; 3]> =
        query.iter().zip(&assignment.label_query).filter(|(_, l)| **l > 0).map(|(q, _)| *q).collect();
    let columns = Columns::new(reference);
    let kept_scores: Vec<f64> = kept
        .par_iter()
        .with_min_len(8)
        .map(|&h| distance_score(&hypotheses[h].pose, &matched_points, &columns))
        .collect();
    let best = (0..kept.len()).reduce(|a, b| if kept_scores[b] > kept_scores[a] { b } else { a });
    let (pose, score) = match best {
        Some(b) => (hypotheses[kept[b]].pose, kept_scores[b]),
        None => (shift_between_means(query, reference), 0.0),
    };
    CoarsePose { pose, score, hypotheses, kept, kept_scores, best }
}

/// The match at `uniform` of the distribution: left-sided search; past the end the last query point and the first
/// reference point.
fn pair_at(distribution: &[f32], uniform: f32, queries: usize, references: usize) -> (u32, u32) {
    let index = distribution.partition_point(|&c| c < uniform);
    ((index / references).min(queries - 1) as u32, (index % references) as u32)
}

fn is_determined(pairs: &[(u32, u32); 3], query: &[[f32; 3]], reference: &[[f32; 3]]) -> bool {
    let spread = |points: [[f32; 3]; 3]| {
        let [a, b, c] = points.map(|p| vector(&p));
        let (ab, ac) = (b - a, c - a);
        let longest = ab.norm_squared().max(ac.norm_squared()).max((c - b).norm_squared());
        ab.cross(&ac).norm() > COLLINEAR * longest
    };
    spread(pairs.map(|(q, _)| query[q as usize])) && spread(pairs.map(|(_, p)| reference[p as usize]))
}

fn solve(pairs: [(u32, u32); 3], query: &[[f32; 3]], reference: &[[f32; 3]]) -> Hypothesis {
    let q = pairs.map(|(i, _)| query[i as usize]);
    let p = pairs.map(|(_, j)| reference[j as usize]);
    let pose = weighted_procrustes(&p, &q, None, 0.5);
    let residual = (0..3)
        .map(|i| (pose.rotation.tr_mul(&(vector(&q[i]) - pose.translation)) - vector(&p[i])).norm())
        .sum::<f64>()
        / 3.0;
    Hypothesis { pairs, pose, residual }
}

fn distance_score(pose: &Pose, matched_query: &[[f32; 3]], reference: &Columns) -> f64 {
    let inverse = pose.inverse();
    let total: f64 =
        matched_query.iter().map(|q| reference.nearest_squared(inverse.transform_f32(q)).sqrt() as f64).sum();
    matched_query.len() as f64 / (total + 1e-8)
}

fn shift_between_means(query: &[[f32; 3]], reference: &[[f32; 3]]) -> Pose {
    let mean = |points: &[[f32; 3]]| {
        points.iter().map(vector).sum::<nalgebra::Vector3<f64>>() / points.len().max(1) as f64
    };
    Pose::new(nalgebra::Matrix3::identity(), mean(query) - mean(reference))
}
