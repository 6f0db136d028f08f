//! The confidence fitted to analysed pairs, and how far it can be trusted on others.

use std::path::Path;

use unopose_dataset::formats::files::write_json;
use unopose_eval::{
    metrics::Reliability,
    report::{Curve, Panel, write_curves},
};
use unopose_infer::{Calibration, PoseCriterion};

use super::{AnalysisError, PairRecord};

/// Fits a calibration. `data` says what the pairs are.
pub fn calibrate(
    records: &[PairRecord],
    right: PoseCriterion,
    data: &str,
) -> Result<Calibration, AnalysisError> {
    let observed: Vec<_> = records.iter().map(|record| (record.evidence, record.right)).collect();
    Calibration::fit(&observed, right, data).ok_or_else(|| AnalysisError::TooFewOutcomes {
        pairs: records.len(),
        right: records.iter().filter(|record| record.right).count(),
    })
}

/// Probabilities by a calibration, with the outcomes.
pub fn judged(records: &[PairRecord], calibration: &Calibration) -> Vec<(f64, bool)> {
    records.iter().map(|record| (calibration.probability(&record.evidence), record.right)).collect()
}

/// Writes `reliability.json`, `reliability.svg` and `risk.svg` into a folder.
pub fn write_reliability(judged: &[(f64, bool)], folder: &Path) -> Result<Reliability, AnalysisError> {
    let reliability = Reliability::new(judged);
    write_json(&folder.join("reliability.json"), &reliability, true)?;
    let line = |label: &str, points: Vec<(f64, f64)>, faint| Curve { label: label.into(), points, faint };
    let panel = |title: &str, curves| Panel { title: title.into(), curves, range: Some((0.0, 1.0)) };
    let found = reliability.bins.iter().map(|bin| (bin.predicted, bin.right)).collect();
    let curves = vec![
        line("share of right poses", found, false),
        line("perfect calibration", vec![(0.0, 0.0), (1.0, 1.0)], true),
    ];
    write_curves(&folder.join("reliability.svg"), "confidence", &[panel("Reliability", curves)])?;
    let risk = vec![line("share of wrong poses", reliability.risk_coverage.clone(), false)];
    let risk = panel("Risk of the most confident estimates", risk);
    write_curves(&folder.join("risk.svg"), "share of the estimates that is trusted", &[risk])?;
    Ok(reliability)
}
