//! Which of several poses of a pair is the right one.

use unopose_core::{
    config::HypothesisConfig,
    geometry::{MutualFit, Pose},
};
use unopose_pairs::{
    appearance::{Agreement, AppearanceView, Detail},
    data::{metric_pose, normalised_pose},
};

use super::{CloudPair, PairEstimate, trace::APART_DEG};

/// Distance along the optical axis up to which a point lies on a surface, in radii of the object.
const ON_SURFACE: f32 = 0.1;

/// Scores poses of one pair by shape, free space and colours.
pub(super) struct Judge<'a> {
    pair: CloudPair<'a>,
    fit: MutualFit<'a>,
    /// Query and reference, where the configuration asks for them.
    views: Option<[&'a AppearanceView; 2]>,
    color_weight: f64,
    free_space_weight: f64,
}

/// What speaks for a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judged {
    /// Above 0: [`MutualFit::score`] times what the views say.
    pub score: f64,
    /// Zeros without views.
    pub agreement: Agreement,
}

impl<'a> Judge<'a> {
    /// For poses of `pair`.
    pub fn new(pair: &CloudPair<'a>, config: &HypothesisConfig) -> Self {
        let views = pair.query.view.as_ref().zip(pair.reference.view.as_ref());
        Self {
            pair: *pair,
            fit: MutualFit::new(&pair.query.points, &pair.reference.points),
            views: views.filter(|_| config.uses_appearance()).map(|(query, reference)| [query, reference]),
            color_weight: config.color_weight.into(),
            free_space_weight: config.free_space_weight.into(),
        }
    }

    /// Score of a pose between the matching frames.
    pub fn score(&self, pose: &Pose, detail: Detail) -> f64 {
        let CloudPair { query, reference, radius } = self.pair;
        let metric = metric_pose(pose, query.center, reference.center, radius);
        self.combined(pose, &metric, detail).score
    }

    /// A final pose between the cameras, metres.
    pub fn judge(&self, metric: &Pose) -> Judged {
        let CloudPair { query, reference, radius } = self.pair;
        let pose = normalised_pose(metric, query.center, reference.center, radius);
        self.combined(&pose, metric, Detail::Fine)
    }

    fn combined(&self, pose: &Pose, metric: &Pose, detail: Detail) -> Judged {
        let fit = self.fit.score(pose);
        let Some([query, reference]) = self.views else {
            return Judged { score: fit, agreement: Agreement::default() };
        };
        let tolerance = ON_SURFACE * self.pair.radius;
        let agreement = Agreement::of(query, reference, metric, tolerance, detail);
        let exponent = self.color_weight * agreement.color - self.free_space_weight * agreement.in_front;
        Judged { score: fit * exponent.exp(), agreement }
    }
}

/// A result of the fine stage, refined and judged.
pub(super) struct Candidate {
    pub pair: PairEstimate,
    /// Reference to query camera, metres.
    pub pose: Pose,
    pub judged: Judged,
}

impl Candidate {
    /// Score of the best of the others that are turned against this one, in shares of its own; 0 without any.
    pub fn runner_up(&self, all: &[Self]) -> f64 {
        let apart = all.iter().filter(|other| other.pose.rotation_angle_deg(&self.pose) > APART_DEG);
        let best = apart.map(|other| other.judged.score).fold(0.0, f64::max);
        (best / self.judged.score.max(1e-12)).min(1.0)
    }
}
