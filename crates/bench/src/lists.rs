//! The lists of a protocol: read from the dataset where it has them, built otherwise.

use std::{
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
    sync::Arc,
};

use rayon::prelude::*;
use unopose_dataset::{
    formats::{
        BopDataset, BopSplit, DatasetSplits, FormatError, ReferenceTarget, Target,
        detections::{Detection, read_detections, visible_instances},
        targets::{read_reference_targets, read_targets, write_targets},
    },
    mesh::{self, TriangleMesh},
    protocol::{ListInput, Protocol, TargetList, build_lists},
};
use unopose_eval::metrics::{RegionKind, coco_scores};

use super::{BenchError, DetectionSource, UnoSegMasks, facts::ListFacts, rendered::render_references};

/// What a benchmark is run on.
#[derive(Clone, Debug)]
pub struct ListRequest {
    /// Dataset and splits; without a split of the references that of the paper's benchmark, else that of the targets.
    pub splits: DatasetSplits,
    /// A list to use instead of the protocols' own.
    pub targets: Option<PathBuf>,
    /// Masks of the targets.
    pub detections: DetectionSource<UnoSegMasks>,
    /// At most this many entries of every list, from its start.
    pub limit: Option<usize>,
    /// Seed of the choice of references.
    pub seed: u64,
    /// Whether to draw the reference images anew from the models.
    pub rendered: bool,
}

/// A list that is ready to run.
#[derive(Debug)]
pub struct PreparedList {
    /// What is known of the list besides its targets.
    pub facts: ListFacts,
    /// The targets with their references and detections.
    pub list: TargetList,
}

/// One protocol's or file's entries.
struct Entries {
    facts: ListFacts,
    entries: Vec<ReferenceTarget>,
    place: String,
}

impl ListRequest {
    /// The lists of some protocols, one after the other. Lists that were built are written into `folder`, which rendered
    /// references go to as well.
    pub fn prepare(&self, protocols: &[Protocol], folder: &Path) -> Result<Vec<PreparedList>, BenchError> {
        let dataset = self.splits.open()?;
        let all = match &self.targets {
            Some(path) => vec![self.read(path, list_name(path))?],
            None => self.of_protocols(&dataset, protocols, folder)?,
        };
        all.into_iter().map(|entries| self.prepared(entries, folder)).collect()
    }

    fn reference_split(&self, dataset: &BopDataset) -> Result<Option<BopSplit>, FormatError> {
        let name = self.splits.reference_split.as_deref().or_else(|| dataset.reference_split_name());
        name.map(|name| dataset.split(name)).transpose()
    }

    fn facts(&self, list: String) -> ListFacts {
        let unoseg_masks = match &self.detections {
            DetectionSource::UnoSeg(masks) => vec![masks.clone()],
            _ => Vec::new(),
        };
        ListFacts { list, segmentation: self.detections.name(), unoseg_masks, ..ListFacts::default() }
    }

    fn read(&self, path: &Path, list: String) -> Result<Entries, FormatError> {
        let facts = self.facts(list);
        let entries = read_reference_targets(path)?;
        Ok(Entries { facts, entries, place: path.display().to_string() })
    }

    fn of_protocols(
        &self,
        dataset: &BopDataset,
        protocols: &[Protocol],
        folder: &Path,
    ) -> Result<Vec<Entries>, BenchError> {
        let file = |protocol: &Protocol| dataset.file(&format!("test_ref_targets_{}.json", protocol.name()));
        let absent: Vec<Protocol> = protocols.iter().copied().filter(|p| !file(p).is_file()).collect();
        let mut built = HashMap::new();
        if !absent.is_empty() {
            let (split, reference_split) = (self.splits.of_targets(dataset)?, self.reference_split(dataset)?);
            let bop = dataset.file("test_targets_bop19.json");
            let targets = bop.is_file().then(|| read_targets(&bop)).transpose()?;
            let (infos, meshes) = (dataset.models_info()?, eval_meshes(dataset, targets.as_deref())?);
            let input = ListInput {
                split: &split,
                reference_split: reference_split.as_ref().unwrap_or(&split),
                infos: &infos,
                meshes: &meshes,
                targets: targets.as_deref(),
            };
            for list in build_lists(&input, &absent, self.seed)?.lists {
                built.insert(list.protocol.name(), list);
            }
        }
        let entries = |protocol: &Protocol| -> Result<Entries, BenchError> {
            let name = protocol.name();
            let Some(list) = built.remove(&name) else { return Ok(self.read(&file(protocol), name)?) };
            if list.entries.is_empty() {
                let place = dataset.root().display().to_string();
                let targets = list.without_reference;
                return Err(unopose_dataset::protocol::ProtocolError::NoReferences {
                    place,
                    list: name,
                    targets,
                }
                .into());
            }
            let path = folder.join(format!("test_ref_targets_{name}.json"));
            write_targets(&path, &list.entries)?;
            let facts = ListFacts {
                without_reference: list.without_reference,
                list_seed: Some(self.seed),
                ..self.facts(name)
            };
            Ok(Entries { facts, entries: list.entries, place: path.display().to_string() })
        };
        protocols.iter().map(entries).collect()
    }

