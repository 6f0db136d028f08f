//! Which estimate is credited with which ground truth.

/// Assigns estimates to ground truths greedily: in the given order (descending score) each estimate takes the
/// free ground truth with the lowest error below `threshold`. `errors[e][g]`; the result has the ground truth
/// of every estimate.
pub fn match_estimates<E: AsRef<[f64]>>(errors: &[E], threshold: f64) -> Vec<Option<usize>> {
    let mut taken = vec![false; errors.iter().map(|e| e.as_ref().len()).max().unwrap_or(0)];
    errors
        .iter()
        .map(|row| {
            let free = row.as_ref().iter().enumerate().filter(|&(g, &error)| !taken[g] && error < threshold);
            // `min_by` keeps the first of equal errors.
            let (g, _) = free.min_by(|a, b| a.1.total_cmp(b.1))?;
            taken[g] = true;
            Some(g)
        })
        .collect()
}

/// Indices of the `count` largest values, largest first; equal values stay in order.
pub fn top(values: impl IntoIterator<Item = f64>, count: usize) -> Vec<usize> {
    let mut order: Vec<(usize, f64)> = values.into_iter().enumerate().collect();
    order.sort_by(|a, b| b.1.total_cmp(&a.1));
    order.into_iter().take(count).map(|(index, _)| index).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_better_scored_estimate_chooses_first() {
        // The first takes ground truth 1 although the second would fit it better.
        let errors = [[0.3, 0.2], [0.9, 0.1]];
        assert_eq!(match_estimates(&errors, 0.5), [Some(1), None]);
        assert_eq!(match_estimates(&errors, 1.0), [Some(1), Some(0)]);
        // Strictly below.
        assert_eq!(match_estimates(&errors, 0.2), [None, Some(1)]);
        assert_eq!(match_estimates(&[[f64::INFINITY]], f64::INFINITY), [None]);
        assert!(match_estimates::<Vec<f64>>(&[], 1.0).is_empty());
    }

    #[test]
    fn top_is_stable() {
        assert_eq!(top([0.5, 0.9, 0.5, 0.7], 3), [1, 3, 0]);
        assert_eq!(top([0.5], 4), [0]);
    }
}
