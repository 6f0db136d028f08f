//! Accuracies from before the BOP challenges: ADD, ADD-S and their areas under the curve, and the angular error of relative
//! pose estimation.

use serde::{Deserialize, Serialize};

use super::outcome::{PoseErrors, TargetOutcome};

/// Largest error of the curve of accuracy over error, metres (PoseCNN: Xiang et al., RSS 2018).
const AUC_LIMIT: f64 = 0.1;
/// Share of the diameter below which a pose is right (Hinterstoisser et al., ACCV 2012).
const CORRECT_SHARE: f64 = 0.1;
/// Angular error of a target without an estimate, degrees.
const MISSED_DEG: f64 = 180.0;

/// Means over all targets. A target without an estimate has the worst value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PoseAccuracy {
    /// Area under the curve of accuracy over the largest ADD of 0 to 10 cm, computed exactly, 0..=1.
    #[serde(rename = "ADD_AUC")]
    pub add_auc: f64,
    /// The same for ADD-S.
    #[serde(rename = "ADD_S_AUC")]
    pub add_s_auc: f64,
    /// Share of targets with an ADD below 10 % of the diameter.
    #[serde(rename = "ADD_01d")]
    pub add_01d: f64,
    /// The same for ADD-S.
    #[serde(rename = "ADD_S_01d")]
    pub add_s_01d: f64,
    /// The same with ADD-S for objects with symmetries and ADD for the others.
    #[serde(rename = "ADD_or_ADD_S_01d")]
    pub add_or_add_s_01d: f64,
    /// Mean rotation error in degrees, smallest over the symmetries; 180 without an estimate.
    pub angular_error_deg: f64,
    /// Share of targets with a rotation error below 15 degrees.
    #[serde(rename = "Acc15")]
    pub acc15: f64,
    /// Share of targets with a rotation error below 30 degrees.
    #[serde(rename = "Acc30")]
    pub acc30: f64,
}

impl PoseAccuracy {
    pub(super) fn of(targets: &[TargetOutcome]) -> Self {
        let count = targets.len().max(1) as f64;
        let mean = |value: &dyn Fn(&TargetOutcome) -> f64| targets.iter().map(value).sum::<f64>() / count;
        let share = |right: &dyn Fn(&TargetOutcome, &PoseErrors) -> bool| {
            mean(&|t| f64::from(u8::from(t.errors.as_ref().is_some_and(|e| right(t, e)))))
        };
        let area = |error: &dyn Fn(&PoseErrors) -> f64| {
            mean(&|t| t.errors.as_ref().map_or(0.0, |e| (1.0 - error(e) / AUC_LIMIT).max(0.0)))
        };
        let near = |t: &TargetOutcome, error: f64| error < CORRECT_SHARE * t.diameter;
        let degrees = |t: &TargetOutcome| t.errors.as_ref().map_or(MISSED_DEG, |e| e.rotation_deg);
        Self {
            add_auc: area(&|e| e.add),
            add_s_auc: area(&|e| e.add_s),
            add_01d: share(&|t, e| near(t, e.add)),
            add_s_01d: share(&|t, e| near(t, e.add_s)),
            add_or_add_s_01d: share(&|t, e| near(t, if t.symmetric { e.add_s } else { e.add })),
            angular_error_deg: mean(&degrees),
            acc15: share(&|_, e| e.rotation_deg < 15.0),
            acc30: share(&|_, e| e.rotation_deg < 30.0),
        }
    }
}
