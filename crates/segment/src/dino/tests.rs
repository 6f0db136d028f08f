//! Templates of a model and reference views on a made dataset, with results that are kept.

use std::{
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use nalgebra::Vector3;
use unopose_core::{
    config::VitConfig,
    files::write_atomic,
    geometry::{Intrinsics, Pose},
};
use unopose_dataset::{
    formats::{
        BopDataset, ReferenceTarget,
        bop::{BopSceneWriter, SceneImage, SceneInstance},
    },
    mesh::{TriangleMesh, ply},
    render::posed_view,
};
use unopose_nn::{
    checkpoint::{TensorFile, official_tensors},
    model::Initializer,
};

use super::*;
use crate::{
    DatasetSegmentation, ImageKey, ObjectViews, ProposalGenerator, Templates, UnoSeg, segment_targets,
};

/// Weights of a small transformer, in a file of timm's naming.
fn matcher(path: &Path, seed: u64) -> DinoMatcher {
    let config = VitConfig {
        embed_dim: 64,
        depth: 2,
        heads: 1,
        patch_size: 28,
        register_tokens: 0,
        no_embed_class: false,
        ..VitConfig::default()
    };
    let device = Device::flex();
    let transformer = VisionTransformer::new(&config, SIDE, &mut Initializer::new(seed, &device));
    let tensors = official_tensors(&transformer).unwrap();
    TensorFile { tensors, metadata: Default::default() }.write(path).unwrap();
    DinoMatcher::load(path, DeviceChoice::Flex).unwrap()
}

/// A box of coloured corners, `models/obj_000003.ply`, and two images of it turned.
fn dataset(root: &Path) -> (BopDataset, Vec<Proposal>) {
    let bit = |i: u32, axis: u32| (i >> axis & 1) as f32;
    let mesh = TriangleMesh {
        vertices: (0..8).map(|i| [0.06 * bit(i, 0), 0.09 * bit(i, 1), 0.12 * bit(i, 2)]).collect(),
        colors: (0..8u8).map(|i| [30 * i, 255 - 30 * i, 90]).collect(),
        faces: [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
            .iter()
            .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect(),
        ..Default::default()
    };
    let path = root.join("models/obj_000003.ply");
    write_atomic(&path, |out| ply::write(&mesh, 1000.0, None, out)).unwrap();
    let mesh = std::sync::Arc::new(unopose_dataset::mesh::load(&path, 1e-3).unwrap());
    let intrinsics = Intrinsics { fx: 120.0, fy: 120.0, cx: 39.5, cy: 29.5 };
    let mut writer = BopSceneWriter::new(&root.join("test"), 1, 0.1, false);
    let mut proposals = Vec::new();
    for im_id in 0..2 {
        let position = Vector3::new(0.3, 0.3 - 0.5 * f64::from(im_id), 0.3);
        let t_camera_object = Pose::looking_at(&position, &Vector3::new(0.03, 0.045, 0.06), 0.0);
        let mut view = posed_view(&[(mesh.clone(), t_camera_object)], intrinsics, [80, 60]);
        let seen = view.instances.remove(0);
        let instance = SceneInstance {
            obj_id: 3,
            t_camera_object,
            mask: seen.mask.clone(),
            mask_visib: seen.mask_visib.clone(),
            px_count_all: seen.px_count_all,
        };
        writer.add(&SceneImage { im_id, frame: view.frame, instances: vec![instance] }).unwrap();
        proposals.extend(Proposal::new(seen.mask_visib, 0.5));
    }
    writer.finish().unwrap();
    (BopDataset::open(root).unwrap(), proposals)
}

/// The same proposals for every image; counts how often it is asked.
struct Given {
    proposals: Vec<Proposal>,
    asked: AtomicUsize,
}

impl ProposalGenerator for Given {
    fn name(&self) -> String {
        "given".into()
    }

    fn proposals(&self, _: &RgbdFrame, _: Option<ImageKey>) -> Result<Vec<Proposal>, SegmentError> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        Ok(self.proposals.clone())
    }
}

#[test]
fn templates_and_references_find_objects_and_results_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (dataset, proposals) = dataset(folder.path());
    let split = dataset.test_split().unwrap();
    let target = ReferenceTarget {
        scene_id: 1,
        im_id: 1,
        obj_id: 3,
        ref_scene_id: 1,
        ref_im_id: 0,
        rot_deg: None,
        overlap: None,
    };
    let given = Given { proposals, asked: AtomicUsize::new(0) };
    let weights = folder.path().join("dino.safetensors");
    let dino = matcher(&weights, 1);
    let run =
        |dino: &DinoMatcher, views: ObjectViews<'_>, targets: &[ReferenceTarget]| -> DatasetSegmentation {
            let unoseg = UnoSeg { generator: &given, matcher: dino };
            let keep = folder.path().join("keep");
            segment_targets(&unoseg, targets, &split, &views, &keep, &mut |_, _| {}).unwrap()
        };
    let asked = || given.asked.load(Ordering::Relaxed);
    let templates = Templates::new(&dataset, 12).unwrap();
    let targets = std::slice::from_ref(&target);
    let first = run(&dino, ObjectViews::Templates(&templates), targets);
    assert_eq!((first.proposals.len(), asked()), (2, 1));
    // Both proposals go to the object, and overlap; the scores are those of its twelve views.
    let drawn = templates.views(3).unwrap();
    let views: Vec<MaskedView> = drawn.iter().map(|(frame, mask)| MaskedView { frame, mask }).collect();
    let frame = split.scene(1).unwrap().frame(1).unwrap();
    let object = dino.object(&views).unwrap();
    let scores = dino.scores(&frame, &given.proposals, &[&object]).unwrap().remove(0);
    assert_eq!((first.detections.len(), first.detections[0].category_id), (1, 3));
    assert_eq!(first.detections[0].score, scores[0].max(scores[1]));
    assert!(scores.iter().all(|score| *score > 0.0 && *score < 1.0), "{scores:?}");

    // Kept; not for other views, other numbers of templates and other weights.
    let again = run(&dino, ObjectViews::Templates(&templates), targets);
    assert_eq!((again.detections == first.detections, asked()), (true, 1));
    let by_reference = run(&dino, ObjectViews::References(&split), targets);
    assert_eq!(asked(), 2);
    assert_ne!(by_reference.detections[0].score, first.detections[0].score);
    let more = Templates::new(&dataset, 42).unwrap();
    run(&dino, ObjectViews::Templates(&more), targets);
    assert_eq!(asked(), 3);
    run(&matcher(&weights, 2), ObjectViews::Templates(&more), targets);
    assert_eq!(asked(), 4);

    // An object without a model stops the run.
    let unoseg = UnoSeg { generator: &given, matcher: &dino };
    let other = [ReferenceTarget { obj_id: 4, ..target }];
    let views = ObjectViews::Templates(&templates);
    let refused = segment_targets(&unoseg, &other, &split, &views, folder.path(), &mut |_, _| {});
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("obj_000004.ply"), "{message}");
}
