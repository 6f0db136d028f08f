//! The scores of one image.

use std::collections::BTreeMap;

use unopose_core::{
    frame::DepthMap,
    geometry::{Intrinsics, Pose},
};
use unopose_dataset::{
    formats::{BopScene, FormatError, PoseResult, Target, targets::MIN_VISIBILITY},
    protocol::UnreadImages,
    render::depth::DepthWindow,
};

use super::{
    EvalError, EvalObject, PoseErrors, REFERENCE_WIDTH, TargetOutcome,
    matching::top,
    options::ScoreOptions,
    outcome::{assigned_errors, hits},
    pose_detection::{MAX_ESTIMATES, ObjectEstimates},
    pose_error::{mspd, mssd},
    vsd::TestView,
};

/// Targets and results of an image.
#[derive(Default)]
pub struct Image<'a> {
    pub targets: Vec<&'a Target>,
    pub results: Vec<&'a PoseResult>,
}

/// What is known of an image afterwards.
#[derive(Default)]
pub struct ScoredImage {
    pub targets: Vec<TargetOutcome>,
    /// Of all objects that are a target anywhere.
    pub ranked: Vec<ObjectEstimates>,
    /// Estimates compared with a target.
    pub n_estimates: usize,
    /// Distances of the targets' true poses, metres.
    pub distances: Vec<f64>,
    /// Measured and true depth of each target with an estimate, metres: medians over the pixels of its drawn model.
    pub depths: Vec<[f64; 2]>,
    /// The image, when it could not be read.
    pub unread: UnreadImages,
}

/// Annotations of an image.
struct Annotation<'a> {
    scene: &'a BopScene,
    im_id: u32,
    view: TestView<'a>,
    options: &'a ScoreOptions<'a>,
}

/// An object's annotated instances and its estimates in an image.
struct ObjectInImage<'a> {
    obj_id: u32,
    object: &'a EvalObject,
    /// Index in `scene_gt.json`, true pose and visible share.
    instances: Vec<(usize, Pose, f64)>,
    /// By descending score.
    estimates: Vec<&'a PoseResult>,
    /// How many of them are among the image's best.
    ranked: usize,
}

impl Image<'_> {
    pub fn score(
        &self,
        scene: &BopScene,
        im_id: u32,
        objects: &BTreeMap<u32, EvalObject>,
        options: &ScoreOptions,
    ) -> Result<ScoredImage, EvalError> {
        let mut scored = ScoredImage::default();
        let (depth, camera, results) = match Self::view(scene, im_id) {
            Ok((depth, camera)) => (depth, camera, self.results.as_slice()),
            // Without estimates nothing is compared with the view: the image's targets are missed.
            Err(error) => {
                scored.unread.add(scene.id, im_id, &error);
                (DepthMap::zeros(1, 1), Intrinsics { fx: 1.0, fy: 1.0, cx: 0.0, cy: 0.0 }, &[][..])
            }
        };
        let view = TestView { depth: &depth, camera: &camera, delta: options.delta };
        let annotation = Annotation { scene, im_id, view, options };
        let counts: BTreeMap<u32, u32> = self.targets.iter().map(|t| (t.obj_id, t.inst_count)).collect();
        let sorted = top(results.iter().map(|r| r.score), results.len());
        for (&obj_id, object) in objects {
            let inst_count = counts.get(&obj_id).copied().unwrap_or(0) as usize;
            let of_object = |best: &[usize]| -> Vec<&PoseResult> {
                best.iter().map(|&i| results[i]).filter(|r| r.obj_id == obj_id).collect()
            };
            let estimates = of_object(&sorted);
            let ranked = of_object(&sorted[..sorted.len().min(MAX_ESTIMATES)]).len();
            let instances = annotation.instances(obj_id)?;
            if inst_count > 0 && instances.is_empty() {
                let scene = scene.folder.display().to_string();
                return Err(EvalError::TargetWithoutGt { scene, im_id, obj_id });
            }
            if instances.is_empty() && estimates.is_empty() {
                continue;
            }
            let of_object = ObjectInImage { obj_id, object, instances, estimates, ranked };
            of_object.score(&annotation, inst_count, &mut scored);
        }
        Ok(scored)
    }

    fn view(scene: &BopScene, im_id: u32) -> Result<(DepthMap, Intrinsics), FormatError> {
        Ok((scene.depth(im_id)?, scene.camera(im_id)?.intrinsics))
    }
}

impl Annotation<'_> {
    fn instances(&self, obj_id: u32) -> Result<Vec<(usize, Pose, f64)>, EvalError> {
        let (gt, info) = (self.scene.gt(self.im_id)?, self.scene.gt_info(self.im_id)?);
        let of_object = gt.iter().zip(info).enumerate().filter(|(_, (gt, _))| gt.obj_id == obj_id);
        of_object.map(|(i, (_, info))| Ok((i, self.scene.pose(self.im_id, i)?, info.visib_fract))).collect()
    }
}

