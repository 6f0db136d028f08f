//! Do point features tell which points of two views are the same?

use super::reliability::roc_area;

/// Points of another place are at least this many match distances away.
const CLEARLY_OTHER: f32 = 2.0;

/// How features are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeatureSimilarity {
    /// The cosine of their angle.
    Cosine,
    /// Minus their distance.
    Distance,
}

/// Area under the ROC curve of right against wrong matches of a pair of views: every query point with its nearest reference
/// point, where it is at most `near` away, against the query point with all reference points at least twice as far.
///
/// `query` and `reference` hold rows of `channels` numbers, `distances` those between the points under the true pose, a row per
/// query point. `None` without matches.
pub fn match_area(
    [query, reference]: [&[f32]; 2],
    channels: usize,
    distances: &[f32],
    near: f32,
    similarity: FeatureSimilarity,
) -> Option<f64> {
    let references: Vec<&[f32]> = reference.chunks(channels.max(1)).collect();
    let mut scored = Vec::new();
    for (own, to) in query.chunks(channels.max(1)).zip(distances.chunks(references.len().max(1))) {
        let Some(nearest) = (0..to.len()).min_by(|&a, &b| to[a].total_cmp(&to[b])) else { continue };
        if to[nearest] > near {
            continue;
        }
        let wrong = (0..to.len()).filter(|&j| to[j] >= CLEARLY_OTHER * near).map(|j| (j, false));
        scored.extend(
            wrong.chain([(nearest, true)]).map(|(j, right)| (similarity.of(own, references[j]), right)),
        );
    }
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    roc_area(&scored)
}

impl FeatureSimilarity {
    fn of(self, a: &[f32], b: &[f32]) -> f64 {
        let sum =
            |of: fn(f64, f64) -> f64| a.iter().zip(b).map(|(&a, &b)| of(a.into(), b.into())).sum::<f64>();
        match self {
            Self::Distance => -sum(|a, b| (a - b).powi(2)).sqrt(),
            Self::Cosine => {
                let lengths = sum(|a, _| a * a).sqrt() * sum(|_, b| b * b).sqrt();
                sum(|a, b| a * b) / lengths.max(1e-12)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_count_nearest_points_against_clearly_other_ones() {
        // Matches 0-0 and 1-1; query 2 has none; 0-1 is too near to be wrong.
        let distances = [0.1, 0.2, 0.9, 0.5, 0.15, 0.9, 0.4, 0.4, 0.4];
        let query = [1.0, 0.0, 0.0, 1.0, 1.0, 0.0];
        let area = |reference: &[f32], similarity| {
            match_area([&query, reference], 2, &distances, 0.15, similarity).unwrap()
        };
        // Right: 0.995, 0.995. Wrong: 0-2 0.894; 1-0 0.0995; 1-2 0.447.
        assert_eq!(area(&[1.0, 0.1, 0.1, 1.0, 2.0, 1.0], FeatureSimilarity::Cosine), 1.0);
        // Right: 0-0 -1.414, 1-1 -0.1. Wrong: 0-2 -0.1, 1-0 -2, 1-2 -1.345. Of six, 0-0 beats one, 1-1 beats two and ties.
        let by_distance = area(&[2.0, 1.0, 0.1, 1.0, 1.0, 0.1], FeatureSimilarity::Distance);
        assert!((by_distance - 3.5 / 6.0).abs() < 1e-9, "{by_distance}");
        assert_eq!(match_area([&query, &query], 2, &[1.0; 9], 0.15, FeatureSimilarity::Cosine), None);
    }
}