    fn prepared(&self, mut list: Entries, folder: &Path) -> Result<PreparedList, BenchError> {
        let dataset = self.splits.open()?;
        let split = self.splits.of_targets(&dataset)?;
        let mut reference_split = self.reference_split(&dataset)?;
        list.entries.truncate(self.limit.unwrap_or(usize::MAX).max(1));
        if self.rendered {
            let real = reference_split.as_ref().unwrap_or(&split);
            reference_split =
                Some(render_references(&dataset, real, &list.entries, &folder.join("rendered"))?);
            list.facts.list = "rendered".into();
        }
        let given = match &self.detections {
            DetectionSource::File(path) => Some(path),
            DetectionSource::UnoSeg(masks) => Some(&masks.detections),
            DetectionSource::GroundTruth => None,
        };
        let (detections, masks_place) = match given {
            Some(path) => (read_detections(path, Some(&split))?, path.display().to_string()),
            None => {
                (true_masks(&dataset, &split, &list.entries)?, format!("{}: annotated masks", dataset.name()))
            }
        };
        let Entries { mut facts, entries, place } = list;
        if let DetectionSource::File(_) = &self.detections {
            facts.mask_map = Some(mask_map(&split, &entries, &detections)?);
        }
        let list =
            TargetList::new(dataset, split, reference_split, entries, detections, [place, masks_place])?;
        Ok(PreparedList { facts, list })
    }
}

/// COCO's mAP of the masks on the images of the list. Masks that cannot be decoded are left out.
fn mask_map(
    split: &BopSplit,
    entries: &[ReferenceTarget],
    detections: &[Detection],
) -> Result<f64, BenchError> {
    let target = |t: &ReferenceTarget| Target {
        scene_id: t.scene_id,
        im_id: t.im_id,
        obj_id: t.obj_id,
        inst_count: 1,
    };
    let targets: Vec<Target> = entries.iter().map(target).collect();
    let whole = detections.iter().filter(|d| d.segmentation.runs().is_ok()).cloned().collect::<Vec<_>>();
    Ok(coco_scores(split, &targets, &whole, RegionKind::Mask)?.map)
}

/// `test_ref_targets_NAME.json` without what surrounds the name.
fn list_name(path: &Path) -> String {
    let stem = path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    stem.strip_prefix("test_ref_targets_").map_or(stem.clone(), str::to_owned)
}

/// As many instances of every target as the dataset's own list says.
fn true_masks(
    dataset: &BopDataset,
    split: &BopSplit,
    entries: &[ReferenceTarget],
) -> Result<Vec<Detection>, FormatError> {
    let bop = dataset.file("test_targets_bop19.json");
    let counts: HashMap<_, u32> = match bop.is_file() {
        true => read_targets(&bop)?.iter().map(|t| ((t.scene_id, t.im_id, t.obj_id), t.inst_count)).collect(),
        false => HashMap::new(),
    };
    let keys: BTreeSet<_> = entries.iter().map(|t| (t.scene_id, t.im_id, t.obj_id)).collect();
    let target = |key: (u32, u32, u32)| Target {
        scene_id: key.0,
        im_id: key.1,
        obj_id: key.2,
        inst_count: counts.get(&key).copied().unwrap_or(1),
    };
    visible_instances(split, &keys.into_iter().map(target).collect::<Vec<_>>())
}

/// The evaluation meshes of the targets' objects, as far as they are there: they only serve the overlap ratio.
fn eval_meshes(
    dataset: &BopDataset,
    targets: Option<&[Target]>,
) -> Result<HashMap<u32, Arc<TriangleMesh>>, BenchError> {
    let wanted: BTreeSet<u32> = match targets {
        Some(targets) => targets.iter().map(|t| t.obj_id).collect(),
        None => dataset.models_info()?.into_keys().collect(),
    };
    let load = |obj_id: u32| -> Option<Result<(u32, Arc<TriangleMesh>), BenchError>> {
        let path = dataset.eval_model_path(obj_id).ok()?;
        Some(mesh::load(&path, 1e-3).map(|mesh| (obj_id, Arc::new(mesh))).map_err(BenchError::from))
    };
    wanted.into_iter().collect::<Vec<_>>().into_par_iter().filter_map(load).collect()
}