impl ObjectInImage<'_> {
    fn score(&self, annotation: &Annotation, inst_count: usize, scored: &mut ScoredImage) {
        let valid = top(self.instances.iter().map(|i| i.2), inst_count);
        let compared = &self.estimates[..self.estimates.len().min(inst_count)];
        let truths = if compared.is_empty() { &[][..] } else { &valid };
        let view = &annotation.view;
        let rendered: Vec<_> =
            truths.iter().map(|&i| view.render(self.object, &self.instances[i].1)).collect();
        let errors = self.errors(view, truths, &rendered, compared);
        scored.distances.extend(valid.iter().map(|&i| self.instances[i].1.translation.norm()));
        scored.depths.extend(rendered.iter().filter_map(|window| median_depths(view, window)));
        scored.n_estimates += compared.len();
        let hits = hits(&errors, valid.len(), self.object.diameter, view.depth.width);
        let assigned = assigned_errors(&errors, valid.len());
        let (scene_id, im_id) = (annotation.scene.id, annotation.im_id);
        let rotations = annotation.options.rotations;
        for ((&instance, hits), errors) in valid.iter().zip(hits).zip(assigned) {
            let (gt_index, _, visib_fract) = self.instances[instance];
            scored.targets.push(TargetOutcome {
                scene_id,
                im_id,
                obj_id: self.obj_id,
                gt_index,
                visib_fract,
                rot_deg: rotations.and_then(|r| r.degrees(scene_id, im_id, self.obj_id)),
                diameter: self.object.diameter,
                symmetric: self.object.is_symmetric(),
                errors: errors.cloned(),
                hits,
            });
        }
        scored.ranked.push(self.ranked(annotation, &valid, &errors));
    }

    /// `[estimate][truth]`; `rendered` are the true depths of `truths`.
    fn errors(
        &self,
        view: &TestView,
        truths: &[usize],
        rendered: &[DepthWindow],
        compared: &[&PoseResult],
    ) -> Vec<Vec<PoseErrors>> {
        let of_estimate = |estimate: &&PoseResult| -> Vec<PoseErrors> {
            let pairs = truths.iter().zip(rendered);
            let t_est = &estimate.t_camera_object;
            pairs.map(|(&i, w)| PoseErrors::new(self.object, view, t_est, &self.instances[i].1, w)).collect()
        };
        compared.iter().map(of_estimate).collect()
    }

    /// The image's best estimates against all instances; `known` are those of [`Self::errors`].
    fn ranked(&self, annotation: &Annotation, valid: &[usize], known: &[Vec<PoseErrors>]) -> ObjectEstimates {
        let view = &annotation.view;
        let pixels = REFERENCE_WIDTH / f64::from(view.depth.width);
        let pair = |e: usize, i: usize| -> [f64; 2] {
            let position = valid.iter().position(|&v| v == i);
            let [mssd, mspd] = match position.and_then(|p| known.get(e)?.get(p)) {
                Some(errors) => [errors.mssd, errors.mspd],
                None => {
                    let (t_est, t_gt) = (&self.estimates[e].t_camera_object, &self.instances[i].1);
                    [mssd(self.object, t_est, t_gt), mspd(self.object, view.camera, t_est, t_gt)]
                }
            };
            [mssd / self.object.diameter, mspd * pixels]
        };
        let pairs: Vec<Vec<[f64; 2]>> =
            (0..self.ranked).map(|e| (0..self.instances.len()).map(|i| pair(e, i)).collect()).collect();
        let error = |k: usize| pairs.iter().map(|row| row.iter().map(|p| p[k]).collect()).collect();
        let counted =
            |(i, instance): (usize, &(usize, Pose, f64))| valid.contains(&i) && instance.2 >= MIN_VISIBILITY;
        ObjectEstimates {
            obj_id: self.obj_id,
            scores: self.estimates[..self.ranked].iter().map(|e| e.score).collect(),
            mssd: error(0),
            mspd: error(1),
            counted: self.instances.iter().enumerate().map(counted).collect(),
        }
    }
}

/// Measured and drawn depth of an object, metres: medians over its drawn pixels that are measured; `None` without any.
fn median_depths(view: &TestView, drawn: &DepthWindow) -> Option<[f64; 2]> {
    let b = &drawn.bounds;
    let pixels = (b.row_min..b.row_max).flat_map(|row| (b.col_min..b.col_max).map(move |col| (col, row)));
    let depths = pixels
        .map(|(col, row)| [view.depth.data[(row * view.depth.width + col) as usize], drawn.get(col, row)]);
    let [mut measured, mut posed]: [Vec<f32>; 2] =
        depths.filter(|pair| pair.iter().all(|z| *z > 0.0)).map(|[m, p]| (m, p)).unzip().into();
    let middle = measured.len() / 2;
    let median = |values: &mut [f32]| f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1);
    (!measured.is_empty()).then(|| [median(&mut measured), median(&mut posed)])
}
