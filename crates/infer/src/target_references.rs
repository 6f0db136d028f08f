//! The reference views of a target list with the true poses of their objects.

use std::{collections::BTreeMap, sync::Arc};

use unopose_core::geometry::Pose;
use unopose_dataset::formats::{BopSplit, ReferenceTarget};

use super::{
    InferError, PoseEstimator, Reference,
    experiment::ReferenceColor,
    reference::ReferenceCache,
    streams::{self, stream},
};

/// Memory for references that may be used again.
const CACHE_BYTES: usize = 1 << 30;

/// The object of a reference view: scene, image, object.
type ReferenceKey = (u32, u32, u32);

/// Reference views, made on demand.
pub struct TargetReferences<'a> {
    estimator: &'a PoseEstimator,
    split: &'a BopSplit,
    color: ReferenceColor,
    cache: ReferenceCache<ReferenceKey>,
    /// Why a view cannot be used.
    unusable: BTreeMap<ReferenceKey, String>,
    /// Number of references made.
    pub(crate) made: usize,
    /// Seconds that this took.
    pub(crate) seconds: f64,
}

/// A reference with the object's pose in its camera.
pub type PosedReference = (Arc<Reference>, Pose);

impl<'a> TargetReferences<'a> {
    /// None so far; the network will see them with these colours.
    pub fn new(estimator: &'a PoseEstimator, split: &'a BopSplit, color: ReferenceColor) -> Self {
        let cache = ReferenceCache::new(CACHE_BYTES);
        Self { estimator, split, color, cache, unusable: BTreeMap::new(), made: 0, seconds: 0.0 }
    }

    /// The most visible instance of the target's object in its reference view. The inner error is about the view's
    /// content; absent files and annotations are the outer one.
    pub fn get(&mut self, target: &ReferenceTarget) -> Result<Result<PosedReference, String>, InferError> {
        let key = (target.ref_scene_id, target.ref_im_id, target.obj_id);
        let (scene_id, im_id, obj_id) = key;
        if let Some(reason) = self.unusable.get(&key) {
            return Ok(Err(reason.clone()));
        }
        let scene = self.split.scene(scene_id)?;
        let (index, t_reference_object) = scene.most_visible(im_id, obj_id)?;
        if let Some(reference) = self.cache.get(key) {
            return Ok(Ok((reference, t_reference_object)));
        }
        let (frame, mask) = (scene.frame(im_id)?, scene.mask_visib(im_id, index)?);
        let mut rng = stream(self.estimator.seed, streams::SHUFFLED_COLORS);
        let frame = self.color.apply(&frame, &mask, &mut rng);
        match self.estimator.reference(&frame, &mask) {
            Ok(reference) => {
                self.made += 1;
                self.seconds += reference.seconds();
                let reference = Arc::new(reference);
                self.cache.put(key, reference.clone());
                Ok(Ok((reference, t_reference_object)))
            }
            Err(InferError::Reference(error)) => {
                let reason = format!("reference scene {scene_id} image {im_id}: {error}");
                self.unusable.insert(key, reason.clone());
                Ok(Err(reason))
            }
            Err(error) => Err(error),
        }
    }
}
