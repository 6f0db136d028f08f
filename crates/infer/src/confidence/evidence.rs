//! What speaks for an estimated pose, and how it is put into words.

use serde::{Deserialize, Serialize};
use unopose_core::geometry::FinePose;

/// Observations of one estimate; lengths in radii of the reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// The score: share of the query's points that are matched and lie on the reference.
    pub fit: f64,
    /// Mean predicted overlap of the query's and the reference's points.
    pub overlap_query: f64,
    /// Mean predicted overlap of the reference's points.
    pub overlap_reference: f64,
    /// Share of the query's points matched to a reference point.
    pub matched: f64,
    /// Mean assigned weight of the query's points: how decided the fine matching is.
    pub mass: f64,
    /// Root mean squared distance of the weighted matches under the pose.
    pub residual: f64,
    /// Score of the coarse hypothesis.
    pub coarse_score: f64,
    /// Score of the best hypothesis that is turned by more than 30 degrees, in shares of the winner's.
    pub rival: f64,
    /// Turn of the fine stage, degrees.
    pub agreement_deg: f64,
    /// Pixels of the query's mask that have depth.
    pub points: usize,
    /// Agreement of the colours of the surface that both views see, in [-1, 1].
    #[serde(default)]
    pub color: f64,
    /// Share of both surfaces that would lie in space that a camera sees through.
    #[serde(default)]
    pub in_front: f64,
    /// Score of the best result from another start that is turned by more than 30 degrees, in shares of the winner's.
    #[serde(default)]
    pub runner_up: f64,
}

/// One kind of evidence as the calibration weighs it: higher speaks for the pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// [`Evidence::fit`].
    Fit,
    /// [`Evidence::overlap_query`].
    OverlapQuery,
    /// [`Evidence::overlap_reference`].
    OverlapReference,
    /// [`Evidence::matched`].
    Matched,
    /// Logarithm of [`Evidence::mass`].
    Mass,
    /// Minus the logarithm of [`Evidence::residual`].
    Residual,
    /// Logarithm of [`Evidence::coarse_score`].
    CoarseScore,
    /// Minus [`Evidence::rival`].
    Rival,
    /// Minus the logarithm of [`Evidence::agreement_deg`].
    Agreement,
    /// Logarithm of [`Evidence::points`].
    Points,
    /// [`Evidence::color`].
    Color,
    /// Minus [`Evidence::in_front`].
    FreeSpace,
    /// Minus [`Evidence::runner_up`].
    RunnerUp,
}

/// Kinds of reasons why an estimate is not confident.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ReasonKind {
    /// The mask holds few measured pixels.
    FewPoints,
    /// The views show different sides.
    LowOverlap,
    /// Another rotation explains the matches nearly as well.
    Ambiguous,
    /// The matches disagree with the pose or with each other.
    PoorFit,
    /// The unit of depth is probably another one, so the pose is at the wrong distance.
    DoubtfulUnit,
}

/// Weights and distances of the fine matches.
pub(crate) struct Support {
    pub mass: f64,
    pub residual: f64,
}

impl Support {
    /// Without a fine stage.
    pub const NONE: Self = Self { mass: 0.0, residual: 1.0 };

    /// Of the fine stage's solution for the query's `points`.
    pub fn of(solved: &FinePose, points: &[[f32; 3]]) -> Self {
        let (mut total, mut squares) = (0.0, 0.0);
        for ((&weight, predicted), q) in solved.weights.iter().zip(&solved.predicted).zip(points) {
            let p = solved.pose.transform_f32(predicted);
            total += f64::from(weight);
            squares += f64::from(weight) * (0..3).map(|i| f64::from(p[i] - q[i]).powi(2)).sum::<f64>();
        }
        if total < 1e-6 {
            return Self::NONE;
        }
        Self { mass: total / points.len().max(1) as f64, residual: (squares / total).sqrt() }
    }
}

