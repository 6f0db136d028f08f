//! The overlap with a true mask that a mask's evidence lets expect: a ridge regression on the evidence and all its products of
//! two, fitted to masks whose overlap is known.

use std::{collections::BTreeMap, path::Path};

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use unopose_nn::checkpoint::{CheckpointError, metadata_value};

use super::MaskEvidence;

/// Key of the checkpoint's metadata.
const METADATA_KEY: &str = "objectness";
/// Penalty on the squared weights of standardised terms, per mask.
const RIDGE: f64 = 1e-3;
/// Fewest masks of a fit.
const LEAST_MASKS: usize = 200;
/// Terms: the evidence, then the products of two, with itself too.
const TERMS: usize = MaskEvidence::COUNT + MaskEvidence::COUNT * (MaskEvidence::COUNT + 1) / 2;

/// A mask and the truth about it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObservedMask {
    /// Number of its image.
    pub image: usize,
    /// Largest overlap (intersection over union) with the visible part of any object.
    pub iou: f64,
    /// What is known of it.
    pub evidence: MaskEvidence,
}

/// A fitted regression.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Objectness {
    /// Overlap without any evidence.
    pub intercept: f64,
    /// Per term: the evidence in the order of [`MaskEvidence::values`], then the products `i * j`, `i <= j`, row by row.
    pub weights: Vec<f64>,
    /// Masks of the fit.
    pub masks: usize,
    /// What the images are.
    pub data: String,
}

impl Objectness {
    /// Least squares with a small penalty; `None` for fewer than 200 masks.
    pub fn fit(observed: &[ObservedMask], data: &str) -> Option<Self> {
        if observed.len() < LEAST_MASKS {
            return None;
        }
        let count = observed.len() as f64;
        let rows: Vec<[f64; TERMS]> = observed.iter().map(|o| terms(&o.evidence)).collect();
        let means: Vec<f64> =
            (0..TERMS).map(|t| rows.iter().map(|row| row[t]).sum::<f64>() / count).collect();
        let deviations: Vec<f64> = (0..TERMS)
            .map(|t| (rows.iter().map(|row| (row[t] - means[t]).powi(2)).sum::<f64>() / count).sqrt())
            .collect();
        // A term that never changes says nothing.
        let scaled = |row: &[f64; TERMS], t: usize| match deviations[t] > 1e-9 {
            true => (row[t] - means[t]) / deviations[t],
            false => 0.0,
        };
        let matrix = DMatrix::from_fn(rows.len(), TERMS, |r, t| scaled(&rows[r], t));
        let mean = observed.iter().map(|o| o.iou).sum::<f64>() / count;
        let outcomes = DVector::from_iterator(rows.len(), observed.iter().map(|o| o.iou - mean));
        let normal = matrix.tr_mul(&matrix) + DMatrix::identity(TERMS, TERMS) * (RIDGE * count);
        let solution = normal.cholesky()?.solve(&matrix.tr_mul(&outcomes));
        let weight = |t: usize| if deviations[t] > 1e-9 { solution[t] / deviations[t] } else { 0.0 };
        let weights: Vec<f64> = (0..TERMS).map(weight).collect();
        let intercept = mean - weights.iter().zip(&means).map(|(w, m)| w * m).sum::<f64>();
        Some(Self { intercept, weights, masks: observed.len(), data: data.to_owned() })
    }

    /// The overlap to be expected, in [0, 1].
    pub fn overlap(&self, evidence: &MaskEvidence) -> f64 {
        let sum: f64 = terms(evidence).iter().zip(&self.weights).map(|(t, w)| t * w).sum();
        (self.intercept + sum).clamp(0.0, 1.0)
    }

    /// That of a checkpoint's metadata, if it has one.
    pub fn from_metadata(
        metadata: &BTreeMap<String, String>,
        path: &Path,
    ) -> Result<Option<Self>, CheckpointError> {
        let expected = format!("a fitted objectness with {TERMS} finite weights");
        let read: Option<Self> = metadata_value(metadata, METADATA_KEY, path, &expected)?;
        let bad = |o: &Self| {
            o.weights.len() != TERMS || !o.weights.iter().chain([&o.intercept]).all(|w| w.is_finite())
        };
        match read {
            Some(objectness) if bad(&objectness) => Err(CheckpointError::Metadata {
                path: path.to_owned(),
                key: METADATA_KEY,
                value: format!("one with {} weights", objectness.weights.len()),
                expected,
            }),
            read => Ok(read),
        }
    }

    /// The metadata entry.
    pub fn to_metadata(&self) -> Result<(String, String), serde_json::Error> {
        Ok((METADATA_KEY.into(), serde_json::to_string(self)?))
    }
}

fn terms(evidence: &MaskEvidence) -> [f64; TERMS] {
    let values = evidence.values();
    let mut terms = [0.0; TERMS];
    terms[..values.len()].copy_from_slice(&values);
    let pairs = (0..values.len()).flat_map(|i| (i..values.len()).map(move |j| (i, j)));
    for (term, (i, j)) in terms[values.len()..].iter_mut().zip(pairs) {
        *term = values[i] * values[j];
    }
    terms
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};

    use super::*;

    fn observed(count: usize) -> Vec<ObservedMask> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let of = |rng: &mut rand_chacha::ChaCha8Rng| {
            let evidence = MaskEvidence {
                inside: rng.random_range(0.0..1.0),
                ring: rng.random_range(0.0..1.0),
                size: rng.random_range(2.0..8.0),
                ..MaskEvidence::default()
            };
            let iou = 0.2 + 0.6 * evidence.inside * (1.0 - evidence.ring);
            ObservedMask { image: 0, iou, evidence }
        };
        (0..count).map(|_| of(&mut rng)).collect()
    }

    #[test]
    fn a_product_of_evidence_is_found() {
        let objectness = Objectness::fit(&observed(500), "made").unwrap();
        for mask in observed(20) {
            let expected = objectness.overlap(&mask.evidence);
            assert!((expected - mask.iou).abs() < 0.02, "{expected}, true {}", mask.iou);
        }
        assert!(Objectness::fit(&observed(199), "made").is_none());
    }

    #[test]
    fn metadata_are_checked() {
        let path = Path::new("p.safetensors");
        let objectness = Objectness::fit(&observed(300), "made").unwrap();
        let (key, text) = objectness.to_metadata().unwrap();
        let read = Objectness::from_metadata(&[(key.clone(), text)].into(), path).unwrap();
        assert_eq!(read, Some(objectness.clone()));
        let short = Objectness { weights: vec![1.0; 3], ..objectness };
        let text = short.to_metadata().unwrap().1;
        let error = Objectness::from_metadata(&[(key, text)].into(), path).unwrap_err().to_string();
        assert!(
            error.contains("p.safetensors") && error.contains("3 weights") && error.contains("65"),
            "{error}"
        );
        assert_eq!(Objectness::from_metadata(&BTreeMap::new(), path).unwrap(), None);
    }
}
