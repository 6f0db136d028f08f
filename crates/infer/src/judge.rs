//! Which of several poses of a pair is the right one.

use unopose_core::{
    config::HypothesisConfig,
    geometry::{MutualFit, Pose},
};
use unopose_pairs::{
    appearance::{Agreement, AppearanceView, Detail},
    data::metric_pose,
};

use super::CloudPair;

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

    /// Score of a pose between the matching frames, above 0: [`MutualFit::score`] times what the views say.
    pub fn score(&self, pose: &Pose, detail: Detail) -> f64 {
        let fit = self.fit.score(pose);
        let Some([query, reference]) = self.views else { return fit };
        let CloudPair { query: q, reference: r, radius } = self.pair;
        let pose = metric_pose(pose, q.center, r.center, radius);
        let agreement = Agreement::of(query, reference, &pose, ON_SURFACE * radius, detail);
        fit * (self.color_weight * agreement.color - self.free_space_weight * agreement.in_front).exp()
    }
}
