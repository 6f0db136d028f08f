//! One split: its scenes and their images.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::Pose,
};

use super::{
    super::{
        AnnotatedFrame, FormatError, Instance,
        camera::{BOP_DEPTH_SCALE, Camera, CameraRecord, read_camera},
        files::read_json,
        image_io::{image_size, read_depth, read_mask, read_rgb},
    },
    records::{GtInfoRecord, GtRecord},
};

/// A split folder, or several whose scenes have different numbers. Scenes are parsed on first use and kept; loading is
/// thread-safe.
#[derive(Debug)]
pub struct BopSplit {
    folder: PathBuf,
    name: String,
    scene_ids: Vec<u32>,
    /// The split folder of every scene.
    places: BTreeMap<u32, PathBuf>,
    scenes: Mutex<BTreeMap<u32, Arc<BopScene>>>,
}

/// The parsed annotation of a scene, by image id.
#[derive(Debug)]
pub struct BopScene {
    /// Number of the scene, that of its folder.
    pub id: u32,
    /// `<split>/SSSSSS`.
    pub folder: PathBuf,
    cameras: BTreeMap<u32, CameraRecord>,
    /// Depth scale of entries that have none: the dataset's, else BOP's default.
    depth_scale: f64,
    gt: BTreeMap<u32, Vec<GtRecord>>,
    gt_info: BTreeMap<u32, Vec<GtInfoRecord>>,
}

/// Scene ids of a split folder: its numeric subfolders with a `scene_camera.json`.
pub(super) fn scene_folders(split: &Path) -> Result<Vec<u32>, FormatError> {
    let entries = std::fs::read_dir(split).map_err(|e| FormatError::io(split, e))?;
    let mut ids: Vec<u32> = entries
        .filter_map(|entry| {
            let entry = entry.ok()?;
            let id = entry.file_name().to_str()?.parse().ok()?;
            entry.path().join("scene_camera.json").is_file().then_some(id)
        })
        .collect();
    ids.sort_unstable();
    Ok(ids)
}

/// The depth scale of the dataset's `camera.json`, for scenes whose cameras have none; BOP's default, with a warning, where
/// that file does not say either.
fn dataset_depth_scale(split: &Path, scene: &Path) -> Result<f64, FormatError> {
    let file = split.parent().map(|root| root.join("camera.json")).filter(|path| path.is_file());
    let given = file.map(|path| read_camera(&path)).transpose()?.and_then(|camera| camera.depth_scale);
    Ok(given.unwrap_or_else(|| {
        let place = scene.join("scene_camera.json");
        tracing::warn!(
            "{} has no depth_scale, and no camera.json of the dataset gives one: {BOP_DEPTH_SCALE} mm per unit is taken",
            place.display()
        );
        BOP_DEPTH_SCALE
    }))
}

impl BopSplit {
    /// Finds the scenes of a split folder; an error when there are none.
    pub fn open(folder: &Path) -> Result<Self, FormatError> {
        let scene_ids = scene_folders(folder)?;
        if scene_ids.is_empty() {
            let hint = "expected folders named SSSSSS with scene_camera.json";
            return Err(FormatError::missing(folder.display(), "scenes", hint));
        }
        let name = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let places = scene_ids.iter().map(|&id| (id, folder.to_path_buf())).collect();
        Ok(Self { folder: folder.to_path_buf(), name, scene_ids, places, scenes: Mutex::default() })
    }

    /// With the scenes of another split that this one has not.
    pub(crate) fn joined(mut self, other: Self) -> Self {
        self.name = format!("{},{}", self.name, other.name);
        for (id, place) in other.places {
            self.places.entry(id).or_insert(place);
        }
        self.scene_ids = self.places.keys().copied().collect();
        self
    }

    /// The first folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Name of the split, e.g. `test`; those of joined ones are separated by commas.
    pub fn name(&self) -> String {
        self.name.clone()
    }

    /// Does its first scene say where the objects are?
    pub(super) fn is_annotated(&self) -> bool {
        let first = self.places.iter().next();
        first.is_some_and(|(id, place)| place.join(format!("{id:06}/scene_gt.json")).is_file())
    }

