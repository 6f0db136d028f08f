//! The objects of a target list as a matcher keeps them, made on demand from their views.

use std::{collections::BTreeMap, fmt, sync::Arc};

use unopose_core::frame::MaskedView;
use unopose_dataset::formats::{BopSplit, ReferenceTarget};
use unopose_infer::InferError;

use super::{Matcher, SegmentError, Templates};

/// Objects kept in memory at most.
const KEPT_OBJECTS: usize = 64;

/// Where the views of a target's object come from.
#[derive(Clone, Copy, Debug)]
pub enum ObjectViews<'a> {
    /// The reference view of the target.
    References(&'a BopSplit),
    /// The object's CAD model.
    Templates(&'a Templates<'a>),
}

/// Which views show an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ObjectKey {
    /// The most visible instance of an object in a reference image.
    Reference {
        /// Scene of the reference image.
        scene_id: u32,
        /// The reference image in the scene.
        im_id: u32,
        /// The object.
        obj_id: u32,
    },
    /// Templates of a CAD model.
    Model {
        /// The object.
        obj_id: u32,
    },
}

impl fmt::Display for ObjectKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reference { scene_id, im_id, obj_id } => {
                write!(f, "reference scene {scene_id} image {im_id} object {obj_id}")
            }
            Self::Model { obj_id } => write!(f, "templates of object {obj_id}"),
        }
    }
}

impl ObjectViews<'_> {
    /// What shows the object of a target.
    pub fn key(&self, target: &ReferenceTarget) -> ObjectKey {
        let obj_id = target.obj_id;
        match self {
            Self::References(_) => {
                ObjectKey::Reference { scene_id: target.ref_scene_id, im_id: target.ref_im_id, obj_id }
            }
            Self::Templates(_) => ObjectKey::Model { obj_id },
        }
    }

    /// Everything that decides about the views of a key.
    pub fn fingerprint(&self) -> String {
        match self {
            Self::References(split) => format!("{} {}", split.folder().display(), split.name()),
            Self::Templates(templates) => templates.fingerprint(),
        }
    }

    fn object<M: Matcher>(&self, target: &ReferenceTarget, matcher: &M) -> Result<M::Object, SegmentError> {
        match self {
            Self::References(split) => of_reference(split, target, matcher),
            Self::Templates(templates) => {
                let views = templates.views(target.obj_id)?;
                let views: Vec<MaskedView> =
                    views.iter().map(|(frame, mask)| MaskedView { frame, mask }).collect();
                matcher.object(&views)
            }
        }
    }
}

/// The most visible instance in the reference image.
fn of_reference<M: Matcher>(
    split: &BopSplit,
    target: &ReferenceTarget,
    matcher: &M,
) -> Result<M::Object, SegmentError> {
    let (im_id, obj_id) = (target.ref_im_id, target.obj_id);
    let scene = split.scene(target.ref_scene_id)?;
    let (index, _) = scene.most_visible(im_id, obj_id)?;
    let (frame, mask) = (scene.frame(im_id)?, scene.mask_visib(im_id, index)?);
    matcher.object(&[MaskedView { frame: &frame, mask: &mask }])
}

/// Objects by key, made when they are first asked for.
pub struct ObjectCache<'a, M: Matcher> {
    matcher: &'a M,
    views: &'a ObjectViews<'a>,
    kept: BTreeMap<ObjectKey, Arc<M::Object>>,
    unusable: BTreeMap<ObjectKey, String>,
}

impl<'a, M: Matcher> ObjectCache<'a, M> {
    /// No objects yet.
    pub fn new(matcher: &'a M, views: &'a ObjectViews<'a>) -> Self {
        Self { matcher, views, kept: BTreeMap::new(), unusable: BTreeMap::new() }
    }

    /// The object of a target; `None`, with the reason noted, when its views are of no use.
    pub fn get(&mut self, target: &ReferenceTarget) -> Result<Option<Arc<M::Object>>, SegmentError> {
        let key = self.views.key(target);
        if let Some(object) = self.kept.get(&key) {
            return Ok(Some(object.clone()));
        }
        if self.unusable.contains_key(&key) {
            return Ok(None);
        }
        match self.views.object(target, self.matcher) {
            Ok(object) => {
                if self.kept.len() >= KEPT_OBJECTS {
                    self.kept.pop_first();
                }
                let object = Arc::new(object);
                self.kept.insert(key, object.clone());
                Ok(Some(object))
            }
            Err(error @ (SegmentError::Reference { .. } | SegmentError::Infer(InferError::Reference(_)))) => {
                self.unusable.insert(key, error.to_string());
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// The objects whose views could not be used, with the reason.
    pub fn into_unusable(self) -> Vec<(ObjectKey, String)> {
        self.unusable.into_iter().collect()
    }
}
