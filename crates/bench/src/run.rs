//! One method on all targets.

use std::{
    collections::{BTreeMap, HashMap, VecDeque},
    path::Path,
    sync::Arc,
};

use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::{
    formats::{BopSplit, FormatError, PoseResult, ReferenceTarget, detections::Detection},
    protocol::{Rejection, TargetList, TargetPoses, next_detections},
};
use unopose_pairs::registration::{PairEstimator, PairPose, Refined, Refinement, RegistrationError};

use super::{
    BenchError,
    records::{PairKey, PairOutcome, Records},
};

/// Images kept in memory.
const FRAMES: usize = 128;

/// A method's results on a target list.
#[derive(Clone, Debug)]
pub struct MethodRun {
    pub name: String,
    pub poses: TargetPoses,
    /// Pairs that were estimated now; the others were known.
    pub computed: usize,
    /// The relative pose and the target of every result, in the order of `poses.results`.
    pub relative: Vec<(ReferenceTarget, Pose)>,
}

/// Estimates all targets pair by pair, so that times are those of single pairs. What `cache` holds is not done again, nor
/// is an estimate that only waits for another refinement. A target with several references takes, for each detection, the pose with the best score.
pub fn run_method(
    list: &TargetList,
    method: &Refined,
    cache: &Path,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<MethodRun, BenchError> {
    let root = std::fs::canonicalize(list.dataset.root()).unwrap_or_else(|_| list.dataset.root().into());
    let records = |method: &Refined| {
        let identity = format!(
            "{} {} {} {} {}",
            env!("CARGO_PKG_VERSION"),
            method.fingerprint(),
            root.display(),
            list.split.name(),
            list.reference_split().name()
        );
        Records::open(cache, &method.name(), &identity)
    };
    let unrefined = Refined { refinement: Refinement::None, ..*method };
    let mut run = Run {
        list,
        method,
        records: records(method)?,
        unrefined: (method.refinement != Refinement::None).then(|| records(&unrefined)).transpose()?,
        frames: HashMap::new(),
        made: MethodRun {
            name: method.name(),
            poses: TargetPoses::default(),
            computed: 0,
            relative: Vec::new(),
        },
    };
    let mut detections: HashMap<(u32, u32, u32), Vec<&Detection>> = HashMap::new();
    for detection in &list.detections {
        let key = (detection.scene_id, detection.image_id, detection.category_id);
        detections.entry(key).or_default().push(detection);
    }
    let mut images: BTreeMap<(u32, u32), BTreeMap<u32, Vec<&ReferenceTarget>>> = BTreeMap::new();
    for target in &list.targets {
        let objects = images.entry((target.scene_id, target.im_id)).or_default();
        objects.entry(target.obj_id).or_default().push(target);
    }
    for (done, ((scene_id, im_id), objects)) in images.iter().enumerate() {
        progress(done, images.len());
        let (first, before) = (run.made.poses.results.len(), run.made.poses.seconds);
        for (obj_id, references) in objects {
            let mut detections = detections.remove(&(*scene_id, *im_id, *obj_id)).unwrap_or_default();
            // The stable sort keeps the file's order among equal scores.
            detections.sort_by(|a, b| b.score.total_cmp(&a.score));
            run.object(references, detections.into())?;
        }
        let seconds = run.made.poses.seconds - before;
        // Every line of an image repeats the time of the whole image.
        let results = &mut run.made.poses.results[first..];
        let known = results.iter().all(|r| r.time >= 0.0);
        let detection_time = results.iter().map(|r| r.time).fold(0.0, f64::max);
        results.iter_mut().for_each(|r| r.time = if known { detection_time + seconds } else { -1.0 });
    }
    progress(images.len(), images.len());
    Ok(run.made)
}

struct Run<'a> {
    list: &'a TargetList,
    method: &'a Refined<'a>,
    records: Records,
    /// Those of the method without its refinement.
    unrefined: Option<Records>,
    frames: HashMap<(bool, u32, u32), Arc<RgbdFrame>>,
    made: MethodRun,
}

