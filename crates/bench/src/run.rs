//! One method on all targets.

use std::{collections::HashMap, path::Path, sync::Arc};

use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::{
    formats::{BopSplit, FormatError, ReferenceTarget, detections::Detection},
    protocol::{ImagePoses, NO_DETECTION, ObjectTargets, TargetList, TargetPoses, best_outcome},
};
use unopose_pairs::registration::{PairEstimator, PairPose, Refined, Refinement, RegistrationError};

use super::{
    BenchError,
    records::{PairOutcome, RecordKey, Records},
};

/// Images kept in memory.
const FRAMES: usize = 128;

/// A method's results on a target list.
#[derive(Clone, Debug)]
pub(crate) struct MethodRun {
    pub name: String,
    pub poses: TargetPoses,
    /// Pairs that were estimated now; the others were known.
    pub computed: usize,
    /// The relative pose and the target of every result, in the order of `poses.results`.
    pub relative: Vec<(ReferenceTarget, Pose)>,
}

/// Estimates all targets pair by pair, so that the times are those of single pairs. `cache` is the folder of the kept
/// results: a pair that is in it is not estimated again, and a new refinement after the method starts from the kept unrefined pose. A target
/// with several references takes, for each detection, the pose with the best score.
pub(crate) fn run_method(
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
    let refined_after = method.refinement != Refinement::None && !method.estimator.refines_itself();
    let mut run = Run {
        list,
        method,
        records: records(method)?,
        unrefined: refined_after.then(|| records(&unrefined)).transpose()?,
        frames: HashMap::new(),
        computed: 0,
        relative: Vec::new(),
    };
    let (mut poses, images) = (TargetPoses::default(), list.images());
    let total = images.len();
    for (done, image) in images.into_iter().enumerate() {
        progress(done, total);
        let mut made = ImagePoses::new(&mut poses, &image);
        for object in image.objects {
            run.object(object, &mut made)?;
        }
        made.finish();
    }
    progress(total, total);
    let Run { computed, relative, .. } = run;
    Ok(MethodRun { name: method.name(), poses, computed, relative })
}

struct Run<'a> {
    list: &'a TargetList,
    method: &'a Refined<'a>,
    records: Records,
    /// Those of the method without the refinement after it.
    unrefined: Option<Records>,
    frames: HashMap<(bool, u32, u32), Arc<RgbdFrame>>,
    computed: usize,
    relative: Vec<(ReferenceTarget, Pose)>,
}

impl Run<'_> {
    /// Poses of an object of an image: of its confident detections, or of the best of the others that has one.
    fn object(&mut self, mut object: ObjectTargets<'_>, made: &mut ImagePoses<'_>) -> Result<(), BenchError> {
        if !object.has_detections() {
            made.reject(object.obj_id, NO_DETECTION);
        }
        loop {
            let detections = object.next_detections();
            if detections.is_empty() {
                return Ok(());
            }
            for detection in detections {
                object.posed |= self.detection(&object.references, detection, made)?;
            }
        }
    }

    /// Whether the detection has a pose with one of the references.
    fn detection(
        &mut self,
        references: &[&ReferenceTarget],
        detection: &Detection,
        made: &mut ImagePoses<'_>,
    ) -> Result<bool, BenchError> {
        let mut outcomes = Vec::with_capacity(references.len());
        for &target in references {
            outcomes.push(match self.pair(target, detection, made)? {
                PairOutcome::Posed { t_query_reference, score, seconds } => {
                    made.add_pairs(1);
                    made.add_seconds(seconds);
                    Ok((score, (target, t_query_reference)))
                }
                PairOutcome::Rejected { reason } => Err(reason),
            });
        }
        match best_outcome(outcomes) {
            Some(Ok((score, (target, t_query_reference)))) => {
                let scene = self.list.reference_split().scene(target.ref_scene_id);
                let instance = scene.and_then(|scene| scene.most_visible(target.ref_im_id, target.obj_id));
                let t_reference_object = match instance {
                    Ok((_, t_reference_object)) => t_reference_object,
                    Err(error) => {
                        let reason = made.unread(target.ref_scene_id, target.ref_im_id, &error);
                        made.reject(detection.category_id, reason);
                        return Ok(false);
                    }
                };
                made.add_pose(detection, score, t_query_reference * t_reference_object);
                self.relative.push((target.clone(), t_query_reference));
                Ok(true)
            }
            Some(Err(reason)) => {
                made.reject(detection.category_id, reason);
                Ok(false)
            }
            None => Ok(false),
        }
    }

    /// From the records, or estimated now.
    fn pair(
        &mut self,
        target: &ReferenceTarget,
        detection: &Detection,
        made: &mut ImagePoses<'_>,
    ) -> Result<PairOutcome, BenchError> {
        let key = RecordKey::new(target, detection);
        if let Some(known) = self.records.get(&key) {
            return Ok(known.clone());
        }
        let outcome = match detection.segmentation.decode() {
            Err(error) => PairOutcome::Rejected { reason: error.to_string() },
            Ok(mask) => {
                let (frame, (reference, reference_mask)) = match self.views(target) {
                    Ok(views) => views,
                    // Not kept: the files may be whole next time.
                    Err(([scene_id, im_id], error)) => {
                        return Ok(PairOutcome::Rejected { reason: made.unread(scene_id, im_id, &error) });
                    }
                };
                let query = MaskedView { frame: &frame, mask: &mask };
                let reference = MaskedView { frame: &reference, mask: &reference_mask };
                self.estimate(&key, query, reference)?
            }
        };
        self.computed += 1;
        self.records.add(key, outcome.clone())?;
        Ok(outcome)
    }

    fn estimate(
        &mut self,
        key: &RecordKey,
        query: MaskedView,
        reference: MaskedView,
    ) -> Result<PairOutcome, FormatError> {
        if self.method.estimator.refines_itself() {
            return Ok(outcome_of(self.method.estimate(query, reference)));
        }
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
                let pair = PairPose { t_query_reference, score, seconds, confidence: None };
                outcome_of(Ok(self.method.refine(pair, query, reference)))
            }
            rejected => rejected,
        })
    }

    /// Query and reference; an error comes with scene and image.
    #[allow(clippy::type_complexity)]
    fn views(
        &mut self,
        target: &ReferenceTarget,
    ) -> Result<(Arc<RgbdFrame>, (Arc<RgbdFrame>, Mask)), ([u32; 2], FormatError)> {
        let ReferenceTarget { scene_id, im_id, ref_scene_id, ref_im_id, .. } = *target;
        let query = self.frame(false, scene_id, im_id).map_err(|error| ([scene_id, im_id], error))?;
        let reference = self.reference(target).map_err(|error| ([ref_scene_id, ref_im_id], error))?;
        Ok((query, reference))
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
}

fn outcome_of(pair: Result<PairPose, RegistrationError>) -> PairOutcome {
    match pair {
        Ok(PairPose { t_query_reference, score, seconds, .. })
            if t_query_reference.rotation_defect() < 1e-3 =>
        {
            PairOutcome::Posed { t_query_reference, score, seconds }
        }
        Ok(_) => PairOutcome::Rejected { reason: "the rotation is none".into() },
        Err(error) => PairOutcome::Rejected { reason: error.to_string() },
    }
}
