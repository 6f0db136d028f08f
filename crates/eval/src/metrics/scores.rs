//! Recalls and average recalls, and the file they are written to.

use std::{collections::BTreeMap, path::Path};

use serde::{Deserialize, Serialize};
use unopose_dataset::formats::{FormatError, files::write_json};

use super::{
    InputReport, PoseAccuracy, PoseAveragePrecision, TAUS, THRESHOLDS,
    bins::{ROTATION_EDGES, VISIBILITY_EDGES, bin_of},
    outcome::TargetOutcome,
    prints::PrintScore,
};

/// Average recalls of a group of targets, each in 0..=1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AverageRecall {
    /// Mean of the average recalls of VSD, MSSD and MSPD.
    #[serde(rename = "AR")]
    pub ar: f64,
    /// Of the visible surface discrepancy, mean over tolerances and thresholds.
    #[serde(rename = "AR_VSD")]
    pub ar_vsd: f64,
    /// Of the maximum symmetry-aware surface distance, mean over thresholds.
    #[serde(rename = "AR_MSSD")]
    pub ar_mssd: f64,
    /// Of the maximum symmetry-aware projection distance, mean over thresholds.
    #[serde(rename = "AR_MSPD")]
    pub ar_mspd: f64,
    /// Target instances, found or not.
    pub n_targets: usize,
}

/// Average recalls of the targets with a value from `from` (included) to `to`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BinScore {
    /// Lower limit, in the bins' unit: visible share or degrees.
    pub from: f64,
    /// Upper limit.
    pub to: f64,
    /// Average recalls of the bin's targets.
    #[serde(flatten)]
    pub recall: AverageRecall,
}

/// The contents of `scores.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Scores {
    /// Average recalls of all targets (BOP challenges since 2019).
    #[serde(flatten)]
    pub recall: AverageRecall,
    /// Mean average precisions of all estimates (BOP challenge 2024).
    #[serde(flatten)]
    pub detection: PoseAveragePrecision,
    /// ADD, ADD-S and angular errors of all targets.
    #[serde(flatten)]
    pub accuracy: PoseAccuracy,
    /// Estimates that were compared with a target.
    pub n_estimates: usize,
    /// Estimates of images or objects that are no targets. Those of images of the list are false alarms for mAP when the
    /// object is a target elsewhere; the others are left out.
    pub n_strangers: usize,
    /// Seconds for an image, segmentation included; -1 when unknown.
    pub mean_time_per_image_s: f64,
    /// Time of all images divided by the number of estimates; -1 when unknown.
    pub mean_time_per_pair_s: f64,
    /// Recall of VSD, `[tau][threshold]`, both 0.05 to 0.5.
    pub recall_vsd: [[f64; THRESHOLDS]; TAUS],
    /// Recall of MSSD by threshold, 0.05 to 0.5 of the diameter.
    pub recall_mssd: [f64; THRESHOLDS],
    /// Recall of MSPD by threshold, 5 to 50 pixels at an image width of 640.
    pub recall_mspd: [f64; THRESHOLDS],
    /// By object id.
    pub per_object: BTreeMap<u32, AverageRecall>,
    /// By scene id.
    pub per_scene: BTreeMap<u32, AverageRecall>,
    /// By `visib_fract` of the target; bins without targets are left out.
    pub per_visibility: Vec<BinScore>,
    /// By degrees between target and reference view; empty when no list of references was given.
    pub per_rotation: Vec<BinScore>,
    /// By what the shape leaves open (`axis`, `flip`, `none`), for datasets with a `print_decides.json`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub per_print: BTreeMap<String, PrintScore>,
    /// Input that was left out, and warnings.
    #[serde(flatten)]
    pub input: InputReport,
}

/// Recalls of one group of targets.
#[derive(Clone, Debug, Default)]
struct Recalls {
    instances: usize,
    vsd: [[f64; THRESHOLDS]; TAUS],
    mssd: [f64; THRESHOLDS],
    mspd: [f64; THRESHOLDS],
}

