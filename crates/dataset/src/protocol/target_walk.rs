//! The walk over the targets of a list: image by image, object by object, detection by detection.

use std::collections::{BTreeMap, VecDeque};

use crate::formats::{ReferenceTarget, detections::Detection};

/// Detections scored above this get a pose; the best of the others when none of these does.
pub const MIN_DETECTION_SCORE: f64 = 0.25;

/// The targets of one image.
#[derive(Clone, Debug)]
pub struct ImageTargets<'a> {
    /// Scene of the image.
    pub scene_id: u32,
    /// The image inside its scene.
    pub im_id: u32,
    /// By ascending object id.
    pub objects: Vec<ObjectTargets<'a>>,
}

/// An object of one image, with its references and detections.
#[derive(Clone, Debug)]
pub struct ObjectTargets<'a> {
    /// The object, as in the detections' `category_id`.
    pub obj_id: u32,
    /// The list's entries of this object and image, one per reference, in the order of the list. At least one.
    pub references: Vec<&'a ReferenceTarget>,
    /// Set by the caller once a detection has given a pose: [`Self::next_detections`] ends then.
    pub posed: bool,
    /// Those not tried so far, by descending score.
    detections: VecDeque<&'a Detection>,
}

impl<'a> ImageTargets<'a> {
    /// Groups a list by ascending scene and image. Detections of other images and objects are left out.
    pub fn group(targets: &'a [ReferenceTarget], detections: &'a [Detection]) -> Vec<Self> {
        let mut images: BTreeMap<(u32, u32), BTreeMap<u32, ObjectTargets<'a>>> = BTreeMap::new();
        for target in targets {
            let objects = images.entry((target.scene_id, target.im_id)).or_default();
            let object = objects.entry(target.obj_id).or_insert_with(|| ObjectTargets {
                obj_id: target.obj_id,
                references: Vec::new(),
                posed: false,
                detections: VecDeque::new(),
            });
            object.references.push(target);
        }
        for detection in detections {
            let objects = images.get_mut(&(detection.scene_id, detection.image_id));
            if let Some(object) = objects.and_then(|objects| objects.get_mut(&detection.category_id)) {
                object.detections.push_back(detection);
            }
        }
        let image = |((scene_id, im_id), objects): ((u32, u32), BTreeMap<u32, ObjectTargets<'a>>)| {
            let mut objects: Vec<_> = objects.into_values().collect();
            for object in &mut objects {
                // The stable sort keeps the file's order among equal scores.
                object.detections.make_contiguous().sort_by(|a, b| b.score.total_cmp(&a.score));
            }
            Self { scene_id, im_id, objects }
        };
        images.into_iter().map(image).collect()
    }
}

impl<'a> ObjectTargets<'a> {
    /// Whether any detection is left to try.
    pub fn has_detections(&self) -> bool {
        !self.detections.is_empty()
    }

    /// Takes the detections to try next: the confident ones at once, then the best of the rest one by one, until
    /// [`Self::posed`] is set. Empty at the end.
    pub fn next_detections(&mut self) -> Vec<&'a Detection> {
        if self.posed {
            return Vec::new();
        }
        let confident = self.detections.iter().take_while(|d| d.score > MIN_DETECTION_SCORE).count();
        let count = confident.max(1).min(self.detections.len());
        self.detections.drain(..count).collect()
    }
}
