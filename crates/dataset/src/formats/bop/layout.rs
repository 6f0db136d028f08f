//! Where the files of a scene are: which folder has which number, and which of several cameras is meant.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use super::super::{FormatError, numbered::id_of};

/// Files of one camera of a scene: `rgb/`, `scene_gt.json`, or with a sensor `rgb_SENSOR/`, `scene_gt_SENSOR.json`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SceneFiles {
    /// Folder of the scene.
    pub folder: PathBuf,
    /// Name of the camera where the scene has several.
    pub sensor: Option<String>,
}

impl SceneFiles {
    /// `scene_gt` and the like, without ending.
    pub(super) fn json(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{}.json", self.name(name)))
    }

    /// `depth` and the like with the sensor's name.
    pub(super) fn name(&self, name: &str) -> String {
        match &self.sensor {
            Some(sensor) => format!("{name}_{sensor}"),
            None => name.to_owned(),
        }
    }
}

/// A scene as it lies in a split folder.
#[derive(Debug)]
struct FoundScene {
    id: u32,
    folder: PathBuf,
    /// `None` is the camera of a scene with one.
    sensors: BTreeSet<Option<String>>,
}

/// Does a folder hold scenes?
pub(super) fn has_scenes(split: &Path) -> bool {
    found_scenes(split).is_ok_and(|scenes| !scenes.is_empty())
}

/// The scenes of a split folder by number: `1`, `01` and `000001` are all scene 1. Scenes that have other sensors only are
/// left out; a scene with one camera is that of any sensor.
pub(super) fn scenes(split: &Path, sensor: Option<&str>) -> Result<BTreeMap<u32, SceneFiles>, FormatError> {
    let found = found_scenes(split)?;
    let mut folders: BTreeMap<u32, &Path> = BTreeMap::new();
    for scene in &found {
        if let Some(other) = folders.insert(scene.id, &scene.folder) {
            let value = format!("{} and {}", other.display(), scene.folder.display());
            let expected = "one folder per number of a scene";
            return Err(FormatError::field(split.display(), format!("scene {}", scene.id), value, expected));
        }
    }
    let named: BTreeSet<&str> =
        found.iter().flat_map(|scene| &scene.sensors).flatten().map(String::as_str).collect();
    let names = || format!("sensors found: {}", named.iter().copied().collect::<Vec<_>>().join(", "));
    let mut chosen = BTreeMap::new();
    for FoundScene { id, folder, sensors } in &found {
        let wanted = sensor.map(str::to_owned);
        let has = |sensor: &Option<String>| sensors.contains(sensor);
        let sensor = match (has(&wanted), has(&None)) {
            (true, _) => wanted,
            (false, true) if sensors.len() == 1 => None,
            (false, _) if sensor.is_none() => {
                let hint = format!("{}; --sensor takes one of them", names());
                return Err(FormatError::missing(folder.display(), "scene_camera.json", hint));
            }
            _ => continue,
        };
        chosen.insert(*id, SceneFiles { folder: folder.clone(), sensor });
    }
    let Some(sensor) = sensor else { return Ok(chosen) };
    if named.is_empty() && !chosen.is_empty() {
        tracing::warn!(
            "{} has one camera, without a name: it stands for the sensor {sensor}",
            split.display()
        );
    } else if !named.contains(sensor) {
        return Err(FormatError::missing(split.display(), format!("sensor {sensor}"), names()));
    }
    Ok(chosen)
}

fn found_scenes(split: &Path) -> Result<Vec<FoundScene>, FormatError> {
    let names = |folder: &Path| -> Result<Vec<String>, FormatError> {
        let entries = std::fs::read_dir(folder).map_err(|e| FormatError::io(folder, e))?;
        Ok(entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok()).collect())
    };
    let mut scenes = Vec::new();
    for name in names(split)? {
        let folder = split.join(&name);
        let (Some(id), true) = (id_of(&name), folder.is_dir()) else { continue };
        let sensors: BTreeSet<_> = names(&folder)?.iter().filter_map(|name| sensor_of(name)).collect();
        if !sensors.is_empty() {
            scenes.push(FoundScene { id, folder, sensors });
        }
    }
    scenes.sort_by(|a, b| a.folder.cmp(&b.folder));
    Ok(scenes)
}

/// The camera that a `scene_camera.json` or `scene_camera_SENSOR.json` is of.
fn sensor_of(file: &str) -> Option<Option<String>> {
    let rest = file.strip_prefix("scene_camera")?.strip_suffix(".json")?;
    match rest.strip_prefix('_') {
        Some(sensor) if !sensor.is_empty() => Some(Some(sensor.to_owned())),
        None if rest.is_empty() => Some(None),
        _ => None,
    }
}
