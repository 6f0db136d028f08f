//! Average precision of ranked estimates, interpolated at 101 recalls as COCO does.

/// Recalls at which precision is read: 0, 0.01, ... 1.
const RECALLS: usize = 101;

/// Area under the precision of hits among `ranked` (score, hit), where at each recall the best precision at that recall or
/// a higher one counts. `positives` is the number of instances to be found; `None` without any.
pub fn average_precision(mut ranked: Vec<(f64, bool)>, positives: usize) -> Option<f64> {
    if positives == 0 {
        return None;
    }
    // Stable: equal scores stay in order.
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut hits = 0usize;
    let mut points: Vec<(f64, f64)> = ranked
        .iter()
        .enumerate()
        .map(|(index, &(_, hit))| {
            hits += usize::from(hit);
            (hits as f64 / positives as f64, hits as f64 / (index + 1) as f64)
        })
        .collect();
    let mut best = 0f64;
    for (_, precision) in points.iter_mut().rev() {
        best = best.max(*precision);
        *precision = best;
    }
    let at = |index: usize| {
        let recall = index as f64 / (RECALLS - 1) as f64;
        let reached = points.partition_point(|point| point.0 < recall);
        points.get(reached).map_or(0.0, |point| point.1)
    };
    Some((0..RECALLS).map(at).sum::<f64>() / RECALLS as f64)
}

/// Mean, `None` of nothing.
pub fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.into_iter().fold((0.0, 0usize), |(sum, count), v| (sum + v, count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn precision_is_read_at_101_recalls() {
        // Hit, false alarm, hit, of 4 instances: precision 1 up to recall 0.25 (26 recalls), 2/3 up to 0.5 (25).
        let ranked = vec![(0.1, true), (0.9, true), (0.5, false)];
        let expected = (26.0 + 25.0 * 2.0 / 3.0) / 101.0;
        assert!((average_precision(ranked, 4).unwrap() - expected).abs() < 1e-12);
        assert_eq!(average_precision(vec![(0.3, true), (0.2, false)], 1), Some(1.0));
        assert_eq!(average_precision(vec![], 3), Some(0.0));
        assert_eq!(average_precision(vec![(0.3, false)], 0), None);
    }
}