impl Run<'_> {
    /// Poses of an object of an image: of its confident detections, or of the best of the others that has one.
    fn object(
        &mut self,
        references: &[&ReferenceTarget],
        mut detections: VecDeque<&Detection>,
    ) -> Result<(), BenchError> {
        if detections.is_empty() {
            references.iter().take(1).for_each(|target| self.reject(target, "no detection".into()));
        }
        let mut posed = false;
        while !posed && !detections.is_empty() {
            for detection in next_detections(&mut detections) {
                posed |= self.detection(references, detection)?;
            }
        }
        Ok(())
    }

    fn detection(
        &mut self,
        references: &[&ReferenceTarget],
        detection: &Detection,
    ) -> Result<bool, BenchError> {
        let (mut best, mut reason): (Option<(f64, Pose, &ReferenceTarget)>, _) = (None, None);
        for target in references {
            match self.pair(target, detection)? {
                PairOutcome::Posed { t_query_reference, score, seconds } => {
                    self.made.poses.pairs += 1;
                    self.made.poses.seconds += seconds;
                    if best.is_none_or(|b| score > b.0) {
                        best = Some((score, t_query_reference, target));
                    }
                }
                PairOutcome::Rejected { reason: why } => reason = Some((*target, why)),
            }
        }
        let Some((score, t_query_reference, target)) = best else {
            if let Some((target, reason)) = reason {
                self.reject(target, reason);
            }
            return Ok(false);
        };
        let scene = self.list.reference_split().scene(target.ref_scene_id)?;
        let (_, t_reference_object) = scene.most_visible(target.ref_im_id, target.obj_id)?;
        self.made.poses.results.push(PoseResult {
            scene_id: target.scene_id,
            im_id: target.im_id,
            obj_id: target.obj_id,
            score: score * detection.score,
            t_camera_object: t_query_reference * t_reference_object,
            time: detection.time,
        });
        self.made.relative.push((target.clone(), t_query_reference));
        Ok(true)
    }

    /// From the records, or estimated now.
    fn pair(&mut self, target: &ReferenceTarget, detection: &Detection) -> Result<PairOutcome, BenchError> {
        let key = PairKey::new(target, detection);
        if let Some(known) = self.records.get(&key) {
            return Ok(known.clone());
        }
        let outcome = match detection.segmentation.decode() {
            Err(error) => PairOutcome::Rejected { reason: error.to_string() },
            Ok(mask) => {
                let frame = self.frame(false, target.scene_id, target.im_id)?;
                let (reference, reference_mask) = self.reference(target)?;
                let query = MaskedView { frame: &frame, mask: &mask };
                let reference = MaskedView { frame: &reference, mask: &reference_mask };
                self.estimate(&key, query, reference)?
            }
        };
        self.made.computed += 1;
        self.records.add(key, outcome.clone())?;
        Ok(outcome)
    }

    fn estimate(
        &mut self,
        key: &PairKey,
        query: MaskedView,
        reference: MaskedView,
    ) -> Result<PairOutcome, FormatError> {
        let known = self.unrefined.as_ref().and_then(|records| records.get(key));
        let outcome = match known {
            Some(known) => known.clone(),
            None => {
                let outcome = outcome_of(self.method.estimator.estimate(query, reference));
                if let Some(records) = &mut self.unrefined {
                    records.add(key.clone(), outcome.clone())?;
                }
                outcome
            }
        };
        Ok(match outcome {
            PairOutcome::Posed { t_query_reference, score, seconds } => {
                let pair = PairPose { t_query_reference, score, seconds };
                outcome_of(Ok(self.method.refine(pair, query, reference)))
            }
            rejected => rejected,
        })
    }

    fn reference(&mut self, target: &ReferenceTarget) -> Result<(Arc<RgbdFrame>, Mask), FormatError> {
        let (scene_id, im_id) = (target.ref_scene_id, target.ref_im_id);
        let frame = self.frame(true, scene_id, im_id)?;
        let scene = self.list.reference_split().scene(scene_id)?;
        let (index, _) = scene.most_visible(im_id, target.obj_id)?;
        Ok((frame, scene.mask_visib(im_id, index)?))
    }

    fn frame(
        &mut self,
        of_reference: bool,
        scene_id: u32,
        im_id: u32,
    ) -> Result<Arc<RgbdFrame>, FormatError> {
        let split: &BopSplit = if of_reference { self.list.reference_split() } else { &self.list.split };
        let key = (of_reference, scene_id, im_id);
        if let Some(frame) = self.frames.get(&key) {
            return Ok(frame.clone());
        }
        if self.frames.len() >= FRAMES {
            self.frames.clear();
        }
        let frame = Arc::new(split.scene(scene_id)?.frame(im_id)?);
        self.frames.insert(key, frame.clone());
        Ok(frame)
    }

    fn reject(&mut self, target: &ReferenceTarget, reason: String) {
        let ReferenceTarget { scene_id, im_id, obj_id, .. } = *target;
        self.made.poses.rejections.push(Rejection { scene_id, im_id, obj_id, reason });
    }
}

fn outcome_of(pair: Result<PairPose, RegistrationError>) -> PairOutcome {
    match pair {
        Ok(PairPose { t_query_reference, score, seconds }) if t_query_reference.rotation_defect() < 1e-3 => {
            PairOutcome::Posed { t_query_reference, score, seconds }
        }
        Ok(_) => PairOutcome::Rejected { reason: "the rotation is none".into() },
        Err(error) => PairOutcome::Rejected { reason: error.to_string() },
    }
}
