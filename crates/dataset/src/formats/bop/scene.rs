//! One scene: its annotation, images and masks.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Once, OnceLock},
};

use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::Pose,
};

use super::{
    super::{
        FormatError, Instance,
        camera::{BOP_DEPTH_SCALE, Camera, CameraRecord, read_camera},
        image_io::{image_size, read_depth, read_mask, read_rgb},
        numbered::numbered_file,
    },
    entries::Entries,
    layout::SceneFiles,
    records::{GtInfoRecord, GtRecord},
    visibility::{Silhouette, SilhouetteModels, gt_info},
};

/// The parsed annotation of a scene, by image id. An image whose entry is broken is an error when it is asked for.
#[derive(Debug)]
pub struct BopScene {
    /// Number of the scene, that of its folder.
    pub id: u32,
    /// `<split>/SSSSSS`.
    pub folder: PathBuf,
    files: SceneFiles,
    cameras: Entries<CameraRecord>,
    /// Depth scale of entries that have none: the dataset's, else BOP's default.
    depth_scale: f64,
    gt: Entries<Vec<GtRecord>>,
    gt_info: Entries<Vec<GtInfoRecord>>,
    /// Visibility of the images that `scene_gt_info.json` lacks.
    derived_info: BTreeMap<u32, OnceLock<Vec<GtInfoRecord>>>,
    models: Arc<SilhouetteModels>,
    /// The notice that silhouettes are unknown.
    notice: Once,
}

/// The depth scale of the dataset's `camera.json`, for scenes whose cameras have none; BOP's default, with a warning, where
/// that file does not say either.
fn dataset_depth_scale(files: &SceneFiles) -> Result<f64, FormatError> {
    let root = files.folder.parent().and_then(Path::parent);
    let name = format!("{}.json", files.name("camera"));
    let file = root.map(|root| root.join(&name)).filter(|path| path.is_file());
    let given = file.map(|path| read_camera(&path)).transpose()?.and_then(|camera| camera.depth_scale);
    Ok(given.unwrap_or_else(|| {
        let place = files.json("scene_camera");
        tracing::warn!(
            "{} has no depth_scale, and no {name} of the dataset gives one: {BOP_DEPTH_SCALE} mm per unit is taken",
            place.display()
        );
        BOP_DEPTH_SCALE
    }))
}

impl BopScene {
    pub(super) fn open(
        id: u32,
        files: SceneFiles,
        models: Arc<SilhouetteModels>,
    ) -> Result<Self, FormatError> {
        fn optional<T: serde::de::DeserializeOwned>(path: PathBuf) -> Result<Entries<T>, FormatError> {
            if path.is_file() { Entries::read(&path) } else { Ok(Entries::absent(path)) }
        }
        let cameras = Entries::<CameraRecord>::read(&files.json("scene_camera"))?;
        let complete = cameras.readable().all(|camera| camera.depth_scale.is_some());
        let gt: Entries<Vec<GtRecord>> = optional(files.json("scene_gt"))?;
        let gt_info: Entries<Vec<GtInfoRecord>> = optional(files.json("scene_gt_info"))?;
        let derived_info =
            gt.image_ids().filter(|&id| !gt_info.contains(id)).map(|id| (id, OnceLock::new())).collect();
        Ok(Self {
            id,
            depth_scale: if complete { BOP_DEPTH_SCALE } else { dataset_depth_scale(&files)? },
            folder: files.folder.clone(),
            files,
            cameras,
            gt,
            gt_info,
            derived_info,
            models,
            notice: Once::new(),
        })
    }

