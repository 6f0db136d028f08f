//! The hypothesis stage against stored hypotheses. Triplets that repeat a point leave their rotation open, and the order
//! of nearly equal residuals is undefined, so lists are compared as sets and open entries not at all.

use nalgebra::{Matrix3, Vector3};
use unopose_core::{
    config::ModelConfig,
    geometry::{Assignment, CoarsePose, Hypothesis, coarse_pose, match_distribution},
};

use super::{ReferenceTensors, VerifyError, computed::Computed, inputs::Pair};

/// Residuals closer than this may change places (radii); twice the tolerance of a residual.
const RESIDUAL_TIE: f64 = 2e-5;
/// Relative difference of hypothesis scores that may change the winner.
const SCORE_TIE: f64 = 1e-4;
/// Second singular value, relative to the first, below which a triplet leaves its rotation open.
const OPEN: f64 = 1e-5;
/// A uniform number this near to a boundary of the cumulative distribution may fall on either side: the bound of
/// `hyp.cumsum`.
const BOUNDARY: f32 = 9e-6;

/// Computes the stage; where the stored winner is open, the stored pose takes its place for what follows.
pub(super) fn compute(
    out: &mut Computed,
    config: &ModelConfig,
    stored: &ReferenceTensors,
    pairs: &[Pair],
    assignments: &[Assignment],
) -> Result<Vec<CoarsePose>, VerifyError> {
    let batch = pairs.len();
    let (m, proposals, kept) = (config.coarse_points, config.hypotheses.proposals, config.hypotheses.kept);
    let mut poses = Vec::with_capacity(batch);
    let mut pair_indices = Vec::with_capacity(batch);
    let mut spectra = Vec::with_capacity(batch);
    for (b, (pair, assignment)) in pairs.iter().zip(assignments).enumerate() {
        let mut uniform = stored.item("uniform", 2, b, batch)?;
        let distribution = match_distribution(assignment, config.hypotheses.power);
        let stored_bins = stored.tensors.get("hyp.pair_idx").map_or(&[][..], |t| &t.values);
        let stored_bins = stored_bins.chunks(uniform.len().max(1)).nth(b).unwrap_or_default();
        for (u, &bin) in uniform.iter_mut().zip(stored_bins) {
            *u = within_stored_bin(&distribution, *u, bin as usize);
        }
        pair_indices.push(
            uniform.iter().map(|&u| distribution.partition_point(|&c| c < u) as f64).collect::<Vec<_>>(),
        );
        let sparse = |points: &[[f32; 3]], indices: &[u32]| -> Vec<[f32; 3]> {
            indices.iter().map(|&i| points[i as usize]).collect()
        };
        let query = sparse(&pair.query.points, &pair.query.sparse);
        let reference = sparse(&pair.reference.cloud.points, &pair.reference.cloud.sparse);
        let mut uniforms = uniform.into_iter();
        let pose = coarse_pose(
            assignment,
            &query,
            &reference,
            &config.hypotheses,
            || uniforms.next().unwrap_or(0.0),
            config.quirks.degenerate_triplets,
        );
        spectra.push(
            pose.hypotheses.iter().map(|h| singular_values(h, &query, &reference)).collect::<Vec<[f64; 3]>>(),
        );
        poses.push(pose);
        out.0.entry("hyp.cumsum".into()).or_default().values.extend(distribution.iter().map(|&c| c as f64));
    }
    if let Some(cumsum) = out.0.get_mut("hyp.cumsum") {
        cumsum.shape = vec![batch, m * m];
    }
    out.items("hyp.assignment", &[m + 1, m + 1], assignments.iter().map(|a| a.weights.clone()));
    out.items("hyp.label1", &[m], assignments.iter().map(|a| a.label_query.clone()));
    out.items("hyp.label2", &[m], assignments.iter().map(|a| a.label_reference.clone()));
    out.items("hyp.weights1", &[m], assignments.iter().map(|a| a.foreground_query()));
    out.items("hyp.weights2", &[m], assignments.iter().map(|a| a.foreground_reference()));
    out.items("hyp.pair_idx", &[3 * proposals], pair_indices);

    let is_open = |s: &[f64; 3]| s[1] <= OPEN * s[0].max(f64::MIN_POSITIVE);
    let open: Vec<Vec<bool>> = match stored.tensors.get("hyp.degenerate") {
        Some(t) if t.values.len() == batch * proposals => {
            t.values.chunks(proposals).map(|item| item.iter().map(|&d| d != 0.0).collect()).collect()
        }
        _ => spectra.iter().map(|item| item.iter().map(is_open).collect()).collect(),
    };
    let ours_open =
        spectra.iter().map(|item| item.iter().map(|s| f64::from(u8::from(is_open(s)))).collect::<Vec<_>>());
    out.items("hyp.degenerate", &[proposals], ours_open);
    out.items("hyp.hyp_sv", &[proposals, 3], spectra.iter().map(|item| item.concat()));
    let of = |f: &dyn Fn(&Hypothesis) -> Vec<f64>| -> Vec<Vec<f64>> {
        poses.iter().map(|p| p.hypotheses.iter().flat_map(f).collect()).collect()
    };
    out.items("hyp.hyp_R", &[proposals, 3, 3], of(&|h| h.pose.rotation_row_major().to_vec()));
    out.items("hyp.hyp_t", &[proposals, 3], of(&|h| h.pose.translation.iter().copied().collect()));
    out.items("hyp.hyp_dis", &[proposals], of(&|h| vec![h.residual]));
    let determined: Vec<bool> = open.iter().flatten().map(|&o| !o).collect();
    for name in ["hyp.hyp_R", "hyp.hyp_t", "hyp.hyp_dis"] {
        out.restrict(name, &determined);
    }

    let ranked: Vec<Ranked> =
        poses.iter().enumerate().map(|(b, pose)| rank(stored, pose, &open[b], b, kept)).collect();
    out.items("hyp.topk_idx", &[kept], ranked.iter().map(|r| r.kept.clone()));
    out.items("hyp.topk_scores", &[kept], ranked.iter().map(|r| r.scores.clone()));
    let compared: Vec<bool> = ranked.iter().flat_map(|r| r.compared.clone()).collect();
    out.restrict("hyp.topk_scores", &compared);
    out.items("hyp.best", &[], ranked.iter().map(|r| [r.best]));

    out.poses("hyp.", poses.iter().map(|p| &p.pose));
    out.poses("init_", poses.iter().map(|p| &p.pose));
    out.items("hyp.score", &[], poses.iter().map(|p| [p.score]));
    out.items("init_pose_score", &[], poses.iter().map(|p| [p.score]));
    let determined: Vec<bool> = ranked.iter().map(|r| !r.winner_open).collect();
    for name in ["hyp.R", "hyp.t", "hyp.score", "hyp.best", "init_R", "init_t", "init_pose_score"] {
        out.restrict(name, &determined);
    }
    for (b, pose) in poses.iter_mut().enumerate() {
        if ranked[b].winner_open && stored.contains("init_R") {
            pose.pose = stored.pose("init_R", "init_t", b, batch)?;
        }
    }
    Ok(poses)
}

