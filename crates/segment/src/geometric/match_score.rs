//! The probability that a proposal is the object of a reference, fitted to proposals whose truth is known.

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};
use unopose_infer::{Evidence, Feature, logistic_regression};
use unopose_nn::checkpoint::{CheckpointError, metadata_value};

/// Key of the checkpoint's metadata.
const METADATA_KEY: &str = "match_score";
/// A proposal is right when it overlaps the object's visible mask at least so much.
pub const RIGHT_IOU: f64 = 0.5;
/// Share of the found objects whose best proposal reaches the threshold.
const KEPT: f64 = 0.95;
/// Logarithms go no lower: nothing is impossible.
const LOWEST_LOG: f64 = -8.0;

/// What speaks for a proposal being the object of a reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MatchEvidence {
    /// Likeness of the sizes in metres, in [0, 1].
    pub size: f64,
    /// Bhattacharyya coefficient of the colour histograms, in [0, 1].
    pub histogram: f64,
    /// Cosine of the mean features of the colour encoder.
    pub appearance: f64,
    /// Share of the posed reference's points that lie on the measured surface, of those that are not hidden.
    pub surface: f64,
    /// Share of the points on the surface that are inside the mask.
    pub inside: f64,
    /// Share of the mask that the posed reference covers.
    pub covered: f64,
    /// Likeness of the colours of the points on the surface, in [0, 1].
    pub color: f64,
    /// Score of the proposal as an object of any kind, in [0, 1].
    pub proposal: f64,
    /// Of the pose.
    pub pose: Evidence,
}

/// One kind of evidence as the regression weighs it: higher speaks for the match.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MatchFeature {
    /// Logarithm of [`MatchEvidence::size`].
    Size,
    /// [`MatchEvidence::histogram`].
    Histogram,
    /// [`MatchEvidence::appearance`].
    Appearance,
    /// [`MatchEvidence::surface`].
    Surface,
    /// [`MatchEvidence::inside`].
    Inside,
    /// [`MatchEvidence::covered`].
    Covered,
    /// [`MatchEvidence::color`].
    Color,
    /// [`MatchEvidence::proposal`].
    Proposal,
    /// Of [`MatchEvidence::pose`].
    Pose(Feature),
}

impl MatchFeature {
    /// All of them, in a fixed order.
    pub fn all() -> impl Iterator<Item = Self> {
        let own = [
            Self::Size,
            Self::Histogram,
            Self::Appearance,
            Self::Surface,
            Self::Inside,
            Self::Covered,
            Self::Color,
            Self::Proposal,
        ];
        own.into_iter().chain(Feature::ALL.into_iter().map(Self::Pose))
    }

    /// Its value.
    pub fn value(self, evidence: &MatchEvidence) -> f64 {
        match self {
            Self::Size => evidence.size.ln().max(LOWEST_LOG),
            Self::Histogram => evidence.histogram,
            Self::Appearance => evidence.appearance,
            Self::Surface => evidence.surface,
            Self::Inside => evidence.inside,
            Self::Covered => evidence.covered,
            Self::Color => evidence.color,
            Self::Proposal => evidence.proposal,
            Self::Pose(feature) => feature.value(&evidence.pose),
        }
    }
}

/// A proposal that was given a pose, and the truth about it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObservedMatch {
    /// Which image was searched for which object: equal for the proposals that compete.
    pub search: usize,
    /// Whether the image shows the object at all.
    pub present: bool,
    /// Overlap with the object's visible mask, 0 where the image does not show it.
    pub iou: f64,
    /// What speaks for the proposal.
    pub evidence: MatchEvidence,
}

/// A fitted score.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchScore {
    /// Log odds without any evidence.
    pub intercept: f64,
    /// Weight per unit of each feature, not negative.
    pub weights: Vec<(MatchFeature, f64)>,
    /// Probability below which an object is not there.
    pub threshold: f64,
    /// Proposals of the fit.
    pub proposals: usize,
    /// Images searched for an object that they show, and for one that they do not.
    pub searches: [usize; 2],
    /// What the images are.
    pub data: String,
}

/// How well a score tells objects that are there from objects that are not.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct PresenceReport {
    /// Objects that are there.
    pub present: usize,
    /// Of them, those whose best scored proposal is right.
    pub found: f64,
    /// Of the found ones, those whose score reaches the threshold.
    pub kept: f64,
    /// Objects that are not there.
    pub absent: usize,
    /// Of them, those that are reported all the same.
    pub invented: f64,
    /// For each threshold 0, 0.01, ... 1: (share of the found objects kept, share of the absent ones reported).
    pub curve: Vec<[f64; 2]>,
}

impl MatchScore {
    /// Fits weights to observed proposals. `None` with too few right or wrong ones.
    pub fn fit(observed: &[ObservedMatch], data: &str) -> Option<Self> {
        let values = |evidence: &MatchEvidence| MatchFeature::all().map(|f| f.value(evidence)).collect();
        let rows: Vec<(Vec<f64>, bool)> =
            observed.iter().map(|o| (values(&o.evidence), o.iou >= RIGHT_IOU)).collect();
        let (intercept, weights) = logistic_regression(&rows)?;
        let searches = |present: bool| searches(observed, present).len();
        let mut score = Self {
            intercept,
            weights: MatchFeature::all().zip(weights).filter(|(_, weight)| *weight > 0.0).collect(),
            threshold: 0.0,
            proposals: observed.len(),
            searches: [searches(true), searches(false)],
            data: data.to_owned(),
        };
        let mut found = score.best_probabilities(observed, true);
        found.retain(|(_, right)| *right);
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let last = ((found.len() as f64 * KEPT).ceil() as usize).clamp(1, found.len().max(1)) - 1;
        // Two digits are all that some hundred searches tell.
        score.threshold = found.get(last).map_or(0.5, |(p, _)| (100.0 * p).floor() / 100.0);
        Some(score)
    }