    /// Images of the scene, sorted.
    pub fn image_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.cameras.image_ids()
    }

    /// Intrinsics and depth scale of an image.
    pub fn camera(&self, im_id: u32) -> Result<Camera, FormatError> {
        self.cameras.get(im_id)?.check(&self.cameras.place(im_id))
    }

    /// `scene_camera.json`, or that of the sensor.
    pub fn camera_file(&self) -> &Path {
        self.cameras.path()
    }

    /// `scene_gt.json`, or that of the sensor.
    pub fn gt_file(&self) -> &Path {
        self.gt.path()
    }

    /// Does [`Self::gt_file`] say what the image shows? Not in the test images of datasets that keep this to themselves.
    pub fn is_annotated(&self, im_id: u32) -> bool {
        self.gt.contains(im_id)
    }

    /// Poses of an image in the order of the file, millimetres. An error when the image has no annotation.
    pub fn gt(&self, im_id: u32) -> Result<&[GtRecord], FormatError> {
        Ok(self.gt.get(im_id)?)
    }

    /// Number of annotated images that a `scene_gt_info.json` has no entry for.
    pub fn images_without_info(&self) -> usize {
        self.derived_info.len()
    }

    /// Visibility of the instances of [`Self::gt`]; where `scene_gt_info.json` has no entry, from the masks.
    pub fn gt_info(&self, im_id: u32) -> Result<&[GtInfoRecord], FormatError> {
        let expected = self.gt(im_id)?.len();
        if let Some(derived) = self.derived_info.get(&im_id) {
            if let Some(infos) = derived.get() {
                return Ok(infos);
            }
            let infos = self.info_from_masks(im_id)?;
            return Ok(derived.get_or_init(|| infos));
        }
        let infos = self.gt_info.get(im_id)?;
        let wrong = |field: String, value: String, expected: &str| {
            Err(FormatError::field(self.gt_info.place(im_id), field, value, expected))
        };
        if infos.len() != expected {
            let expected = format!("{expected} as in {}", self.gt.path().display());
            return wrong("number of instances".into(), infos.len().to_string(), &expected);
        }
        // Counts that were not taken on the same silhouette may come out a little above 1.
        let unlikely = |info: &GtInfoRecord| !(0.0..=1.01).contains(&info.visib_fract);
        if let Some(index) = infos.iter().position(unlikely) {
            let value = infos[index].visib_fract.to_string();
            return wrong(format!("visib_fract of instance {index}"), value, "a share from 0 to 1");
        }
        Ok(infos)
    }

    fn info_from_masks(&self, im_id: u32) -> Result<Vec<GtInfoRecord>, FormatError> {
        let depth = self.depth(im_id).ok();
        let info = |(index, gt): (usize, &GtRecord)| -> Result<GtInfoRecord, FormatError> {
            let visible = self.mask_visib(im_id, index)?;
            let whole = self.mask_path("mask", im_id, index);
            let silhouette = if whole.is_file() {
                Silhouette::of_mask(Cow::Owned(read_mask(&whole)?), &visible)
            } else if let Some(mesh) = self.models.get(gt.obj_id) {
                let (pose, camera) = (self.pose(im_id, index)?, self.camera(im_id)?.intrinsics);
                Silhouette::of_mesh(mesh, pose, camera, &visible)
            } else {
                self.notice.call_once(|| {
                    tracing::warn!(
                        "{} has no scene_gt_info.json, no mask/ and no models: objects count as not occluded",
                        self.folder.display()
                    );
                });
                Silhouette::of_mask(Cow::Borrowed(&visible), &visible)
            };
            Ok(gt_info(&silhouette, &visible, depth.as_ref()))
        };
        let infos = self.gt(im_id)?.iter().enumerate().map(info).collect::<Result<_, _>>();
        let absent = || {
            format!("{} has no image {im_id}, and its masks cannot be read", self.gt_info.path().display())
        };
        infos.map_err(|error| error.within(absent()))
    }

    /// Object to camera, metres.
    pub fn pose(&self, im_id: u32, instance: usize) -> Result<Pose, FormatError> {
        let place = format!("{} instance {instance}", self.gt.place(im_id));
        match self.gt(im_id)?.get(instance) {
            Some(gt) => gt.pose(&place),
            None => Err(FormatError::missing(self.gt.place(im_id), format!("instance {instance}"), "")),
        }
    }

    /// Number and pose (object to camera) of the most visible instance of an object in an image; an error when it has none.
    pub fn most_visible(&self, im_id: u32, obj_id: u32) -> Result<(usize, Pose), FormatError> {
        let instances = self.gt(im_id)?.iter().zip(self.gt_info(im_id)?).enumerate();
        let of_object = instances.filter(|(_, (gt, _))| gt.obj_id == obj_id);
        let best = of_object.max_by(|(_, a), (_, b)| a.1.visib_fract.total_cmp(&b.1.visib_fract));
        let Some((instance, _)) = best else {
            return Err(FormatError::missing(
                self.gt.place(im_id),
                format!("object {obj_id}"),
                "a list names it",
            ));
        };
        Ok((instance, self.pose(im_id, instance)?))
    }

    /// Colour (or gray), depth and camera of an image.
    pub fn frame(&self, im_id: u32) -> Result<RgbdFrame, FormatError> {
        let rgb = read_rgb(&self.color_path(im_id)?)?;
        let (depth, camera) = (self.depth(im_id)?, self.camera(im_id)?);
        camera.check_size(&self.cameras.place(im_id), rgb.dimensions())?;
        if (depth.width, depth.height) != rgb.dimensions() {
            let size = format!("{} x {}", depth.width, depth.height);
            let expected = format!("that of the colour image, {} x {}", rgb.width(), rgb.height());
            let place = format!("{}: image {im_id}", self.folder.join(self.files.name("depth")).display());
            return Err(FormatError::field(place, "size", size, expected));
        }
        Ok(RgbdFrame { rgb, depth, intrinsics: camera.intrinsics })
    }

    /// Width and height of the colour (or gray) image.
    pub fn image_size(&self, im_id: u32) -> Result<(u32, u32), FormatError> {
        image_size(&self.color_path(im_id)?)
    }

    fn color_path(&self, im_id: u32) -> Result<PathBuf, FormatError> {
        self.image_path(im_id, &["rgb", "gray"], &["png", "jpg", "jpeg", "tif", "tiff"])
    }

    /// Depth of an image, metres.
    pub fn depth(&self, im_id: u32) -> Result<DepthMap, FormatError> {
        let path = self.image_path(im_id, &["depth"], &["png", "tif", "tiff"])?;
        read_depth(&path, self.camera(im_id)?.depth_scale.unwrap_or(self.depth_scale))
    }

    /// Visible mask of an instance.
    pub fn mask_visib(&self, im_id: u32, instance: usize) -> Result<Mask, FormatError> {
        read_mask(&self.mask_path("mask_visib", im_id, instance))
    }

    /// File of an instance's mask; `kind` is `mask` (the whole silhouette) or `mask_visib`.
    pub fn mask_path(&self, kind: &str, im_id: u32, instance: usize) -> PathBuf {
        let folder = self.folder.join(self.files.name(kind));
        numbered_file(&folder, |digits| format!("{im_id:0digits$}_{instance:0digits$}.png"))
    }

    /// An annotated instance with its visible mask.
    pub fn instance(&self, im_id: u32, instance: usize) -> Result<Instance, FormatError> {
        let t_camera_object = self.pose(im_id, instance)?;
        let (gt, info) = (&self.gt(im_id)?[instance], &self.gt_info(im_id)?[instance]);
        Ok(Instance {
            obj_id: gt.obj_id,
            t_camera_object,
            visib_fract: info.visib_fract,
            px_count_visib: info.px_count_visib,
            mask_visib: self.mask_visib(im_id, instance)?,
        })
    }

    fn image_path(&self, im_id: u32, folders: &[&str], extensions: &[&str]) -> Result<PathBuf, FormatError> {
        let folders: Vec<String> = folders.iter().map(|folder| self.files.name(folder)).collect();
        let path = |folder: &str, ext: &str| {
            numbered_file(&self.folder.join(folder), |digits| format!("{im_id:0digits$}.{ext}"))
        };
        let candidates =
            folders.iter().flat_map(|folder| extensions.iter().map(move |ext| path(folder, ext)));
        candidates.into_iter().find(|path| path.is_file()).ok_or_else(|| {
            let missing = format!("{}/{im_id:06}.{}", folders.join("|"), extensions.join("|"));
            FormatError::missing(self.folder.display(), missing, "")
        })
    }
}