/// `uniform`, moved into the stored bin where only rounding of the distribution's boundaries puts it into another one.
fn within_stored_bin(distribution: &[f32], uniform: f32, stored: usize) -> f32 {
    let ours = distribution.partition_point(|&c| c < uniform);
    let crossed =
        &distribution[ours.min(stored).min(distribution.len())..ours.max(stored).min(distribution.len())];
    let all_near = crossed.iter().all(|c| (c - uniform).abs() <= BOUNDARY);
    match distribution.get(stored) {
        // The boundary itself is the last number of its bin, unless the bin is empty here.
        Some(&last)
            if ours != stored && all_near && distribution.partition_point(|&c| c < last) == stored =>
        {
            last
        }
        _ => uniform,
    }
}

/// Singular values of a triplet's covariance (a sum, about the means).
fn singular_values(hypothesis: &Hypothesis, query: &[[f32; 3]], reference: &[[f32; 3]]) -> [f64; 3] {
    let vector = |p: &[f32; 3]| Vector3::new(p[0] as f64, p[1] as f64, p[2] as f64);
    let points = hypothesis.pairs.map(|(i, j)| (vector(&query[i as usize]), vector(&reference[j as usize])));
    let mean =
        points.iter().fold((Vector3::zeros(), Vector3::zeros()), |m, p| (m.0 + p.0 / 3.0, m.1 + p.1 / 3.0));
    let covariance: Matrix3<f64> = points.iter().map(|(q, p)| (p - mean.1) * (q - mean.0).transpose()).sum();
    let values = covariance.singular_values();
    [values[0], values[1], values[2]]
}

