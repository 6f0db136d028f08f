//! FPFH + MAC: poses from the maximal cliques of the graph of compatible matches (Zhang, Yang, Zhang, Zhang: "3D
//! Registration with Maximal Cliques", CVPR 2023).

mod cliques;
mod graph;

use super::{
    CloudRegistration, RegistrationError,
    feature_pair::{FeaturePair, InlierTest, Match},
    fpfh_ransac::{pose_of, refit},
};
use cliques::{Limits, heaviest_cliques};
use graph::CompatibilityGraph;
use unopose_core::geometry::Pose;

/// Constants of the graph and the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FpfhMac {
    /// Cells along the reference's extent.
    pub cells: f64,
    /// Matches that enter the graph, those with the most similar features.
    pub matches: usize,
    /// Width of the compatibility score, in cells (the paper's d_cmp).
    pub compatibility_cells: f32,
    /// Compatibility below which two matches are not joined (the paper's t_cmp).
    pub compatibility: f32,
    /// Steps of the clique search.
    pub steps: usize,
    /// Hypotheses that are evaluated, those of the heaviest cliques.
    pub hypotheses: usize,
    /// Distance, in cells, below which a match agrees with a pose.
    pub inlier_cells: f32,
}

impl Default for FpfhMac {
    fn default() -> Self {
        Self {
            cells: 17.0,
            matches: 700,
            compatibility_cells: 10.0,
            compatibility: 0.98,
            steps: 60_000,
            hypotheses: 300,
            inlier_cells: 1.5,
        }
    }
}

impl CloudRegistration for FpfhMac {
    fn name(&self) -> &'static str {
        "fpfh-mac"
    }

    fn fingerprint(&self) -> String {
        format!("{self:?}")
    }

    fn register(&self, query: &[[f32; 3]], reference: &[[f32; 3]]) -> Result<(Pose, f64), RegistrationError> {
        let pair = FeaturePair::new(query, reference, self.cells, 1)?;
        let matches = &pair.matches[..pair.matches.len().min(self.matches)];
        let width = self.compatibility_cells * pair.cell;
        let graph = CompatibilityGraph::new(matches, width, self.compatibility);
        let limits = Limits { steps: self.steps, cliques: self.hypotheses };
        let limit = self.inlier_cells * pair.cell;
        let hypotheses = heaviest_cliques(&graph, limits).into_iter().map(|clique| {
            let members: Vec<Match> = clique.into_iter().map(|i| matches[i]).collect();
            let pose = pose_of(&members);
            (agreement(matches, &pose, limit), pose)
        });
        let Some((_, pose)) = hypotheses.max_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Err(RegistrationError::NoConsensus { inliers: 0, minimum: cliques::MIN_SIZE });
        };
        let pose = refit(matches, pose, limit);
        Ok((pose, pair.fitness(&pose)))
    }
}

/// Mean absolute error criterion (Zhang et al., section 3.4): every match that agrees counts the more the nearer it is.
fn agreement(matches: &[Match], t_query_reference: &Pose, limit: f32) -> f32 {
    let test = InlierTest::new(t_query_reference);
    let agreeing = matches.iter().filter(|m| test.is_inlier(m, limit));
    agreeing.map(|m| 1.0 - test.squared_distance(m).sqrt() / limit).sum()
}
