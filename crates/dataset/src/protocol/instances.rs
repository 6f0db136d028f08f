//! Annotated instances as targets and as reference views.

use std::{path::PathBuf, sync::Arc};

use unopose_core::geometry::Pose;

use crate::formats::{BopScene, BopSplit, FormatError, Target};

/// Targets: at least this visible share, and this many pixels in an image 640 pixels wide.
const TARGET: (f64, f64) = (0.1, 150.0);
/// The same for references.
const REFERENCE: (f64, f64) = (0.7, 900.0);

/// An annotated instance.
pub(crate) struct AnnotatedInstance {
    pub scene_id: u32,
    pub im_id: u32,
    pub instance: usize,
    pub obj_id: u32,
    pub t_camera_object: Pose,
    pub visib_fract: f64,
    px_count_visib: f64,
    /// Pixels of the image, of one 640 pixels wide with square pixels.
    scale: f64,
    /// The silhouette does not touch the border.
    whole: bool,
    /// The scene's folder: scenes of different splits may have the same number.
    scene: Arc<PathBuf>,
}

impl AnnotatedInstance {
    pub(crate) fn can_be_target(&self) -> bool {
        self.passes(TARGET)
    }

    /// Occluded by less than 30 %, large enough, and not cut by the border.
    pub(crate) fn can_be_reference(&self) -> bool {
        self.whole && self.passes(REFERENCE)
    }

    fn passes(&self, (visib_fract, pixels): (f64, f64)) -> bool {
        self.visib_fract >= visib_fract && self.px_count_visib >= pixels * self.scale
    }

    pub(crate) fn in_scene_of(&self, other: &Self) -> bool {
        self.scene == other.scene
    }

    pub(crate) fn in_image_of(&self, other: &Self) -> bool {
        self.im_id == other.im_id && self.in_scene_of(other)
    }

    /// The image, for sets.
    pub(crate) fn image(&self) -> (Arc<PathBuf>, u32) {
        (self.scene.clone(), self.im_id)
    }
}

/// All annotated instances of a split, by scene and image. Scenes and images that cannot be read are left out, each with a
/// warning.
pub(crate) fn annotated_instances(split: &BopSplit) -> Result<Vec<AnnotatedInstance>, FormatError> {
    let mut found = Found::default();
    for &scene_id in split.scene_ids() {
        let scene = match split.scene(scene_id) {
            Ok(scene) => scene,
            Err(error) => {
                found.leave_out(error);
                continue;
            }
        };
        // The images of a scene are from one camera.
        let size = scene.image_ids().find_map(|im_id| scene.image_size(im_id).ok());
        let folder = Arc::new(scene.folder.clone());
        for im_id in scene.image_ids() {
            if !scene.is_annotated(im_id) {
                found.error = scene.gt(im_id).err().or(found.error);
                continue;
            }
            let size = size.map_or_else(|| scene.image_size(im_id), Ok);
            match size.and_then(|size| instances_in_image(&scene, im_id, size, &folder)) {
                Ok(instances) => found.instances.extend(instances),
                Err(error) => found.leave_out(error),
            }
        }
    }
    found.finish()
}

/// The most visible instance of every target. Those whose images cannot be read are left out, each with a warning.
pub(crate) fn target_instances(
    split: &BopSplit,
    targets: &[Target],
) -> Result<Vec<AnnotatedInstance>, FormatError> {
    let mut found = Found::default();
    let instance = |target: &Target| -> Result<Option<AnnotatedInstance>, FormatError> {
        let scene = split.scene(target.scene_id)?;
        let size = scene.image_size(target.im_id)?;
        let instances = instances_in_image(&scene, target.im_id, size, &Arc::new(scene.folder.clone()))?;
        let (best, _) = scene.most_visible(target.im_id, target.obj_id)?;
        Ok(instances.into_iter().nth(best))
    };
    for target in targets {
        match instance(target) {
            Ok(instance) => found.instances.extend(instance),
            Err(error) => found.leave_out(error),
        }
    }
    found.finish()
}

/// Instances, and why others are not among them.
#[derive(Default)]
struct Found {
    instances: Vec<AnnotatedInstance>,
    error: Option<FormatError>,
}

impl Found {
    fn leave_out(&mut self, error: FormatError) {
        tracing::warn!("{error}: left out");
        self.error = Some(error);
    }

    /// An error when there are no instances because of one.
    fn finish(self) -> Result<Vec<AnnotatedInstance>, FormatError> {
        match self.error {
            Some(error) if self.instances.is_empty() => Err(error),
            _ => Ok(self.instances),
        }
    }
}

fn instances_in_image(
    scene: &BopScene,
    im_id: u32,
    (width, height): (u32, u32),
    folder: &Arc<PathBuf>,
) -> Result<Vec<AnnotatedInstance>, FormatError> {
    let (width, height) = (width as i32, height as i32);
    let instances = scene.gt(im_id)?.iter().zip(scene.gt_info(im_id)?).enumerate();
    instances
        .map(|(instance, (gt, info))| {
            let [x, y, w, h] = info.bbox_obj;
            Ok(AnnotatedInstance {
                scene_id: scene.id,
                im_id,
                instance,
                obj_id: gt.obj_id,
                t_camera_object: scene.pose(im_id, instance)?,
                visib_fract: info.visib_fract,
                px_count_visib: info.px_count_visib.into(),
                scale: (f64::from(width) / 640.0).powi(2),
                whole: x > 0 && y > 0 && x + w < width - 1 && y + h < height - 1,
                scene: folder.clone(),
            })
        })
        .collect()
}
