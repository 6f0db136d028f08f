//! Target list, reference lists of all protocols and exact detections of a test set.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
    sync::Arc,
};

use serde::Serialize;
use unopose_core::config::SynthConfig;
use unopose_dataset::{
    formats::{
        BopDataset, ModelInfo,
        detections::{visible_instances, write_detections},
        files::write_json,
        targets::{Target, write_targets},
    },
    mesh::TriangleMesh,
    protocol::{ListInput, Protocol, build_lists},
};

use super::{
    SynthError,
    object::{LeftOpen, SynthObject},
};

/// What the shape of a target's object leaves open.
#[derive(Serialize)]
struct PrintDecides {
    scene_id: u32,
    im_id: u32,
    obj_id: u32,
    print_decides: bool,
    kind: LeftOpen,
}

/// Writes `test_targets_bop19.json`, `test_ref_targets_PROTOCOL.json` and `dets_gt.json`, and `print_decides.json` for a set with
/// packages.
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
    if config.printed > 0.0 {
        let kinds: HashMap<u32, LeftOpen> = objects.iter().map(|o| (o.obj_id, o.left_open)).collect();
        let entry = |&Target { scene_id, im_id, obj_id, .. }: &Target| {
            let kind = kinds.get(&obj_id).copied().unwrap_or_default();
            PrintDecides { scene_id, im_id, obj_id, print_decides: kind != LeftOpen::None, kind }
        };
        let entries: Vec<PrintDecides> = targets.iter().map(entry).collect();
        write_json(&out.join("print_decides.json"), &entries, true)?;
    }
    for list in built.lists.iter().filter(|list| !list.entries.is_empty()) {
        let file = out.join(format!("test_ref_targets_{}.json", list.protocol.name()));
        write_targets(&file, &list.entries)?;
    }
    Ok(write_detections(&out.join("dets_gt.json"), &visible_instances(&split, &targets)?)?)
}
