//! Reading: index of all instances, random access to images.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    path::{Path, PathBuf},
};

use rayon::prelude::*;

use super::{
    super::{
        AnnotatedFrame, FormatError, ModelInfo, ObjectSymmetries,
        bop::{GtInfoRecord, GtRecord},
        models::read_models_info,
    },
    archive::Archive,
    fault_log::{FaultCounts, FaultLog},
    index_files::IndexFiles,
    instance::{InstanceRef, instance_refs},
    records::{ImageRecords, MemberKind, from_json},
    shard_image::{ShardImage, check_camera, check_instances},
};

/// A folder of shards.
#[derive(Debug)]
pub struct ShardDataset {
    folder: PathBuf,
    shards: Vec<(u32, Archive)>,
    keys: Vec<String>,
    /// Per image: position in `shards`.
    shard_of: Vec<u32>,
    instances: Vec<InstanceRef>,
    references: HashMap<u32, Vec<usize>>,
    models: BTreeMap<u32, ModelInfo>,
    no_symmetries: ObjectSymmetries,
    problems: Vec<String>,
    faults: FaultLog,
}

/// Problems of a set that are logged one by one.
const LOGGED_PROBLEMS: usize = 5;

type ImageInstances = (String, Vec<InstanceRef>);

impl ShardDataset {
    /// Opens the folder with the shards or the one above (`train_pbr_web` is found inside). Damaged shards and images
    /// are left out and listed in [`Self::problems`]; a folder without one usable image is an error.
    pub fn open(dir: &Path) -> Result<Self, FormatError> {
        let folder =
            ["train_pbr_web", "."].iter().map(|sub| dir.join(sub)).find(|f| !shard_paths(f).is_empty());
        let hint = "shard-NNNNNN.tar files or NNNNNN folders, there or in train_pbr_web/";
        let folder = folder.ok_or_else(|| FormatError::missing(dir.display(), "shards", hint))?;
        let parent = folder.parent().map(Path::to_path_buf).unwrap_or_default();
        let index_files = IndexFiles::read(&[&folder, &parent])?;
        let scanned: Vec<(u32, Archive, Vec<ImageInstances>, Vec<String>)> =
            shard_paths(&folder).into_par_iter().map(|(number, path)| scan_shard(number, &path)).collect();
        let mut dataset = Self {
            faults: FaultLog::new(folder.clone()),
            folder,
            shards: Vec::new(),
            keys: Vec::new(),
            shard_of: Vec::new(),
            instances: Vec::new(),
            references: HashMap::new(),
            models: BTreeMap::new(),
            no_symmetries: ObjectSymmetries::default(),
            problems: Vec::new(),
        };
        let mut keys = HashSet::new();
        for (number, archive, images, problems) in scanned {
            dataset.problems.extend(problems);
            for (key, instances) in images {
                if keys.insert(key.clone()) {
                    dataset.add_image(key, instances, &index_files);
                } else {
                    let path = archive.path.display();
                    dataset.problems.push(format!("{path}: {key} is in another shard, too, image skipped"));
                }
            }
            dataset.shards.push((number, archive));
        }
        if dataset.keys.is_empty() {
            let first = dataset.problems.first().cloned().unwrap_or_default();
            return Err(FormatError::missing(dir.display(), "usable images", first));
        }
        dataset.problems.extend(index_files.dangling(&keys));
        for problem in dataset.problems.iter().take(LOGGED_PROBLEMS) {
            tracing::warn!("{problem}");
        }
        if let Some(more) = dataset.problems.len().checked_sub(LOGGED_PROBLEMS).filter(|more| *more > 0) {
            tracing::warn!("{}: {more} more problems of this kind", dataset.folder.display());
        }
        let info = [&parent, &dataset.folder]
            .map(|f| [f.join("models/models_info.json"), f.join("models_info.json")]);
        if let Some(file) = info.iter().flatten().find(|f| f.is_file()) {
            dataset.models = read_models_info(file)?;
        }
        Ok(dataset)
    }

    fn add_image(&mut self, key: String, instances: Vec<InstanceRef>, index_files: &IndexFiles) {
        let image = self.keys.len() as u32;
        for instance in instances {
            let instance = InstanceRef { image, ..instance };
            if index_files.is_valid(&key, &instance) {
                if index_files.is_reference(&key, &instance) {
                    self.references.entry(instance.obj_id).or_default().push(self.instances.len());
                }
                self.instances.push(instance);
            }
        }
        self.keys.push(key);
        // The shard of this image is pushed after its images.
        self.shard_of.push(self.shards.len() as u32);
    }

    /// Folder that holds the shards.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// `SSSSSS_IIIIII` of every image, by shard.
    pub fn image_keys(&self) -> &[String] {
        &self.keys
    }

    /// The instances of the index files, or all with a visible pixel where there are none.
    pub fn instances(&self) -> &[InstanceRef] {
        &self.instances
    }