impl Feature {
    /// In the order of the fit.
    pub const ALL: [Self; 13] = [
        Self::Fit,
        Self::OverlapQuery,
        Self::OverlapReference,
        Self::Matched,
        Self::Mass,
        Self::Residual,
        Self::CoarseScore,
        Self::Rival,
        Self::Agreement,
        Self::Points,
        Self::Color,
        Self::FreeSpace,
        Self::RunnerUp,
    ];

    /// The number that is weighed: quantities that span decades by their logarithm.
    pub fn value(self, evidence: &Evidence) -> f64 {
        match self {
            Self::Fit => evidence.fit,
            Self::OverlapQuery => evidence.overlap_query,
            Self::OverlapReference => evidence.overlap_reference,
            Self::Matched => evidence.matched,
            Self::Mass => evidence.mass.max(1e-4).ln(),
            Self::Residual => -evidence.residual.max(1e-4).ln(),
            Self::CoarseScore => evidence.coarse_score.max(1e-4).ln(),
            Self::Rival => -evidence.rival,
            Self::Agreement => -evidence.agreement_deg.max(1.0).ln(),
            Self::Points => (evidence.points.max(1) as f64).ln(),
            Self::Color => evidence.color,
            Self::FreeSpace => -evidence.in_front,
            Self::RunnerUp => -evidence.runner_up,
        }
    }

    /// What a low value means.
    pub fn reason(self) -> ReasonKind {
        match self {
            Self::Points => ReasonKind::FewPoints,
            Self::OverlapQuery | Self::OverlapReference | Self::Matched => ReasonKind::LowOverlap,
            Self::Rival | Self::RunnerUp => ReasonKind::Ambiguous,
            Self::Fit
            | Self::Mass
            | Self::Residual
            | Self::CoarseScore
            | Self::Agreement
            | Self::Color
            | Self::FreeSpace => ReasonKind::PoorFit,
        }
    }

    /// A sentence about a value and the median of right poses (both as [`Self::value`] gives them).
    pub fn explain(self, value: f64, typical: f64) -> String {
        let percent = |x: f64| format!("{:.0} %", 100.0 * x);
        match self {
            Self::Points => format!(
                "few points: {:.0} pixels of the mask have depth, {:.0} are typical",
                value.exp(),
                typical.exp()
            ),
            Self::OverlapQuery => format!(
                "low overlap: the reference shows {} of the query, {} are typical",
                percent(value),
                percent(typical)
            ),
            Self::OverlapReference => format!(
                "low overlap: the query shows {} of the reference, {} are typical",
                percent(value),
                percent(typical)
            ),
            Self::Matched => format!(
                "low overlap: {} of the query's points are matched, {} are typical",
                percent(value),
                percent(typical)
            ),
            Self::Rival => format!(
                "ambiguous: another rotation scores {} of this one, {} are typical",
                percent(-value),
                percent(-typical)
            ),
            Self::RunnerUp => format!(
                "ambiguous: a refined pose with another rotation scores {} of this one, {} are typical",
                percent(-value),
                percent(-typical)
            ),
            Self::Color => {
                format!("poor fit: the colours agree by {value:.2}, {typical:.2} is typical")
            }
            Self::FreeSpace => format!(
                "poor fit: {} of the surface would lie in front of what the cameras see, {} are typical",
                percent(-value),
                percent(-typical)
            ),
            Self::Fit => {
                format!("poor fit: {} of the points fit, {} are typical", percent(value), percent(typical))
            }
            Self::Mass => format!(
                "poor fit: the matches are undecided (mean weight {:.3}, {:.3} is typical)",
                value.exp(),
                typical.exp()
            ),
            Self::Residual => format!(
                "poor fit: the matches disagree by {:.2} radii, {:.2} are typical",
                (-value).exp(),
                (-typical).exp()
            ),
            Self::CoarseScore => format!(
                "poor fit: the best hypothesis scores {:.3}, {:.3} is typical",
                value.exp(),
                typical.exp()
            ),
            Self::Agreement => format!(
                "poor fit: the fine stage turned the coarse pose by {:.0} degrees, {:.0} are typical",
                (-value).exp(),
                (-typical).exp()
            ),
        }
    }
}