/// The kept hypotheses of one pair in the stored order where that is one of the possible orders.
struct Ranked {
    kept: Vec<f64>,
    scores: Vec<f64>,
    compared: Vec<bool>,
    best: f64,
    winner_open: bool,
}

fn rank(stored: &ReferenceTensors, ours: &CoarsePose, open: &[bool], b: usize, kept: usize) -> Ranked {
    let own_open = |h: Option<&usize>| h.is_some_and(|&h| open.get(h).copied().unwrap_or(false));
    let own = Ranked {
        kept: ours.kept.iter().map(|&h| h as f64).collect(),
        scores: ours.kept_scores.clone(),
        compared: ours.kept.iter().map(|h| !own_open(Some(h))).collect(),
        best: ours.best.map_or(0.0, |best| best as f64),
        winner_open: ours.best.is_some_and(|best| own_open(ours.kept.get(best))),
    };
    let item = |name: &str, n: usize| stored.tensors.get(name).and_then(|t| t.values.get(b * n..(b + 1) * n));
    let Some(theirs) = item("hyp.topk_idx", kept) else { return own };
    let theirs: Vec<usize> = theirs.iter().map(|&h| h as usize).collect();
    let residual = |h: usize| ours.hypotheses.get(h).map_or(f64::INFINITY, |h| h.residual);
    let last = ours.kept.last().map_or(f64::INFINITY, |&h| residual(h));
    let ascending = theirs.windows(2).all(|w| residual(w[0]) <= residual(w[1]) + RESIDUAL_TIE);
    let distinct = theirs.iter().collect::<std::collections::BTreeSet<_>>().len() == theirs.len();
    // An open triplet's residual is as arbitrary as its rotation.
    let any_open = theirs.iter().chain(&ours.kept).any(|h| own_open(Some(h)));
    let possible = any_open || theirs.iter().all(|&h| residual(h) <= last + RESIDUAL_TIE);
    if !(ascending || any_open) || !distinct || !possible {
        return own;
    }
    let score = |h: usize| ours.kept.iter().position(|&k| k == h).map(|k| ours.kept_scores[k]);
    let best = item("hyp.best", 1).map(|v| v[0] as usize);
    let their_winner = best.and_then(|best| theirs.get(best).copied());
    let our_winner = ours.best.and_then(|best| ours.kept.get(best).copied());
    let tied = match (their_winner.and_then(score), our_winner.and_then(score)) {
        (Some(theirs), Some(ours)) => (theirs - ours).abs() <= SCORE_TIE * ours.abs(),
        _ => false,
    };
    let position = our_winner.and_then(|h| theirs.iter().position(|&k| k == h));
    let best = if tied { best } else { position };
    Ranked {
        scores: theirs.iter().map(|&h| score(h).unwrap_or(0.0)).collect(),
        compared: theirs.iter().map(|&h| !own_open(Some(&h)) && score(h).is_some()).collect(),
        kept: theirs.iter().map(|&h| h as f64).collect(),
        best: best.map_or(own.best, |best| best as f64),
        winner_open: own_open(their_winner.as_ref()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_rounding_moves_a_number_into_the_stored_bin() {
        let distribution = [0.1, 0.3, 0.3, 0.300_004, 0.8, 1.0];
        let bin = |u: f32| distribution.partition_point(|&c| c < u);
        let moved = |u: f32, stored| bin(within_stored_bin(&distribution, u, stored));
        assert_eq!(bin(0.300_001), 3);
        // Across one boundary, in both directions, and not at all.
        assert_eq!([moved(0.300_001, 1), moved(0.099_999, 1), moved(0.2, 1)], [1, 1, 1]);
        // A narrow bin and an empty one between both.
        assert_eq!(moved(0.299_999, 4), 4);
        // An empty bin cannot be drawn; far boundaries and indices past the end are differences.
        assert_eq!([moved(0.300_001, 2), moved(0.31, 1), moved(0.2, 0), moved(0.999_999, 6)], [3, 4, 1, 5]);
    }
}
