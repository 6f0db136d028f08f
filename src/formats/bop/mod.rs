//! Scene-wise BOP datasets: `<split>/SSSSSS/{rgb,gray,depth,mask,mask_visib}/` with `scene_camera.json`,
//! `scene_gt.json` and `scene_gt_info.json`, models beside the splits.
//!
//! [`BopDataset`] finds the splits and models, [`BopSplit`] hands out scenes (parsed once, kept) and loads
//! single images; [`BopSceneWriter`] writes the same layout.

mod records;
mod split;
mod writer;

pub use records::{GtInfoRecord, GtRecord};
pub use split::{BopScene, BopSplit};
pub use writer::{BopSceneWriter, SceneImage, SceneInstance};

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use super::{
    FormatError,
    models::{ModelInfo, read_models_info},
};

/// A BOP dataset folder.
#[derive(Clone, Debug)]
pub struct BopDataset {
    root: PathBuf,
}

impl BopDataset {
    pub fn open(root: &Path) -> Result<Self, FormatError> {
        if !root.is_dir() {
            return Err(FormatError::missing(root.display(), "dataset folder", ""));
        }
        Ok(Self { root: root.to_path_buf() })
    }

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
            .filter(|name| split::scene_folders(&self.root.join(name)).is_ok_and(|scenes| !scenes.is_empty()))
            .collect();
        splits.sort();
        Ok(splits)
    }

    /// A split by name.
    pub fn split(&self, name: &str) -> Result<BopSplit, FormatError> {
        let folder = self.root.join(name);
        if !folder.is_dir() {
            let found = format!("splits found: {}", self.splits()?.join(", "));
            return Err(FormatError::missing(self.root.display(), format!("split {name}"), found));
        }
        BopSplit::open(&folder)
    }

    /// `test`, else the first split whose name starts with `test`, else with `val`.
    pub fn test_split(&self) -> Result<BopSplit, FormatError> {
        let splits = self.splits()?;
        let chosen = ["test", "val"].iter().find_map(|kind| {
            splits.iter().find(|s| s == kind).or_else(|| splits.iter().find(|s| s.starts_with(kind)))
        });
        match chosen {
            Some(name) => self.split(name),
            None => {
                let found = format!("splits found: {}", splits.join(", "));
                Err(FormatError::missing(self.root.display(), "split test or val", found))
            }
        }
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
        let path = self.models_folder()?.join(format!("obj_{obj_id:06}.ply"));
        if path.is_file() { Ok(path) } else { Err(FormatError::missing(path.display(), "model", "")) }
    }

    /// File of a name inside the dataset folder, e.g. `test_targets_bop19.json`.
    pub fn file(&self, name: &str) -> PathBuf {
        self.root.join(name)
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
mod tests;
