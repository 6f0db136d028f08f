//! From evidence to a probability and reasons.

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};
use unopose_nn::checkpoint::{CheckpointError, metadata_value};

use super::{Evidence, Feature, ReasonKind, logistic_regression};

/// Key of the checkpoint's metadata.
const METADATA_KEY: &str = "calibration";
/// Share of right poses among those above the default threshold, on the pairs of the fit.
const WANTED_PRECISION: f64 = 0.9;
/// Share of the right poses that lie below the limit of what is usual.
const UNUSUAL: f64 = 0.1;

/// Which poses count as right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseCriterion {
    /// Largest rotation error up to the object's symmetries, degrees.
    pub rotation_deg: f64,
    /// Largest translation error of the object's origin, diameters.
    pub translation: f64,
}

impl PoseCriterion {
    /// 15 degrees and a tenth of the diameter.
    pub const DEFAULT: Self = Self { rotation_deg: 15.0, translation: 0.1 };
}

/// One term of the regression.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Term {
    /// What is weighed.
    pub feature: Feature,
    /// Per unit of the feature's value, not negative.
    pub weight: f64,
    /// Value that nine of ten right poses reach, and their median.
    pub usual: f64,
    /// Median of the right poses.
    pub typical: f64,
}

/// A fitted calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Log odds without any evidence.
    pub intercept: f64,
    /// One per feature.
    pub terms: Vec<Term>,
    /// Probability below which an estimate is not confident by default.
    pub threshold: f64,
    /// Which poses of the fit counted as right.
    pub right: PoseCriterion,
    /// Pairs of the fit, and the share of them that were right.
    pub pairs: usize,
    /// Share of them that was right.
    pub right_share: f64,
    /// What the pairs are.
    pub data: String,
}

/// How far an estimate can be trusted.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Confidence {
    /// That the pose is right.
    pub probability: f64,
    /// Whether the probability reaches the threshold.
    pub confident: bool,
    /// Why it does not, the most important first; empty for a confident estimate.
    pub reasons: Vec<Reason>,
}

impl Confidence {
    /// Takes back the trust in the pose for a reason that the network cannot see; the probability stays what it says.
    pub fn doubt(&mut self, kind: ReasonKind, text: String) {
        self.confident = false;
        self.reasons.insert(0, Reason { kind, text });
    }
}

/// A reason why an estimate is not confident.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Reason {
    /// For programs.
    pub kind: ReasonKind,
    /// For people: the value met and the usual one.
    pub text: String,
}

impl Calibration {
    /// Fits weights to observed estimates and whether they were right. `None` when there are too few of either outcome.
    pub fn fit(observed: &[(Evidence, bool)], right: PoseCriterion, data: &str) -> Option<Self> {
        let rights = observed.iter().filter(|(_, right)| *right).count();
        let values =
            |evidence: &Evidence| Feature::ALL.iter().map(|feature| feature.value(evidence)).collect();
        let rows: Vec<(Vec<f64>, bool)> = observed.iter().map(|(e, right)| (values(e), *right)).collect();
        let (intercept, weights) = logistic_regression(&rows)?;
        let reached = |feature: Feature, share: f64| {
            let values = observed.iter().filter(|(_, right)| *right).map(|(e, _)| feature.value(e));
            quantile(values.collect(), share)
        };
        let terms = Feature::ALL.into_iter().zip(weights);
        let term = |(feature, weight)| Term {
            feature,
            weight,
            usual: reached(feature, UNUSUAL),
            typical: reached(feature, 0.5),
        };
        let terms = terms.map(term).collect();
        let mut calibration = Self {
            intercept,
            terms,
            threshold: 0.5,
            right,
            pairs: observed.len(),
            right_share: rights as f64 / observed.len().max(1) as f64,
            data: data.to_owned(),
        };
        calibration.threshold = calibration.precise_threshold(observed);
        Some(calibration)
    }

    /// Probability that the estimate is right.
    pub fn probability(&self, evidence: &Evidence) -> f64 {
        let sum: f64 = self.terms.iter().map(|t| t.weight * t.feature.value(evidence)).sum();
        1.0 / (1.0 + (-(self.intercept + sum)).exp())
    }

    /// Probability, and reasons where it is below `threshold`.
    pub fn judge(&self, evidence: &Evidence, threshold: f64) -> Confidence {
        let probability = self.probability(evidence);
        let confident = probability >= threshold;
        Confidence {
            probability,
            confident,
            reasons: if confident { Vec::new() } else { self.reasons(evidence) },
        }
    }

    /// One reason per kind whose evidence nine of ten right poses exceed, the most unusual first; the most unusual
    /// of all when there is none.
    fn reasons(&self, evidence: &Evidence) -> Vec<Reason> {
        // 0 at the median of the right poses, 1 where nine of ten are better.
        let unusual = |term: &Term| {
            (term.typical - term.feature.value(evidence)) / (term.typical - term.usual).max(1e-6)
        };
        let mut terms: Vec<(f64, &Term)> = self.terms.iter().map(|term| (unusual(term), term)).collect();
        terms.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut reasons: Vec<Reason> = Vec::new();
        for (unusual, term) in terms {
            let kind = term.feature.reason();
            if reasons.is_empty() || (unusual > 1.0 && reasons.iter().all(|reason| reason.kind != kind)) {
                let value = term.feature.value(evidence);
                reasons.push(Reason { kind, text: term.feature.explain(value, term.typical) });
            }
        }
        reasons
    }

    /// The smallest probability above which the wanted share was right; 0.5 when no probability is that precise.
    fn precise_threshold(&self, observed: &[(Evidence, bool)]) -> f64 {
        let mut judged: Vec<(f64, bool)> =
            observed.iter().map(|(evidence, right)| (self.probability(evidence), *right)).collect();
        judged.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut right, mut threshold) = (0, None);
        for (count, (probability, is_right)) in (1..).zip(judged) {
            right += usize::from(is_right);
            if right as f64 >= WANTED_PRECISION * f64::from(count) {
                threshold = Some(probability);
            }
        }
        // Two digits are all that some hundred pairs tell.
        threshold.map_or(0.5, |t| (100.0 * t).round() / 100.0)
    }

    /// The entry of a checkpoint's metadata.
    pub fn to_metadata(&self) -> (String, String) {
        (METADATA_KEY.into(), serde_json::to_string(self).unwrap_or_default())
    }

    /// From a checkpoint's metadata; `None` when it has no calibration.
    pub fn from_metadata(
        metadata: &BTreeMap<String, String>,
        path: &Path,
    ) -> Result<Option<Self>, CheckpointError> {
        metadata_value(metadata, METADATA_KEY, path, "a calibration")
    }
}

fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let rank = (values.len().saturating_sub(1) as f64 * share).round() as usize;
    values.get(rank).copied().unwrap_or(0.0)
}
