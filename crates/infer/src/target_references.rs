//! The reference views of a target list with the true poses of their objects.

use std::{collections::BTreeMap, error::Error, sync::Arc};

use unopose_core::geometry::Pose;
use unopose_dataset::{
    formats::{BopSplit, FormatError, ReferenceTarget},
    protocol::UnreadImages,
};

use super::{
    PoseEstimator, Reference,
    experiment::ReferenceColor,
    recently_used::RecentlyUsed,
    streams::{self, stream},
};

/// Memory for references that may be used again, however long the list is: about 75 of them in the default network.
const CACHE_BYTES: usize = 256 << 20;

/// The object of a reference view: scene, image, object.
type ReferenceKey = (u32, u32, u32);

/// Reference views, made on demand.
pub struct TargetReferences<'a> {
    estimator: &'a PoseEstimator,
    split: &'a BopSplit,
    color: ReferenceColor,
    cache: RecentlyUsed<ReferenceKey, Reference>,
    /// Why a view cannot be used.
    unusable: BTreeMap<ReferenceKey, String>,
    /// Views that could not be read.
    pub(crate) unread: UnreadImages,
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
        Self {
            estimator,
            split,
            color,
            cache: RecentlyUsed::new(CACHE_BYTES),
            unusable: BTreeMap::new(),
            unread: UnreadImages::default(),
            made: 0,
            seconds: 0.0,
        }
    }

    /// The most visible instance of the target's object in its reference view, or why there is none: the view cannot be read,
    /// or shows too little.
    pub fn get(&mut self, target: &ReferenceTarget) -> Result<PosedReference, String> {
        let key = (target.ref_scene_id, target.ref_im_id, target.obj_id);
        if let Some(reason) = self.unusable.get(&key) {
            return Err(reason.clone());
        }
        let made = self.kept_or_made(key);
        if let Err(reason) = &made {
            self.unusable.insert(key, reason.clone());
        }
        made
    }

    fn kept_or_made(&mut self, key: ReferenceKey) -> Result<PosedReference, String> {
        let (scene_id, im_id, obj_id) = key;
        let unread = |unread: &mut UnreadImages, error: FormatError| {
            format!("reference cannot be read: {}", unread.add(scene_id, im_id, &error))
        };
        let instance = self.split.scene(scene_id).and_then(|scene| {
            let (index, t_reference_object) = scene.most_visible(im_id, obj_id)?;
            Ok((scene, index, t_reference_object))
        });
        let (scene, index, t_reference_object) = instance.map_err(|e| unread(&mut self.unread, e))?;
        if let Some(reference) = self.cache.get(key) {
            return Ok((reference, t_reference_object));
        }
        let view = scene.frame(im_id).and_then(|frame| Ok((frame, scene.mask_visib(im_id, index)?)));
        let (frame, mask) = view.map_err(|e| unread(&mut self.unread, e))?;
        let mut rng = stream(self.estimator.seed, streams::SHUFFLED_COLORS);
        let frame = self.color.apply(&frame, &mask, &mut rng);
        let reference = self.estimator.reference(&frame, &mask);
        let reference = reference.map_err(|error| {
            let error = error.source().map_or_else(|| error.to_string(), ToString::to_string);
            format!("reference scene {scene_id} image {im_id}: {error}")
        })?;
        self.made += 1;
        self.seconds += reference.seconds();
        let reference = Arc::new(reference);
        self.cache.put(key, reference.clone(), reference.bytes());
        Ok((reference, t_reference_object))
    }
}
