//! One split: its scenes and their images.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use super::{
    super::{AnnotatedFrame, FormatError},
    layout::{SceneFiles, scenes},
    scene::BopScene,
    visibility::SilhouetteModels,
};

/// A split folder, or several whose scenes have different numbers. Scenes are parsed on first use and kept; loading is
/// thread-safe.
#[derive(Debug)]
pub struct BopSplit {
    folder: PathBuf,
    name: String,
    scene_ids: Vec<u32>,
    places: BTreeMap<u32, SceneFiles>,
    models: Arc<SilhouetteModels>,
    scenes: Mutex<BTreeMap<u32, Arc<BopScene>>>,
}

impl BopSplit {
    /// Finds the scenes of a split folder; an error when there are none.
    pub fn open(folder: &Path) -> Result<Self, FormatError> {
        Self::of_sensor(folder, None)
    }

    /// The images of one of several cameras.
    pub(super) fn of_sensor(folder: &Path, sensor: Option<&str>) -> Result<Self, FormatError> {
        let places = scenes(folder, sensor)?;
        if places.is_empty() {
            let hint = "expected folders named SSSSSS with scene_camera.json";
            return Err(FormatError::missing(folder.display(), "scenes", hint));
        }
        let name = folder.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self {
            folder: folder.to_path_buf(),
            name,
            scene_ids: places.keys().copied().collect(),
            places,
            models: Arc::new(SilhouetteModels::beside(folder)),
            scenes: Mutex::default(),
        })
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
        self.places.values().next().is_some_and(|files| files.json("scene_gt").is_file())
    }

    /// Sorted.
    pub fn scene_ids(&self) -> &[u32] {
        &self.scene_ids
    }

    /// Folder of a scene; its name may have fewer digits than BOP's.
    pub fn scene_folder(&self, id: u32) -> Option<&Path> {
        self.places.get(&id).map(|files| files.folder.as_path())
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
        let scene = Arc::new(BopScene::open(id, place.clone(), self.models.clone())?);
        Ok(scenes().entry(id).or_insert(scene).clone())
    }

    /// Colour, depth, camera and all annotated instances with their visible masks.
    pub fn load(&self, scene_id: u32, im_id: u32) -> Result<AnnotatedFrame, FormatError> {
        let scene = self.scene(scene_id)?;
        let frame = scene.frame(im_id)?;
        let count = if scene.is_annotated(im_id) { scene.gt(im_id)?.len() } else { 0 };
        let instances =
            (0..count).map(|index| scene.instance(im_id, index)).collect::<Result<Vec<_>, _>>()?;
        for (index, instance) in instances.iter().enumerate() {
            let mask = &instance.mask_visib;
            if (mask.width, mask.height) != (frame.width(), frame.height()) {
                let size = |w, h| format!("{w} x {h}");
                return Err(FormatError::field(
                    scene.mask_path("mask_visib", im_id, index).display(),
                    "mask size",
                    size(mask.width, mask.height),
                    format!("that of the image, {}", size(frame.width(), frame.height())),
                ));
            }
        }
        Ok(AnnotatedFrame { frame, instances })
    }
}
