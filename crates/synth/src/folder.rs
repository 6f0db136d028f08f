//! Which configuration a folder belongs to, and what in it was generated.

use std::path::{Path, PathBuf};

use unopose_core::{
    config::SynthConfig,
    files::{FileError, part_files, remove_part_files},
    folder_lock::FolderLock,
};
use unopose_dataset::formats::{
    FormatError,
    files::{read_json, write_json},
};

use super::{SynthError, object_cache::ObjectCache};

/// The configuration of a generated folder.
const CONFIG_FILE: &str = "generation.json";
/// Version of everything that decides a set's content besides the configuration. Files of the first version do not
/// name it.
const GENERATOR: u64 = 3;
/// Its entry for [`GENERATOR`].
const GENERATOR_KEY: &str = "generator";

/// The two kinds of sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Layout {
    Shards,
    Scenes,
}

impl Layout {
    /// Subfolder that holds the images.
    pub fn images(self) -> &'static str {
        match self {
            Layout::Shards => "train_pbr_web",
            Layout::Scenes => "test",
        }
    }

    /// End of the name of the file that is written last.
    fn last_file(self) -> &'static str {
        match self {
            Layout::Shards => "_visib0_8_scene_im_inst_ids.json",
            Layout::Scenes => "dets_gt.json",
        }
    }
}

/// Refuses values that cannot give images.
pub(super) fn check(config: &SynthConfig) -> Result<(), SynthError> {
    Ok(config.check()?)
}

/// Writes the configuration into the folder; refuses a folder of another configuration or layout, or with foreign data.
pub(super) fn reserve(config: &SynthConfig, out: &Path, layout: Layout) -> Result<(), SynthError> {
    let file = out.join(CONFIG_FILE);
    let holds =
        |folder: &str| std::fs::read_dir(out.join(folder)).is_ok_and(|mut entries| entries.next().is_some());
    let other = if layout == Layout::Shards { Layout::Scenes } else { Layout::Shards };
    let refuse = |difference: String| Err(SynthError::OtherConfig { folder: out.to_owned(), difference });
    if holds(other.images()) {
        return refuse(format!("it has {}/, this set writes {}/", other.images(), layout.images()));
    }
    if !file.is_file() {
        if let Some(folder) = [layout.images(), "models", "models_eval"].into_iter().find(|f| holds(f)) {
            return refuse(format!("there is {folder}/ without {CONFIG_FILE}"));
        }
        return write_config(config, &file);
    }
    let Some((found, generator)) = read(&file)? else {
        return refuse(format!("{CONFIG_FILE} has fields that this version does not know"));
    };
    // Through JSON text: a number is compared as it is written.
    if found != roundtrip(config, &file)? {
        return refuse(difference(&found, config));
    }
    let finished = || {
        let mut entries = std::fs::read_dir(out).into_iter().flatten().filter_map(Result::ok);
        entries.any(|e| e.file_name().to_string_lossy().ends_with(layout.last_file()))
    };
    if generator != GENERATOR && !finished() {
        return refuse(format!("version {generator} of the generator began it, this is version {GENERATOR}"));
    }
    Ok(())
}

/// The configuration that a generated folder was made with; `None` for other folders.
pub(super) fn generated_by(out: &Path) -> Result<Option<SynthConfig>, FormatError> {
    let file = out.join(CONFIG_FILE);
    if !file.is_file() {
        return Ok(None);
    }
    Ok(read(&file)?.map(|(config, _)| config))
}

/// The folders that a generation writes files into: `out`, those of models and shards, and those of every BOP scene.
fn written_folders(out: &Path) -> Vec<PathBuf> {
    let subfolders = |folder: &Path| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
        let folders = entries.filter(|e| e.file_type().is_ok_and(|kind| kind.is_dir()));
        folders.map(|e| e.path()).collect::<Vec<_>>()
    };
    let mut folders = vec![out.to_owned()];
    folders.extend([Layout::Shards.images(), "models", "models_eval"].map(|name| out.join(name)));
    for scene in subfolders(&out.join(Layout::Scenes.images())) {
        folders.extend(subfolders(&scene));
        folders.push(scene);
    }
    folders
}

