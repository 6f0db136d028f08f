//! Confidence intervals of average recalls and of their differences, by resampling images.

use std::collections::BTreeMap;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::TargetOutcome;

/// A value with its 95 % interval (percentiles of the resampled values).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Mean over all targets.
    pub value: f64,
    /// 2.5th percentile.
    pub low: f64,
    /// 97.5th percentile.
    pub high: f64,
}

/// Share of the resampled values outside of the interval on each side.
const TAIL: f64 = 0.025;

/// Average recall with its interval. Instances of one image are drawn together, they share light, noise and clutter.
pub fn average_recall_interval(targets: &[TargetOutcome], resamples: usize, seed: u64) -> Interval {
    interval(targets.iter().map(|t| (image(t), t.average_recall())), resamples, seed)
}

/// Average recalls of VSD, MSSD and MSPD with their intervals.
pub fn error_type_intervals(targets: &[TargetOutcome], resamples: usize, seed: u64) -> [Interval; 3] {
    [0, 1, 2]
        .map(|kind| interval(targets.iter().map(|t| (image(t), t.average_recalls()[kind])), resamples, seed))
}

/// Difference of the average recalls `a - b` on the targets that both have, with its interval.
pub fn paired_difference(a: &[TargetOutcome], b: &[TargetOutcome], resamples: usize, seed: u64) -> Interval {
    let key = |t: &TargetOutcome| (t.scene_id, t.im_id, t.obj_id, t.gt_index);
    let others: BTreeMap<_, f64> = b.iter().map(|t| (key(t), t.average_recall())).collect();
    let differences = a.iter().filter_map(|t| Some((image(t), t.average_recall() - others.get(&key(t))?)));
    interval(differences, resamples, seed)
}

fn image(target: &TargetOutcome) -> (u32, u32) {
    (target.scene_id, target.im_id)
}

/// Mean of the values; groups are drawn with replacement.
fn interval(values: impl Iterator<Item = ((u32, u32), f64)>, resamples: usize, seed: u64) -> Interval {
    let mut groups: BTreeMap<(u32, u32), (f64, usize)> = BTreeMap::new();
    for (group, value) in values {
        let entry = groups.entry(group).or_default();
        entry.0 += value;
        entry.1 += 1;
    }
    let groups: Vec<(f64, usize)> = groups.into_values().collect();
    let mean = |drawn: &mut dyn Iterator<Item = (f64, usize)>| {
        let (sum, count) = drawn.fold((0.0, 0), |total, group| (total.0 + group.0, total.1 + group.1));
        sum / count.max(1) as f64
    };
    let value = mean(&mut groups.iter().copied());
    if groups.is_empty() || resamples == 0 {
        return Interval { value, low: value, high: value };
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut means: Vec<f64> = (0..resamples)
        .map(|_| mean(&mut (0..groups.len()).map(|_| groups[rng.random_range(0..groups.len())])))
        .collect();
    means.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| means[((means.len() - 1) as f64 * share).round() as usize];
    Interval { value, low: at(TAIL), high: at(1.0 - TAIL) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(n: u32) -> impl Iterator<Item = ((u32, u32), f64)> {
        // A fair coin in every image.
        (0..n).map(|i| ((1, i), f64::from(i % 2)))
    }

    #[test]
    fn the_interval_of_a_share_is_that_of_the_binomial() {
        // Standard error sqrt(0.25 / 400) = 0.025, 1.96 of them on each side.
        let found = interval(values(400), 4000, 1);
        assert_eq!(found.value, 0.5);
        assert!((found.low - 0.451).abs() < 0.006 && (found.high - 0.549).abs() < 0.006, "{found:?}");
        assert_eq!(interval(values(400), 4000, 1), found);
        assert_ne!(interval(values(400), 4000, 2), found);
    }

    #[test]
    fn instances_of_an_image_are_drawn_together() {
        // 100 images of four equal values: as wide as 100 single ones, twice as wide as 400.
        let grouped = (0..400).map(|i| ((1, i / 4), f64::from(i / 4 % 2)));
        let found = interval(grouped, 4000, 1);
        assert!((found.high - found.low - 0.196).abs() < 0.02, "{found:?}");
        let none = interval(std::iter::empty(), 100, 0);
        assert_eq!((none.value, none.low), (0.0, 0.0));
    }
}