    /// Sorted.
    pub fn scene_ids(&self) -> &[u32] {
        &self.scene_ids
    }

    /// The annotation of a scene.
    pub fn scene(&self, id: u32) -> Result<Arc<BopScene>, FormatError> {
        // A poisoned map only means that another thread panicked; its entries are whole.
        let scenes = || self.scenes.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(scene) = scenes().get(&id) {
            return Ok(scene.clone());
        }
        let Some(place) = self.places.get(&id) else {
            let hint = format!("scenes {:?}", self.scene_ids);
            return Err(FormatError::missing(self.folder.display(), format!("scene {id}"), hint));
        };
        let scene = Arc::new(BopScene::open(place, id)?);
        Ok(scenes().entry(id).or_insert(scene).clone())
    }

    /// Colour, depth, camera and all annotated instances with their visible masks.
    pub fn load(&self, scene_id: u32, im_id: u32) -> Result<AnnotatedFrame, FormatError> {
        let scene = self.scene(scene_id)?;
        let frame = scene.frame(im_id)?;
        let count = scene.gt.get(&im_id).map_or(0, Vec::len);
        let instances =
            (0..count).map(|index| scene.instance(im_id, index)).collect::<Result<Vec<_>, _>>()?;
        for (index, instance) in instances.iter().enumerate() {
            let mask = &instance.mask_visib;
            if (mask.width, mask.height) != (frame.width(), frame.height()) {
                let size = |w, h| format!("{w} x {h}");
                return Err(FormatError::field(
                    scene.place(im_id, index),
                    "mask size",
                    size(mask.width, mask.height),
                    format!("that of the image, {}", size(frame.width(), frame.height())),
                ));
            }
        }
        Ok(AnnotatedFrame { frame, instances })
    }
}

impl BopScene {
    fn open(split: &Path, id: u32) -> Result<Self, FormatError> {
        let folder = split.join(format!("{id:06}"));
        let optional = |name: &str| Some(folder.join(name)).filter(|path| path.is_file());
        let cameras: BTreeMap<u32, CameraRecord> = read_json(&folder.join("scene_camera.json"))?;
        let complete = cameras.values().all(|camera| camera.depth_scale.is_some());
        Ok(Self {
            id,
            depth_scale: if complete { BOP_DEPTH_SCALE } else { dataset_depth_scale(split, &folder)? },
            cameras,
            gt: optional("scene_gt.json").map_or(Ok(BTreeMap::new()), |path| read_json(&path))?,
            gt_info: optional("scene_gt_info.json").map_or(Ok(BTreeMap::new()), |path| read_json(&path))?,
            folder,
        })
    }

