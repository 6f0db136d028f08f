//! Errors of the estimates of one object in one image, and which targets they hit.

use serde::Serialize;
use unopose_core::geometry::Pose;
use unopose_dataset::render::depth::DepthWindow;

use super::{
    MSPD_STEP, REFERENCE_WIDTH, TAUS, THRESHOLDS,
    matching::match_estimates,
    object::EvalObject,
    pose_error::{add, add_s, mspd, mssd, rotation_error_deg},
    threshold,
    vsd::{TestView, vsd},
};

/// All errors of an estimated pose against a true one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseErrors {
    /// Visible surface discrepancy by tolerance tau, 0.05 to 0.5 of the diameter, each in 0..=1.
    pub vsd: [f64; TAUS],
    /// Maximum symmetry-aware surface distance, metres; infinite (null in JSON) when the bounding spheres do not meet.
    pub mssd: f64,
    /// Maximum symmetry-aware projection distance, pixels of the image.
    pub mspd: f64,
    /// Average distance of the model points, metres; infinite (null in JSON) when the bounding spheres do not meet.
    pub add: f64,
    /// Average distance of the model points to the nearest one of the other pose, metres; infinite as `add`.
    pub add_s: f64,
    /// Rotation angle to the true pose, smallest over the symmetries, degrees.
    pub rotation_deg: f64,
    /// Distance of the object's origin from its true place, metres.
    pub translation: f64,
}

impl PoseErrors {
    /// `rendered_gt` is the object's depth in `t_gt`.
    pub fn new(
        object: &EvalObject,
        view: &TestView,
        t_est: &Pose,
        t_gt: &Pose,
        rendered_gt: &DepthWindow,
    ) -> Self {
        Self {
            vsd: vsd(object, view, t_est, t_gt, rendered_gt),
            mssd: mssd(object, t_est, t_gt),
            mspd: mspd(object, view.camera, t_est, t_gt),
            add: add(object, t_est, t_gt),
            add_s: add_s(object, t_est, t_gt),
            rotation_deg: rotation_error_deg(object, t_est, t_gt),
            translation: t_est.translation_distance(t_gt),
        }
    }

    /// Share of BOP's thresholds that the errors stay below, averaged over VSD (and its tolerances), MSSD and MSPD: the
    /// average recall of this pose alone.
    pub fn average_recall(&self, diameter: f64, image_width: u32) -> f64 {
        let below = |error: f64, limit: &dyn Fn(usize) -> f64| {
            (0..THRESHOLDS).filter(|&i| error < limit(i)).count() as f64 / THRESHOLDS as f64
        };
        let vsd = self.vsd.iter().map(|&e| below(e, &threshold)).sum::<f64>() / TAUS as f64;
        let pixels = MSPD_STEP * f64::from(image_width) / REFERENCE_WIDTH;
        let mspd = below(self.mspd, &|i| pixels * (i + 1) as f64);
        (vsd + below(self.mssd / diameter, &threshold) + mspd) / 3.0
    }
}

/// Was a target found, by threshold?
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Hits {
    /// `[tau][threshold]`.
    pub vsd: [[bool; THRESHOLDS]; TAUS],
    /// By threshold, 0.05 to 0.5 of the diameter.
    pub mssd: [bool; THRESHOLDS],
    /// By threshold, 5 to 50 pixels at an image width of 640.
    pub mspd: [bool; THRESHOLDS],
}

/// What became of one target instance.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TargetOutcome {
    /// Scene of the target.
    pub scene_id: u32,
    /// Image of the target in its scene.
    pub im_id: u32,
    /// Object of the target.
    pub obj_id: u32,
    /// Index in `scene_gt.json`.
    pub gt_index: usize,
    /// Visible share of the instance's silhouette, 0..=1.
    pub visib_fract: f64,
    /// Degrees between target and reference view, where known.
    pub rot_deg: Option<f64>,
    /// Of the object, metres.
    pub diameter: f64,
    /// Has the object symmetries?
    pub symmetric: bool,
    /// Errors of the estimate assigned to this target, `None` without one: by descending score, every estimate takes the
    /// nearest instance that is still free.
    pub errors: Option<PoseErrors>,
    /// Thresholds at which BOP's matching credits an estimate to this target.
    #[serde(skip)]
    pub(crate) hits: Hits,
}

impl TargetOutcome {
    /// The target's part in the average recall, in 0..=1: AR is the mean of it over all targets.
    pub fn average_recall(&self) -> f64 {
        self.average_recalls().iter().sum::<f64>() / 3.0
    }

    /// The parts in the average recalls of VSD, MSSD and MSPD.
    pub fn average_recalls(&self) -> [f64; 3] {
        let share = |hits: &[bool]| hits.iter().filter(|&&hit| hit).count() as f64 / hits.len() as f64;
        let Hits { vsd, mssd, mspd } = &self.hits;
        [share(vsd.as_flattened()), share(mssd), share(mspd)]
    }
}

/// Hits of every ground truth. `errors[estimate][ground truth]`, estimates by descending score.
pub fn hits(errors: &[Vec<PoseErrors>], gt_count: usize, diameter: f64, image_width: u32) -> Vec<Hits> {
    let mut hits = vec![Hits::default(); gt_count];
    let pixels = MSPD_STEP * f64::from(image_width) / REFERENCE_WIDTH;
    for th in 0..THRESHOLDS {
        for g in matched(errors, threshold(th), |e| e.mssd / diameter) {
            hits[g].mssd[th] = true;
        }
        for g in matched(errors, pixels * (th + 1) as f64, |e| e.mspd) {
            hits[g].mspd[th] = true;
        }
        for tau in 0..TAUS {
            for g in matched(errors, threshold(th), |e| e.vsd[tau]) {
                hits[g].vsd[tau][th] = true;
            }
        }
    }
    hits
}

/// Errors of the estimate assigned to each ground truth. `errors[estimate][ground truth]`, estimates by descending score.
pub fn assigned_errors(errors: &[Vec<PoseErrors>], gt_count: usize) -> Vec<Option<&PoseErrors>> {
    let distances: Vec<Vec<f64>> =
        errors.iter().map(|row| row.iter().map(|e| e.translation).collect()).collect();
    let mut assigned = vec![None; gt_count];
    for (row, matched) in errors.iter().zip(match_estimates(&distances, f64::INFINITY)) {
        if let Some(g) = matched {
            assigned[g] = Some(&row[g]);
        }
    }
    assigned
}

fn matched(
    errors: &[Vec<PoseErrors>],
    threshold: f64,
    value: impl Fn(&PoseErrors) -> f64,
) -> impl Iterator<Item = usize> {
    let values: Vec<Vec<f64>> = errors.iter().map(|row| row.iter().map(&value).collect()).collect();
    match_estimates(&values, threshold).into_iter().flatten()
}