    /// Indices into [`Self::instances`] that may serve as references of the object (visible share >= 0.8).
    pub fn references(&self, obj_id: u32) -> &[usize] {
        self.references.get(&obj_id).map_or(&[], Vec::as_slice)
    }

    /// Symmetries from `models_info.json`; none for an unknown object.
    pub fn symmetries(&self, obj_id: u32) -> &ObjectSymmetries {
        self.models.get(&obj_id).map_or(&self.no_symmetries, |model| &model.symmetries)
    }

    /// What was skipped when the folder was opened, and why.
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    /// What was mended or skipped in the images that were loaded so far.
    pub fn faults(&self) -> FaultCounts {
        self.faults.counts()
    }

    pub(super) fn keys_and_shards(&self) -> impl Iterator<Item = (&str, u32)> {
        self.keys.iter().zip(&self.shard_of).map(|(key, &s)| (key.as_str(), self.shards[s as usize].0))
    }

    /// Reads and decodes an image with all its instances (valid or not, in the order of `gt.json`). Inverted masks are
    /// mended; an instance whose mask or depth cannot be its own gets an empty mask.
    pub fn load(&self, image: u32) -> Result<AnnotatedFrame, FormatError> {
        let read = self.read(image)?;
        let name = read.name.clone();
        let (annotated, faults) =
            read.annotated(&self.models).inspect_err(|error| self.faults.unreadable(image, error))?;
        for (instance, fault) in &faults {
            self.faults.instance(image, &name, *instance, fault);
        }
        Ok(annotated)
    }

    /// The JSON members of an image, as they are.
    pub fn records(&self, image: u32) -> Result<ImageRecords, FormatError> {
        Ok(self.read(image)?.records)
    }

    fn read(&self, image: u32) -> Result<ShardImage, FormatError> {
        let (Some(key), Some(&shard)) = (self.keys.get(image as usize), self.shard_of.get(image as usize))
        else {
            let expected = format!("below {}", self.keys.len());
            return Err(FormatError::field(self.folder.display(), "image number", image, expected));
        };
        ShardImage::read(&self.shards[shard as usize].1, key)
            .inspect_err(|error| self.faults.unreadable(image, error))
    }
}

/// Shards of a folder, by number: `shard-NNNNNN.tar` (any tar whose name ends in a number) or folders `NNNNNN`.
pub(super) fn shard_paths(folder: &Path) -> Vec<(u32, PathBuf)> {
    let entries = std::fs::read_dir(folder).ok().into_iter().flatten();
    let shard = |path: PathBuf| {
        let stem = path.file_stem()?.to_str()?;
        let digits = stem.rsplit(|c: char| !c.is_ascii_digit()).next().filter(|d| !d.is_empty())?;
        let packed = path.extension().is_some_and(|e| e == "tar") && path.is_file();
        let unpacked = path.is_dir() && (stem.len() == digits.len() || stem.starts_with("shard"));
        (packed || unpacked).then_some((digits.parse().ok()?, path.clone()))
    };
    let mut shards: Vec<(u32, PathBuf)> = entries.filter_map(|e| shard(e.ok()?.path())).collect();
    shards.sort();
    // A shard that was unpacked beside its tar counts once.
    shards.dedup_by_key(|s| s.0);
    shards
}

fn scan_shard(number: u32, path: &Path) -> (u32, Archive, Vec<ImageInstances>, Vec<String>) {
    let empty = Archive { path: path.to_owned(), images: BTreeMap::new(), problems: Vec::new() };
    let mut archive = match Archive::scan(path) {
        Ok(archive) => archive,
        Err(error) => return (number, empty, Vec::new(), vec![error.to_string()]),
    };
    let mut problems = std::mem::take(&mut archive.problems);
    let (mut images, mut far) = (Vec::new(), Vec::new());
    match archive.reader() {
        Ok(mut reader) => {
            for key in archive.images.keys() {
                let mut member = |kind| reader.read(key, kind);
                let parsed = member(MemberKind::Camera).and_then(|(camera, camera_place)| {
                    check_camera(&from_json(&camera, &camera_place)?, &camera_place)?;
                    let (gt, gt_place) = member(MemberKind::Gt)?;
                    let (info, info_place) = member(MemberKind::GtInfo)?;
                    let gt: Vec<GtRecord> = from_json(&gt, &gt_place)?;
                    let info: Vec<GtInfoRecord> = from_json(&info, &info_place)?;
                    check_instances(&gt, &info, &info_place)?;
                    Ok((gt, info))
                });
                match parsed {
                    Ok((gt, info)) => {
                        let (instances, left_out) = instance_refs(&gt, &info);
                        far.extend(left_out.into_iter().map(|problem| format!("{key}: {problem}")));
                        images.push((key.clone(), instances));
                    }
                    Err(error) => problems.push(format!("{error}, image skipped")),
                }
            }
            if let Some(first) = far.first() {
                let (path, count) = (path.display(), far.len());
                problems.push(format!("{path}: {count} visible instances skipped, the first: {first}"));
            }
        }
        Err(error) => problems.push(error.to_string()),
    }
    (number, archive, images, problems)
}