impl Recalls {
    fn of<'a>(targets: impl IntoIterator<Item = &'a TargetOutcome>) -> Self {
        let mut recalls = Self::default();
        let add = |sums: &mut [f64; THRESHOLDS], hits: &[bool; THRESHOLDS]| {
            sums.iter_mut().zip(hits).for_each(|(sum, &hit)| *sum += f64::from(u8::from(hit)));
        };
        for target in targets {
            recalls.instances += 1;
            add(&mut recalls.mssd, &target.hits.mssd);
            add(&mut recalls.mspd, &target.hits.mspd);
            recalls.vsd.iter_mut().zip(&target.hits.vsd).for_each(|(sums, hits)| add(sums, hits));
        }
        let n = recalls.instances.max(1) as f64;
        let all = recalls.vsd.iter_mut().chain([&mut recalls.mssd, &mut recalls.mspd]);
        all.flatten().for_each(|sum| *sum /= n);
        recalls
    }

    fn average(&self) -> AverageRecall {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let (ar_vsd, ar_mssd, ar_mspd) = (mean(self.vsd.as_flattened()), mean(&self.mssd), mean(&self.mspd));
        AverageRecall {
            ar: (ar_vsd + ar_mssd + ar_mspd) / 3.0,
            ar_vsd,
            ar_mssd,
            ar_mspd,
            n_targets: self.instances,
        }
    }
}

/// Average recalls of any group of targets.
pub fn average_recall<'a>(targets: impl IntoIterator<Item = &'a TargetOutcome>) -> AverageRecall {
    Recalls::of(targets).average()
}

/// Seconds per image and per estimate; -1 when unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanTimes {
    pub per_image_s: f64,
    pub per_pair_s: f64,
}

/// Numbers of estimates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EstimateCounts {
    /// Compared with a target.
    pub compared: usize,
    /// Of images or objects that are no targets.
    pub strangers: usize,
}

impl Scores {
    pub(super) fn new(
        targets: &[TargetOutcome],
        detection: PoseAveragePrecision,
        counts: EstimateCounts,
        times: MeanTimes,
    ) -> Self {
        let all = Recalls::of(targets);
        Self {
            recall: all.average(),
            detection,
            accuracy: PoseAccuracy::of(targets),
            n_estimates: counts.compared,
            n_strangers: counts.strangers,
            mean_time_per_image_s: times.per_image_s,
            mean_time_per_pair_s: times.per_pair_s,
            recall_vsd: all.vsd,
            recall_mssd: all.mssd,
            recall_mspd: all.mspd,
            per_object: grouped(targets, |t| t.obj_id),
            per_scene: grouped(targets, |t| t.scene_id),
            per_visibility: binned(targets, &VISIBILITY_EDGES, |t| Some(t.visib_fract)),
            per_rotation: binned(targets, &ROTATION_EDGES, |t| t.rot_deg),
            per_print: BTreeMap::new(),
            input: InputReport::default(),
        }
    }

    /// Writes `scores.json`.
    pub(super) fn write(&self, path: &Path) -> Result<(), FormatError> {
        write_json(path, self, true)
    }
}

fn grouped(targets: &[TargetOutcome], key: impl Fn(&TargetOutcome) -> u32) -> BTreeMap<u32, AverageRecall> {
    let mut groups: BTreeMap<u32, Vec<&TargetOutcome>> = BTreeMap::new();
    for target in targets {
        groups.entry(key(target)).or_default().push(target);
    }
    groups.into_iter().map(|(id, group)| (id, average_recall(group))).collect()
}

fn binned(
    targets: &[TargetOutcome],
    edges: &[f64],
    value: impl Fn(&TargetOutcome) -> Option<f64>,
) -> Vec<BinScore> {
    let bins = edges.windows(2).enumerate().map(|(bin, limits)| {
        let inside = |t: &&TargetOutcome| value(t).is_some_and(|v| bin_of(v, edges) == bin);
        let recall = average_recall(targets.iter().filter(inside));
        BinScore { from: limits[0], to: limits[1], recall }
    });
    bins.filter(|bin| bin.recall.n_targets > 0).collect()
}