/// Files that killed generations left half written in a set.
pub(super) fn parts_of(out: &Path) -> Result<Vec<PathBuf>, FileError> {
    let parts: Vec<_> =
        written_folders(out).iter().map(|folder| part_files(folder)).collect::<Result<_, _>>()?;
    Ok(parts.concat())
}

/// Removes [`parts_of`] a set that nobody else fills.
pub(super) fn remove_parts(out: &Path) -> Result<(), FileError> {
    written_folders(out).iter().try_for_each(|folder| remove_part_files(folder))
}

/// Removes what a generation writes into a folder and nothing else, once images can be made of `config` to take its
/// place. Refuses a folder that another process fills.
pub fn remove_generated(config: &SynthConfig, out: &Path) -> Result<(), SynthError> {
    let error = |path: &Path| {
        let path = path.to_owned();
        move |source| SynthError::Io { path, source }
    };
    check(config)?;
    ObjectCache::new(config)?;
    if !out.is_dir() {
        return Ok(());
    }
    let _lock = FolderLock::exclusive(out)?;
    for folder in [Layout::Shards.images(), Layout::Scenes.images(), "models", "models_eval"] {
        let folder = out.join(folder);
        if folder.is_dir() {
            std::fs::remove_dir_all(&folder).map_err(error(&folder))?;
        }
    }
    let is_list = |name: &str| {
        name.ends_with("_inst_ids.json")
            || ["gso_models.json", "synth_models.json", "camera.json", "dets_gt.json", CONFIG_FILE]
                .contains(&name)
            || name.starts_with("test_targets_")
            || name.starts_with("test_ref_targets_")
    };
    for entry in std::fs::read_dir(out).map_err(error(out))?.filter_map(Result::ok) {
        let path = entry.path();
        if path.is_file() && is_list(&entry.file_name().to_string_lossy()) {
            std::fs::remove_file(&path).map_err(error(&path))?;
        }
    }
    Ok(remove_parts(out)?)
}

fn write_config(config: &SynthConfig, file: &Path) -> Result<(), SynthError> {
    let mut value: serde_json::Value = read_text(&serde_json::to_string(config), file)?;
    if let Some(map) = value.as_object_mut() {
        map.insert(GENERATOR_KEY.into(), GENERATOR.into());
    }
    Ok(write_json(file, &value, true)?)
}

/// Configuration and generator; `None` when the configuration is one of another version.
fn read(file: &Path) -> Result<Option<(SynthConfig, u64)>, FormatError> {
    let mut value: serde_json::Value = read_json(file)?;
    let generator = value.as_object_mut().and_then(|map| map.remove(GENERATOR_KEY));
    let generator = generator.and_then(|g| g.as_u64()).unwrap_or(1);
    Ok(serde_json::from_value(value).ok().map(|config| (config, generator)))
}

fn roundtrip(config: &SynthConfig, file: &Path) -> Result<SynthConfig, SynthError> {
    read_text(&serde_json::to_string(config), file)
}

fn read_text<T: serde::de::DeserializeOwned>(
    text: &serde_json::Result<String>,
    file: &Path,
) -> Result<T, SynthError> {
    let invalid = |e: &dyn std::fmt::Display| SynthError::Io {
        path: file.to_owned(),
        source: std::io::Error::other(e.to_string()),
    };
    match text {
        Ok(text) => serde_json::from_str(text).map_err(|e| invalid(&e)),
        Err(e) => Err(invalid(e)),
    }
}

/// First field in which two configurations differ.
fn difference(found: &SynthConfig, wanted: &SynthConfig) -> String {
    let fields = |config: &SynthConfig| match serde_json::to_value(config) {
        Ok(serde_json::Value::Object(map)) => map,
        _ => serde_json::Map::new(),
    };
    let (there, here) = (fields(found), fields(wanted));
    let differing = here.iter().find(|(k, v)| there.get(k.as_str()) != Some(*v));
    differing.map_or_else(
        || "other fields".into(),
        |(k, v)| {
            format!("{k} is {} there and {v} here", there.get(k.as_str()).unwrap_or(&serde_json::Value::Null))
        },
    )
}
