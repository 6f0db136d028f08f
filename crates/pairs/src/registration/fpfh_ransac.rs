//! FPFH + RANSAC: poses from three matches of features, counted by the matches that agree (Fischler, Bolles 1981; the
//! checks and the early end as in Open3D's registration by feature matching).

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::geometry::{Pose, weighted_procrustes};

use super::{
    CloudRegistration, RegistrationError,
    feature_pair::{FeaturePair, InlierTest, Match},
};

/// Constants of the sampling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FpfhRansac {
    /// Cells along the reference's extent.
    pub cells: f64,
    /// Most similar features that every point is matched with.
    pub nearest: usize,
    /// Most samples that are drawn.
    pub iterations: usize,
    /// Sides of a triangle of matches may differ by this factor.
    pub edge_similarity: f32,
    /// Distance, in cells, below which a match agrees with a pose.
    pub inlier_cells: f32,
    /// Probability of having met a sample without outliers at which the iterations end.
    pub confidence: f64,
    /// Poses with the most agreeing matches of which that with the best surface fit is taken.
    pub verified: usize,
    /// Seed of the samples.
    pub seed: u64,
}

impl Default for FpfhRansac {
    fn default() -> Self {
        Self {
            cells: 20.0,
            nearest: 3,
            iterations: 100_000,
            edge_similarity: 0.85,
            inlier_cells: 1.5,
            confidence: 0.999,
            verified: 100,
            seed: 0,
        }
    }
}

/// Fewest matches that agree with an accepted pose: one more than make it.
const MIN_INLIERS: usize = 4;

impl CloudRegistration for FpfhRansac {
    fn name(&self) -> &'static str {
        "fpfh-ransac"
    }

    fn fingerprint(&self) -> String {
        format!("{self:?}")
    }

    fn register(&self, query: &[[f32; 3]], reference: &[[f32; 3]]) -> Result<(Pose, f64), RegistrationError> {
        let pair = FeaturePair::new(query, reference, self.cells, self.nearest)?;
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let limit = self.inlier_cells * pair.cell;
        let mut best: Vec<(usize, Pose)> = Vec::new();
        let mut iterations = self.iterations;
        let mut done = 0;
        while done < iterations {
            done += 1;
            let sample = draw_three(&pair.matches, &mut rng);
            if !self.edge_lengths_agree(&sample) {
                continue;
            }
            let pose = pose_of(&sample);
            let test = InlierTest::new(&pose);
            if !sample.iter().all(|m| test.is_inlier(m, limit)) {
                continue;
            }
            let inliers = pair.matches.iter().filter(|m| test.is_inlier(m, limit)).count();
            if inliers >= MIN_INLIERS
                && (best.len() < self.verified || best.last().is_some_and(|b| inliers > b.0))
            {
                if best.first().is_none_or(|b| inliers > b.0) {
                    iterations =
                        iterations.min(self.required_iterations(inliers as f64 / pair.matches.len() as f64));
                }
                let place = best.partition_point(|b| b.0 >= inliers);
                best.insert(place, (inliers, pose));
                best.truncate(self.verified);
            }
        }
        if best.is_empty() {
            return Err(RegistrationError::NoConsensus { inliers: 3, minimum: MIN_INLIERS });
        }
        let refitted = best.into_iter().map(|(_, pose)| refit(&pair.matches, pose, limit));
        let scored = refitted.map(|pose| (pair.fitness(&pose), pose));
        let best = scored.max_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(fit, pose)| (pose, fit))
            .ok_or(RegistrationError::NoConsensus { inliers: 0, minimum: MIN_INLIERS })
    }
}

impl FpfhRansac {
    fn edge_lengths_agree(&self, sample: &[Match; 3]) -> bool {
        let squared = |a: [f32; 3], b: [f32; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>();
        let similarity = self.edge_similarity * self.edge_similarity;
        [(0, 1), (1, 2), (2, 0)].iter().all(|&(i, j)| {
            let query = squared(sample[i].query, sample[j].query);
            let reference = squared(sample[i].reference, sample[j].reference);
            query > 0.0 && query >= similarity * reference && reference >= similarity * query
        })
    }

    /// Samples after which one without outliers was met with the wanted confidence.
    fn required_iterations(&self, inlier_share: f64) -> usize {
        let miss = (1.0 - inlier_share.powi(3)).ln();
        if miss < 0.0 { ((1.0 - self.confidence).ln() / miss).ceil() as usize } else { usize::MAX }
    }
}

/// Three matches, the same one perhaps twice.
fn draw_three(matches: &[Match], rng: &mut impl Rng) -> [Match; 3] {
    std::array::from_fn(|_| matches[rng.random_range(0..matches.len())])
}

/// Reference to query camera from matched points.
pub(super) fn pose_of(matches: &[Match]) -> Pose {
    let (reference, query): (Vec<[f32; 3]>, Vec<[f32; 3]>) =
        matches.iter().map(|m| (m.reference, m.query)).unzip();
    weighted_procrustes(&reference, &query, None, 0.0)
}

/// Least squares over the agreeing matches, twice.
pub(super) fn refit(matches: &[Match], mut pose: Pose, limit: f32) -> Pose {
    for _ in 0..2 {
        let test = InlierTest::new(&pose);
        let agreeing: Vec<Match> = matches.iter().copied().filter(|m| test.is_inlier(m, limit)).collect();
        if agreeing.len() < 3 {
            break;
        }
        pose = pose_of(&agreeing);
    }
    pose
}
