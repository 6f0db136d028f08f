//! Is a predicted probability what it says? Calibration error, reliability by bins, and the risk of trusting only the
//! estimates with the highest probabilities.

use serde::{Deserialize, Serialize};

/// Bins of equal counts.
const BINS: usize = 10;
/// Largest share of wrong ones among those that are trusted, of the coverage that is reported.
const RISK: f64 = 0.1;

/// Pairs with similar probabilities.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReliabilityBin {
    /// Mean predicted probability.
    pub predicted: f64,
    /// Share whose pose was right.
    pub right: f64,
    /// Number of pairs.
    pub count: usize,
}

/// Probabilities against outcomes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Reliability {
    /// Number of pairs.
    pub count: usize,
    /// Share whose pose was right.
    pub right_share: f64,
    /// Expected calibration error: mean distance of predicted and found share over the bins, weighed by their counts.
    pub calibration_error: f64,
    /// Brier score: mean squared difference of probability and outcome (0 or 1).
    pub brier: f64,
    /// Area under the ROC curve: chance that a right pose has a higher probability than a wrong one; `None` when all are
    /// right or all are wrong.
    pub auroc: Option<f64>,
    /// Area under the risk-coverage curve: mean risk over all coverages.
    pub risk_area: f64,
    /// Largest share that can be trusted with at most a tenth of it wrong.
    pub coverage_at_risk: f64,
    /// Up to ten bins of equal counts, by ascending probability.
    pub bins: Vec<ReliabilityBin>,
    /// Coverage and risk: share trusted, from the highest probability down, and the share of wrong ones among it.
    pub risk_coverage: Vec<(f64, f64)>,
}

impl Reliability {
    /// Of probabilities with outcomes, in any order.
    pub fn new(judged: &[(f64, bool)]) -> Self {
        let mut sorted = judged.to_vec();
        sorted.sort_by(|a, b| b.0.total_cmp(&a.0));
        let count = sorted.len();
        let rights = sorted.iter().filter(|(_, right)| *right).count();
        let size = count.div_ceil(BINS).max(1);
        let bins: Vec<ReliabilityBin> = sorted.chunks(size).rev().map(bin).collect();
        let mut wrong = 0;
        let risk_coverage: Vec<(f64, f64)> = sorted
            .iter()
            .zip(1..)
            .map(|(&(_, right), taken)| {
                wrong += usize::from(!right);
                (taken as f64 / count as f64, wrong as f64 / f64::from(taken))
            })
            .collect();
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count.max(1) as f64;
        let trusted = risk_coverage.iter().rfind(|(_, risk)| *risk <= RISK);
        Self {
            count,
            right_share: rights as f64 / count.max(1) as f64,
            calibration_error: mean(&mut bins.iter().map(|b| (b.predicted - b.right).abs() * b.count as f64)),
            brier: mean(&mut sorted.iter().map(|&(p, right)| (p - f64::from(u8::from(right))).powi(2))),
            auroc: roc_area(&sorted),
            risk_area: mean(&mut risk_coverage.iter().map(|(_, risk)| *risk)),
            coverage_at_risk: trusted.map_or(0.0, |(coverage, _)| *coverage),
            bins,
            risk_coverage,
        }
    }
}

fn bin(judged: &[(f64, bool)]) -> ReliabilityBin {
    let count = judged.len();
    let right = judged.iter().filter(|(_, right)| *right).count();
    let predicted = judged.iter().map(|(p, _)| p).sum::<f64>() / count.max(1) as f64;
    ReliabilityBin { predicted, right: right as f64 / count.max(1) as f64, count }
}

/// Area under the ROC curve of (score, right), sorted by descending score: the chance that a right one has a higher score than
/// a wrong one, equal scores count half. `None` when all are right or all are wrong.
pub(super) fn roc_area(sorted: &[(f64, bool)]) -> Option<f64> {
    let (mut rights_above, mut wins, mut wrongs) = (0.0, 0.0, 0.0);
    for equal in sorted.chunk_by(|a, b| a.0 == b.0) {
        let rights = equal.iter().filter(|(_, right)| *right).count() as f64;
        let wrong = equal.len() as f64 - rights;
        wins += wrong * (rights_above + 0.5 * rights);
        rights_above += rights;
        wrongs += wrong;
    }
    (rights_above > 0.0 && wrongs > 0.0).then(|| wins / (rights_above * wrongs))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_probabilities_give_known_errors() {
        // Ten of each: 0.8 with six right (0.2 off), 0.3 with three right (exact).
        let judged: Vec<(f64, bool)> = (0..10).flat_map(|i| [(0.8, i < 6), (0.3, i < 3)]).collect();
        let found = Reliability::new(&judged);
        // Bins of two pairs: each bin of the first kind has its own share, but their mean distance is at least 0.2.
        assert_eq!((found.count, found.bins.len()), (20, 10));
        assert!((found.right_share - 0.45).abs() < 1e-12);
        let brier = (6.0 * 0.04 + 4.0 * 0.64 + 3.0 * 0.49 + 7.0 * 0.09) / 20.0;
        assert!((found.brier - brier).abs() < 1e-12);
        // 9 right, 11 wrong: (6 x 7 + 0.5 x (6 x 4 + 3 x 7)) / 99.
        assert!((found.auroc.unwrap() - 64.5 / 99.0).abs() < 1e-12);
        assert_eq!(found.risk_coverage[19], (1.0, 0.55));
    }

    #[test]
    fn large_bins_give_the_calibration_error() {
        let judged: Vec<(f64, bool)> =
            (0..1000).map(|i| (if i < 500 { 0.9 } else { 0.2 }, i % 10 < 7)).collect();
        let found = Reliability::new(&judged);
        assert!((found.calibration_error - (0.5 * 0.2 + 0.5 * 0.5)).abs() < 1e-9, "{found:?}");
        let perfect = Reliability::new(&[(0.9, true), (0.8, true), (0.1, false)]);
        assert_eq!((perfect.auroc, perfect.coverage_at_risk), (Some(1.0), 2.0 / 3.0));
        let empty = Reliability::new(&[]);
        assert_eq!((empty.count, empty.auroc, empty.coverage_at_risk), (0, None, 0.0));
    }
}