    /// Probability that the proposal is the object.
    pub fn probability(&self, evidence: &MatchEvidence) -> f64 {
        let sum: f64 = self.weights.iter().map(|(feature, weight)| weight * feature.value(evidence)).sum();
        1.0 / (1.0 + (-(self.intercept + sum)).exp())
    }

    /// How the score does on proposals with their truth.
    pub fn presence(&self, observed: &[ObservedMatch]) -> PresenceReport {
        let present = self.best_probabilities(observed, true);
        let absent = self.best_probabilities(observed, false);
        let found: Vec<f64> = present.iter().filter(|(_, right)| *right).map(|(p, _)| *p).collect();
        let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
        let at = |threshold: f64| {
            [
                share(found.iter().filter(|p| **p >= threshold).count(), found.len()),
                share(absent.iter().filter(|(p, _)| *p >= threshold).count(), absent.len()),
            ]
        };
        let [kept, invented] = at(self.threshold);
        PresenceReport {
            present: present.len(),
            found: share(found.len(), present.len()),
            kept,
            absent: absent.len(),
            invented,
            curve: (0..=100).map(|i| at(f64::from(i) / 100.0)).collect(),
        }
    }

    /// Highest probability of each search, and whether its proposal is right.
    fn best_probabilities(&self, observed: &[ObservedMatch], present: bool) -> Vec<(f64, bool)> {
        let highest = searches(observed, present).into_values().filter_map(|proposals| {
            let judged = proposals.into_iter().map(|o| (self.probability(&o.evidence), o.iou >= RIGHT_IOU));
            judged.max_by(|a, b| a.0.total_cmp(&b.0))
        });
        highest.collect()
    }

    /// The entry of a checkpoint's metadata.
    pub fn to_metadata(&self) -> (String, String) {
        (METADATA_KEY.into(), serde_json::to_string(self).unwrap_or_default())
    }

    /// From a checkpoint's metadata; `None` when it has none.
    pub fn from_metadata(
        metadata: &BTreeMap<String, String>,
        path: &Path,
    ) -> Result<Option<Self>, CheckpointError> {
        metadata_value(metadata, METADATA_KEY, path, "a score of matches")
    }
}

/// The competing proposals of each search for an object that is there, or for one that is not.
fn searches(observed: &[ObservedMatch], present: bool) -> BTreeMap<usize, Vec<&ObservedMatch>> {
    let mut searches: BTreeMap<usize, Vec<&ObservedMatch>> = BTreeMap::new();
    for one in observed.iter().filter(|o| o.present == present) {
        searches.entry(one.search).or_default().push(one);
    }
    searches
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Searches with four proposals each, of which the first is right in every second search; right ones have better surfaces
    /// and colours, the histogram says nothing.
    fn observed(searches: usize, seed: u64) -> Vec<ObservedMatch> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut all = Vec::new();
        for search in 0..searches {
            let present = search % 2 == 0;
            for proposal in 0..4 {
                let right = present && proposal == 0;
                let level = if right { 0.8 } else { 0.4 };
                let evidence = MatchEvidence {
                    size: 0.9,
                    surface: level + rng.random_range(-0.25..0.25),
                    color: level + rng.random_range(-0.25..0.25),
                    histogram: rng.random(),
                    ..MatchEvidence::default()
                };
                let iou = if right { 0.9 } else { 0.1 };
                all.push(ObservedMatch { search, present, iou, evidence });
            }
        }
        all
    }

    #[test]
    fn the_fit_finds_what_counts_and_keeps_nineteen_of_twenty() {
        let score = MatchScore::fit(&observed(400, 1), "made").unwrap();
        let weight = |feature| score.weights.iter().find(|(f, _)| *f == feature).map_or(0.0, |(_, w)| *w);
        assert!(weight(MatchFeature::Surface) > 5.0 && weight(MatchFeature::Color) > 5.0, "{score:?}");
        assert!(weight(MatchFeature::Histogram) < 1.5, "{score:?}");
        assert_eq!((score.proposals, score.searches), (1600, [200, 200]));
        let report = score.presence(&observed(1000, 2));
        assert_eq!((report.present, report.absent), (500, 500));
        assert!(report.found > 0.97, "{report:?}");
        assert!((report.kept - 0.95).abs() < 0.03 && report.invented < 0.05, "{report:?}");
        assert_eq!(report.curve[0], [1.0, 1.0]);
        assert_eq!(report.curve[100], [0.0, 0.0]);
    }

    #[test]
    fn the_score_travels_in_metadata() {
        let score = MatchScore::fit(&observed(100, 3), "made").unwrap();
        let metadata: BTreeMap<String, String> = [score.to_metadata()].into();
        let path = Path::new("a.safetensors");
        assert_eq!(MatchScore::from_metadata(&metadata, path).unwrap(), Some(score));
        assert_eq!(MatchScore::from_metadata(&BTreeMap::new(), path).unwrap(), None);
        let damaged: BTreeMap<String, String> = [("match_score".to_owned(), "{}".to_owned())].into();
        let message = MatchScore::from_metadata(&damaged, path).unwrap_err().to_string();
        assert!(message.contains("a.safetensors") && message.contains("match_score"), "{message}");
        assert!(MatchScore::fit(&observed(8, 4), "made").is_none());
    }
}
