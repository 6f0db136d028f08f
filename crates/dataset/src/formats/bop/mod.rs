//! Scene-wise BOP datasets: `<split>/SSSSSS/{rgb,gray,depth,mask,mask_visib}/` with `scene_camera.json`,
//! `scene_gt.json` and `scene_gt_info.json`, models beside the splits. Scenes of several cameras have a name after each of
//! these, `rgb_SENSOR/` and `scene_camera_SENSOR.json`.
//!
//! [`BopDataset`] finds the splits and models, [`BopSplit`] hands out scenes (parsed once, kept) and loads
//! single images; [`BopSceneWriter`] writes the same layout.

mod entries;
mod layout;
mod records;
mod scene;
mod selection;
mod split;
mod visibility;
mod writer;

pub use records::{GtInfoRecord, GtRecord};
pub use scene::BopScene;
pub use selection::DatasetSplits;
pub use split::BopSplit;
pub use writer::{BopSceneWriter, SceneImage, SceneInstance};

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use super::{
    FormatError,
    models::{ModelInfo, read_models_info},
    numbered::numbered_file,
};

/// A BOP dataset folder.
#[derive(Clone, Debug)]
pub struct BopDataset {
    root: PathBuf,
    sensor: Option<String>,
}

impl BopDataset {
    /// Refuses a path that is no folder; splits and models are looked up when they are asked for.
    pub fn open(root: &Path) -> Result<Self, FormatError> {
        if !root.is_dir() {
            return Err(FormatError::missing(root.display(), "dataset folder", ""));
        }
        Ok(Self { root: root.to_path_buf(), sensor: None })
    }

    /// With the images of one of several cameras.
    pub fn with_sensor(self, sensor: Option<String>) -> Self {
        Self { sensor, ..self }
    }

    /// The dataset folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Last part of the folder's path.
    pub fn name(&self) -> String {
        let root = std::fs::canonicalize(&self.root).unwrap_or_else(|_| self.root.clone());
        root.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Folders that hold scenes (`test`, `val`, `train_pbr`, ...), sorted.
    pub fn splits(&self) -> Result<Vec<String>, FormatError> {
        let entries = std::fs::read_dir(&self.root).map_err(|e| FormatError::io(&self.root, e))?;
        let mut splits: Vec<String> = entries
            .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
            .filter(|name| layout::has_scenes(&self.root.join(name)))
            .collect();
        splits.sort();
        Ok(splits)
    }

    /// A split by name, or the scenes of several whose names are separated by commas.
    pub fn split(&self, name: &str) -> Result<BopSplit, FormatError> {
        let mut splits = name.split(',').map(|name| self.one_split(name.trim()));
        let first = splits.next().unwrap_or_else(|| self.one_split(name))?;
        splits.try_fold(first, |joined, split| Ok(joined.joined(split?)))
    }

    fn one_split(&self, name: &str) -> Result<BopSplit, FormatError> {
        let folder = self.root.join(name);
        if !folder.is_dir() {
            let found = format!("splits found: {}", self.splits()?.join(", "));
            return Err(FormatError::missing(self.root.display(), format!("split {name}"), found));
        }
        BopSplit::of_sensor(&folder, self.sensor.as_deref())
    }

    /// `test`, else the first split whose name starts with `test` (T-LESS: `test_primesense`), else with `val`; those with
    /// annotations come first (HB publishes them for its `val` splits only).
    pub fn test_split(&self) -> Result<BopSplit, FormatError> {
        let names = self.splits()?;
        let candidates: Vec<&String> = ["test", "val"]
            .iter()
            .flat_map(|kind| {
                let exact = names.iter().filter(move |name| name == kind);
                exact.chain(names.iter().filter(move |name| name.starts_with(kind) && name != kind))
            })
            .collect();
        let mut first = None;
        for name in candidates {
            let split = self.split(name)?;
            if split.is_annotated() {
                return Ok(split);
            }
            first = first.or(Some(split));
        }
        first.ok_or_else(|| {
            let found = format!("splits found: {}", names.join(", "));
            FormatError::missing(self.root.display(), "split test or val", found)
        })
    }

    /// Where the paper's benchmark takes its reference views: `train_real` of TUD-L and YCB-V (whose scenes 48 to 59 are in
    /// `test`), the split of the targets elsewhere.
    pub fn reference_split_name(&self) -> Option<&'static str> {
        let name: String = self.name().chars().filter(char::is_ascii_alphanumeric).collect();
        let name = match name.to_ascii_lowercase().as_str() {
            "tudl" => "train_real",
            "ycbv" => "train_real,test",
            _ => return None,
        };
        name.split(',').all(|part| self.root.join(part).is_dir()).then_some(name)
    }

    /// Sizes and symmetries of the evaluation models (of `models` when there is no `models_eval`).
    pub fn models_info(&self) -> Result<BTreeMap<u32, ModelInfo>, FormatError> {
        read_models_info(&self.models_folder()?.join("models_info.json"))
    }

    /// The file of [`Self::models_info`], for messages.
    pub fn models_info_place(&self) -> String {
        let folder = self.models_folder().unwrap_or_else(|_| self.root.clone());
        folder.join("models_info.json").display().to_string()
    }

    /// PLY file (mm) of the evaluation model of an object.
    pub fn eval_model_path(&self, obj_id: u32) -> Result<PathBuf, FormatError> {
        let path = numbered_file(&self.models_folder()?, |digits| format!("obj_{obj_id:0digits$}.ply"));
        if path.is_file() { Ok(path) } else { Err(FormatError::missing(path.display(), "model", "")) }
    }

    /// PLY file (mm) of an object's model with its colours: of `models`, else of T-LESS's `models_cad` and
    /// `models_reconst`.
    pub fn textured_model_path(&self, obj_id: u32) -> Result<PathBuf, FormatError> {
        let file = |folder: &str| {
            numbered_file(&self.root.join(folder), |digits| format!("obj_{obj_id:0digits$}.ply"))
        };
        let folders = ["models", "models_reconst", "models_cad"];
        folders.iter().map(|folder| file(folder)).find(|path| path.is_file()).ok_or_else(|| {
            let hint = format!("looked in {}", folders.join(", "));
            FormatError::missing(self.root.display(), format!("obj_{obj_id:06}.ply"), hint)
        })
    }

    /// File of a name inside the dataset folder, e.g. `test_targets_bop19.json`.
    pub fn file(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// The list of the targets that results are compared on: BOP's of 2019, else that of 2024, which newer datasets have
    /// alone.
    pub fn targets_file(&self) -> PathBuf {
        let [bop19, bop24] =
            ["test_targets_bop19.json", "test_targets_bop24.json"].map(|name| self.file(name));
        if bop24.is_file() && !bop19.is_file() { bop24 } else { bop19 }
    }

    fn models_folder(&self) -> Result<PathBuf, FormatError> {
        let folders = ["models_eval", "models"].map(|name| self.root.join(name));
        let [eval, textured] = &folders;
        match folders.iter().find(|f| f.join("models_info.json").is_file()) {
            Some(folder) => Ok(folder.clone()),
            None => {
                let hint = format!("looked for {} and in {}", eval.display(), textured.display());
                Err(FormatError::missing(self.root.display(), "models_info.json", hint))
            }
        }
    }
}

#[cfg(test)]
mod folder_tests;
#[cfg(test)]
mod tests;
