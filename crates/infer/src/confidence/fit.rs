//! Logistic regression with non-negative weights.

use nalgebra::{DMatrix, DVector};

/// Fewest observations of either outcome.
const MIN_OUTCOMES: usize = 20;
/// Penalty on the squared weights of standardised values, in observations.
const RIDGE: f64 = 2.0;
const ITERATIONS: usize = 50;

/// Log odds of an outcome as a weighted sum of values: intercept, and one non-negative weight per value of an observation (all
/// have equally many). `None` with fewer than 20 observations of either outcome.
pub fn logistic_regression(observed: &[(Vec<f64>, bool)]) -> Option<(f64, Vec<f64>)> {
    let rights = observed.iter().filter(|(_, right)| *right).count();
    if rights.min(observed.len() - rights) < MIN_OUTCOMES {
        return None;
    }
    let count = observed.first().map_or(0, |(values, _)| values.len());
    let columns: Vec<Standardised> = (0..count)
        .map(|column| Standardised::new(observed.iter().map(|(values, _)| values[column]).collect()))
        .collect();
    let outcomes =
        DVector::from_iterator(observed.len(), observed.iter().map(|(_, right)| f64::from(u8::from(*right))));
    // Of features that say the same, some get a negative weight: the most negative leaves until none is left.
    let mut used: Vec<usize> = (0..columns.len()).filter(|&c| columns[c].deviation > 0.0).collect();
    loop {
        let solution = regress(&used.iter().map(|&c| &columns[c]).collect::<Vec<_>>(), &outcomes)?;
        let weights = || solution.iter().skip(1).copied();
        match (0..used.len()).zip(weights()).filter(|w| w.1 < 0.0).min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((worst, _)) => {
                used.remove(worst);
            }
            None => {
                let mut full = vec![0.0; columns.len()];
                let mut intercept = solution[0];
                for (&c, weight) in used.iter().zip(weights()) {
                    full[c] = weight / columns[c].deviation;
                    intercept -= full[c] * columns[c].mean;
                }
                return Some((intercept, full));
            }
        }
    }
}

/// Values with mean 0 and deviation 1.
struct Standardised {
    values: Vec<f64>,
    mean: f64,
    deviation: f64,
}

impl Standardised {
    fn new(mut values: Vec<f64>) -> Self {
        let count = values.len().max(1) as f64;
        let mean = values.iter().sum::<f64>() / count;
        let deviation = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt();
        if deviation > 0.0 {
            values.iter_mut().for_each(|v| *v = (*v - mean) / deviation);
        }
        Self { values, mean, deviation }
    }
}

/// Newton's method on the penalised likelihood: intercept, then one weight per column.
fn regress(columns: &[&Standardised], outcomes: &DVector<f64>) -> Option<DVector<f64>> {
    let rows = outcomes.len();
    let design = DMatrix::from_fn(rows, columns.len() + 1, |row, column| match column {
        0 => 1.0,
        c => columns[c - 1].values[row],
    });
    let mut penalty = DVector::from_element(columns.len() + 1, RIDGE);
    penalty[0] = 0.0;
    let mut solution = DVector::zeros(columns.len() + 1);
    for _ in 0..ITERATIONS {
        let expected = (&design * &solution).map(|x: f64| 1.0 / (1.0 + (-x).exp()));
        let gradient = design.tr_mul(&(outcomes - &expected)) - penalty.component_mul(&solution);
        let mut weighted = design.clone();
        for (mut row, p) in weighted.row_iter_mut().zip(expected.iter()) {
            // Certain predictions keep the equations determined.
            row *= (p * (1.0 - p)).max(1e-6);
        }
        let hessian = design.tr_mul(&weighted) + DMatrix::from_diagonal(&penalty);
        let step = hessian.cholesky()?.solve(&gradient);
        solution += &step;
        if step.norm() < 1e-9 {
            break;
        }
    }
    Some(solution)
}
