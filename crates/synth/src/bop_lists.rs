//! Target list, reference lists of all protocols and exact detections of a test set.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
    sync::Arc,
};

use unopose_core::config::SynthConfig;
use unopose_dataset::{
    formats::{
        BopDataset, ModelInfo,
        detections::{visible_instances, write_detections},
        targets::write_targets,
    },
    mesh::TriangleMesh,
    protocol::{ListInput, Protocol, build_lists},
};

use super::{SynthError, object::SynthObject};

/// Writes `test_targets_bop19.json`, `test_ref_targets_PROTOCOL.json` and `dets_gt.json`.
pub(super) fn write_lists(
    config: &SynthConfig,
    out: &Path,
    objects: &[SynthObject],
    infos: &BTreeMap<u32, ModelInfo>,
) -> Result<(), SynthError> {
    let split = BopDataset::open(out)?.split("test")?;
    let meshes: HashMap<u32, Arc<TriangleMesh>> =
        objects.iter().map(|o| (o.obj_id, o.mesh.clone())).collect();
    let input = ListInput { split: &split, reference_split: &split, infos, meshes: &meshes, targets: None };
    let built = build_lists(&input, &Protocol::all(), config.seed)?;
    let mut targets = built.targets;
    targets.sort_unstable();
    write_targets(&out.join("test_targets_bop19.json"), &targets)?;
    for list in built.lists.iter().filter(|list| !list.entries.is_empty()) {
        let file = out.join(format!("test_ref_targets_{}.json", list.protocol.name()));
        write_targets(&file, &list.entries)?;
    }
    Ok(write_detections(&out.join("dets_gt.json"), &visible_instances(&split, &targets)?)?)
}
