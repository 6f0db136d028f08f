//! Which of several poses of a pair is the right one.

use unopose_core::{
    config::HypothesisConfig,
    geometry::{MutualFit, Pose},
};
use unopose_pairs::{
    appearance::{Agreement, AppearanceView, Detail},
    data::{metric_pose, normalised_pose},
};

use super::{CloudPair, PairEstimate, point_features::FeatureAgreement};

/// Distance along the optical axis up to which a point lies on a surface, in radii of the object.
const ON_SURFACE: f32 = 0.1;
/// Angle between two turns of a pose that are both refined, degrees.
const TURNS_APART_DEG: f64 = 8.0;

/// Exponent of the mutual fit, and factor of the weights of colours and features, for a body of revolution.
const FIT_WEIGHT_OF_REVOLUTION: f64 = 0.3;
const COLOR_WEIGHT_OF_REVOLUTION: f64 = 2.0;

/// Scores poses of one pair by shape, free space and colours.
pub(super) struct Judge<'a> {
    pair: CloudPair<'a>,
    fit: MutualFit<'a>,
    /// Query and reference, where the configuration asks for them.
    views: Option<[&'a AppearanceView; 2]>,
    /// Of the colour encoder, where the configuration asks for it.
    features: Option<FeatureAgreement<'a>>,
    /// Exponent of [`MutualFit::score`].
    fit_weight: f64,
    color_weight: f64,
    feature_weight: f64,
    free_space_weight: f64,
}

/// What speaks for a pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Judged {
    /// Above 0: [`MutualFit::score`] times what the views say.
    pub score: f64,
    /// What free space and colours say alone, its second factor.
    pub views: f64,
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
            features: None,
            fit_weight: 1.0,
            feature_weight: config.feature_weight.into(),
            color_weight: config.color_weight.into(),
            free_space_weight: config.free_space_weight.into(),
        }
    }

    /// For a body of revolution. Its turns fit equally well; that they hide some of its surface from the other view makes none
    /// of them less likely.
    pub fn of_revolution(self) -> Self {
        Self {
            fit_weight: FIT_WEIGHT_OF_REVOLUTION,
            color_weight: COLOR_WEIGHT_OF_REVOLUTION * self.color_weight,
            feature_weight: COLOR_WEIGHT_OF_REVOLUTION * self.feature_weight,
            ..self
        }
    }

    /// With the colour encoder's features of both clouds.
    pub fn with_features(self, features: Option<FeatureAgreement<'a>>) -> Self {
        Self { features, ..self }
    }

    /// Score of a pose between the matching frames.
    pub fn score(&self, pose: &Pose, detail: Detail) -> f64 {
        let CloudPair { query, reference, radius } = self.pair;
        let metric = metric_pose(pose, query.center, reference.center, radius);
        self.combined(pose, &metric, detail).score
    }

    /// A pose between the cameras, metres.
    pub fn judge(&self, metric: &Pose, detail: Detail) -> Judged {
        self.combined(&self.normalised(metric), metric, detail)
    }

    /// The best scored of `pose` after each of `motions` (of the reference camera's frame), at most `count`, turned against
    /// `pose` and each other.
    pub fn turned(&self, pose: &Pose, motions: &[Pose], count: usize) -> Vec<Pose> {
        let scored = |motion: &Pose| {
            let turned = *pose * *motion;
            (self.judge(&turned, Detail::Blurred).score, turned)
        };
        let mut turned: Vec<(f64, Pose)> = motions.iter().map(scored).collect();
        turned.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut best: Vec<Pose> = Vec::new();
        for (_, turned) in turned {
            if best.len() >= count {
                break;
            }
            if [pose]
                .into_iter()
                .chain(&best)
                .all(|other| other.rotation_angle_deg(&turned) > TURNS_APART_DEG)
            {
                best.push(turned);
            }
        }
        best
    }

    fn normalised(&self, metric: &Pose) -> Pose {
        let CloudPair { query, reference, radius } = self.pair;
        normalised_pose(metric, query.center, reference.center, radius)
    }

    fn agreement(&self, metric: &Pose, detail: Detail) -> Agreement {
        let tolerance = ON_SURFACE * self.pair.radius;
        self.views.map_or_else(Agreement::default, |[query, reference]| {
            Agreement::of(query, reference, metric, tolerance, detail)
        })
    }

    fn combined(&self, pose: &Pose, metric: &Pose, detail: Detail) -> Judged {
        let agreement = self.agreement(metric, detail);
        let features = self.features.as_ref().map_or(0.0, |features| features.of(pose));
        let exponent = self.color_weight * agreement.color + self.feature_weight * features
            - self.free_space_weight * agreement.in_front;
        let (fit, views) = (self.fit.score(pose).powf(self.fit_weight), exponent.exp());
        Judged { score: fit * views, views, agreement }
    }
}

/// A pose that may be the answer, refined and judged.
pub(super) struct Candidate {
    pub pair: PairEstimate,
    /// Reference to query camera, metres.
    pub pose: Pose,
    pub judged: Judged,
}

impl Candidate {
    /// Index of the best judged of at least one.
    pub fn best(all: &[Self]) -> usize {
        (1..all.len()).fold(0, |best, i| if all[i].judged.score > all[best].judged.score { i } else { best })
    }
}