    /// Images of the scene, sorted.
    pub fn image_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.cameras.keys().copied()
    }

    /// Intrinsics and depth scale of an image.
    pub fn camera(&self, im_id: u32) -> Result<Camera, FormatError> {
        let path = self.folder.join("scene_camera.json");
        match self.cameras.get(&im_id) {
            Some(record) => record.check(&format!("{}: image {im_id}", path.display())),
            None => Err(FormatError::missing(path.display(), format!("image {im_id}"), "")),
        }
    }

    /// Poses of an image in the order of the file, millimetres. An error when the image has no annotation.
    pub fn gt(&self, im_id: u32) -> Result<&[GtRecord], FormatError> {
        Self::entries(&self.gt, im_id, &self.folder.join("scene_gt.json"))
    }

    /// Visibility of the instances of [`Self::gt`].
    pub fn gt_info(&self, im_id: u32) -> Result<&[GtInfoRecord], FormatError> {
        let path = self.folder.join("scene_gt_info.json");
        let infos = Self::entries(&self.gt_info, im_id, &path)?;
        let expected = self.gt(im_id)?.len();
        if infos.len() != expected {
            let place = format!("{}: image {im_id}", path.display());
            let expected = format!("{expected} as in scene_gt.json");
            return Err(FormatError::field(place, "number of instances", infos.len(), expected));
        }
        Ok(infos)
    }

    fn entries<'a, T>(
        map: &'a BTreeMap<u32, Vec<T>>,
        im_id: u32,
        path: &Path,
    ) -> Result<&'a [T], FormatError> {
        match map.get(&im_id) {
            Some(entries) => Ok(entries),
            None => {
                let hint = if map.is_empty() { "the file is absent or empty" } else { "" };
                Err(FormatError::missing(path.display(), format!("image {im_id}"), hint))
            }
        }
    }

    /// Number and pose (object to camera) of the most visible instance of an object in an image; an error when it has none.
    pub fn most_visible(&self, im_id: u32, obj_id: u32) -> Result<(usize, Pose), FormatError> {
        let place = format!("{}: image {im_id}", self.folder.join("scene_gt.json").display());
        let instances = self.gt(im_id)?.iter().zip(self.gt_info(im_id)?).enumerate();
        let of_object = instances.filter(|(_, (gt, _))| gt.obj_id == obj_id);
        let best = of_object.max_by(|(_, a), (_, b)| a.1.visib_fract.total_cmp(&b.1.visib_fract));
        let Some((instance, (gt, _))) = best else {
            return Err(FormatError::missing(place, format!("object {obj_id}"), "a list names it"));
        };
        Ok((instance, gt.pose(&place)?))
    }

    /// Colour (or gray), depth and camera of an image.
    pub fn frame(&self, im_id: u32) -> Result<RgbdFrame, FormatError> {
        let rgb = read_rgb(&self.color_path(im_id)?)?;
        let (depth, camera) = (self.depth(im_id)?, self.camera(im_id)?);
        let place = format!("{}: image {im_id}", self.folder.join("scene_camera.json").display());
        camera.check_size(&place, rgb.dimensions())?;
        if (depth.width, depth.height) != rgb.dimensions() {
            let size = format!("{} x {}", depth.width, depth.height);
            let expected = format!("that of the colour image, {} x {}", rgb.width(), rgb.height());
            let place = format!("{}: image {im_id}", self.folder.join("depth").display());
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
        read_mask(&self.mask_path(im_id, instance))
    }

    fn mask_path(&self, im_id: u32, instance: usize) -> PathBuf {
        self.folder.join(format!("mask_visib/{im_id:06}_{instance:06}.png"))
    }

    fn place(&self, im_id: u32, instance: usize) -> String {
        self.mask_path(im_id, instance).display().to_string()
    }

    /// An annotated instance with its visible mask.
    pub fn instance(&self, im_id: u32, instance: usize) -> Result<Instance, FormatError> {
        let (gt, info) = match (self.gt(im_id)?.get(instance), self.gt_info(im_id)?.get(instance)) {
            (Some(gt), Some(info)) => (gt, info),
            _ => {
                let path = self.folder.join("scene_gt.json");
                let missing = format!("image {im_id} instance {instance}");
                return Err(FormatError::missing(path.display(), missing, ""));
            }
        };
        let place =
            format!("{}: image {im_id} instance {instance}", self.folder.join("scene_gt.json").display());
        Ok(Instance {
            obj_id: gt.obj_id,
            t_camera_object: gt.pose(&place)?,
            visib_fract: info.visib_fract,
            px_count_visib: info.px_count_visib,
            mask_visib: self.mask_visib(im_id, instance)?,
        })
    }

    fn image_path(&self, im_id: u32, folders: &[&str], extensions: &[&str]) -> Result<PathBuf, FormatError> {
        let path = |folder: &str, ext: &str| self.folder.join(folder).join(format!("{im_id:06}.{ext}"));
        let candidates =
            folders.iter().flat_map(|folder| extensions.iter().map(move |ext| path(folder, ext)));
        candidates.into_iter().find(|path| path.is_file()).ok_or_else(|| {
            let missing = format!("{}/{im_id:06}.{}", folders.join("|"), extensions.join("|"));
            FormatError::missing(self.folder.display(), missing, "")
        })
    }
}
