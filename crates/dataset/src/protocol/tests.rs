//! A synthetic dataset of one square on the optical axis, turned about the vertical from image to image.

use std::{
    collections::{BTreeMap, HashMap},
    path::Path,
    sync::Arc,
};

use nalgebra::{Rotation3, Vector3};
use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::{Intrinsics, Pose},
};

use super::*;
use crate::{
    formats::{
        BopSplit, ModelInfo, ObjectSymmetries, ReferenceTarget, Target,
        bop::{BopSceneWriter, SceneImage, SceneInstance},
    },
    mesh::TriangleMesh,
};

/// Scene 1 shows the square turned by 0, 20 and 40 degrees, scene 2 by 31, 66 and 86 degrees.
const TURNS: [(u32, [f64; 3]); 2] = [(1, [0.0, 20.0, 40.0]), (2, [31.0, 66.0, 86.0])];

fn split(root: &Path, turns: &[(u32, [f64; 3])]) -> BopSplit {
    let mut mask = Mask::empty(64, 64);
    for row in 22..42 {
        mask.data[row * 64 + 22..row * 64 + 42].fill(true);
    }
    for &(scene_id, turns) in turns {
        let mut writer = BopSceneWriter::new(root, scene_id, 0.1, false);
        for (im_id, degrees) in (0..).zip(turns) {
            let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), f64::to_radians(degrees));
            let instance = SceneInstance {
                obj_id: 1,
                t_camera_object: Pose::new(*turn.matrix(), Vector3::new(0.0, 0.0, 1.0)),
                mask: mask.clone(),
                mask_visib: mask.clone(),
                px_count_all: 400,
            };
            let frame = RgbdFrame {
                rgb: image::RgbImage::new(64, 64),
                depth: DepthMap::zeros(64, 64),
                intrinsics: Intrinsics { fx: 100.0, fy: 100.0, cx: 31.5, cy: 31.5 },
            };
            writer.add(&SceneImage { im_id, frame, instances: vec![instance] }).unwrap();
        }
        writer.finish().unwrap();
    }
    BopSplit::open(root).unwrap()
}

fn infos() -> BTreeMap<u32, ModelInfo> {
    let info = ModelInfo {
        diameter: 0.28,
        min: Vector3::new(-0.1, -0.1, 0.0),
        size: Vector3::new(0.2, 0.2, 0.0),
        symmetries: ObjectSymmetries::default(),
    };
    [(1, info)].into()
}

fn square() -> HashMap<u32, Arc<TriangleMesh>> {
    let mesh = TriangleMesh {
        vertices: vec![[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0]],
        faces: vec![[0, 1, 2], [0, 2, 3]],
        ..Default::default()
    };
    [(1, Arc::new(mesh))].into()
}

fn built(split: &BopSplit, references: &BopSplit, targets: Option<&[Target]>, seed: u64) -> BuiltLists {
    let (infos, meshes) = (infos(), square());
    let input = ListInput { split, reference_split: references, infos: &infos, meshes: &meshes, targets };
    build_lists(&input, &Protocol::all(), seed).unwrap()
}

fn entries(lists: &BuiltLists, protocol: Protocol) -> &[ReferenceTarget] {
    &lists.lists.iter().find(|list| list.protocol == protocol).unwrap().entries
}

#[test]
fn every_protocol_keeps_its_rule() {
    let folder = tempfile::tempdir().unwrap();
    let split = split(folder.path(), &TURNS);
    let lists = built(&split, &split, None, 3);
    // The view at 86 degrees is 46 from that at 40, the one at 66 is 46 and 26 away from two of the other scene.
    assert_eq!(lists.targets.len(), 6);
    let turn = |scene_id: u32, im_id: u32| TURNS[scene_id as usize - 1].1[im_id as usize];
    for list in &lists.lists {
        assert_eq!(list.entries.len() + list.without_reference, 6, "{:?}", list.protocol);
        for t in &list.entries {
            let degrees = (turn(t.scene_id, t.im_id) - turn(t.ref_scene_id, t.ref_im_id)).abs();
            assert!((t.rot_deg.unwrap() - degrees).abs() < 1e-6, "{t:?}");
            assert_ne!((t.scene_id, t.im_id), (t.ref_scene_id, t.ref_im_id));
            let other = t.scene_id != t.ref_scene_id;
            let kept = match list.protocol {
                Protocol::Rot50 => degrees < 50.0,
                Protocol::CrossScene => other && degrees < 50.0,
                Protocol::Bin(bin) => other && (degrees / 10.0) as usize == bin,
                Protocol::Rot90 => other && degrees < 90.0,
                Protocol::OnePerObject | Protocol::FewPerObject(_) => true,
            };
            assert!(kept, "{:?}: {t:?}", list.protocol);
            // A plane that faces the camera is seen whole.
            let facing =
                [turn(t.scene_id, t.im_id), turn(t.ref_scene_id, t.ref_im_id)].iter().all(|d| *d < 50.0);
            assert!(!facing || t.overlap.unwrap() > 0.9, "{t:?}");
        }
    }
    // One view for all: the view itself has no other.
    let one = entries(&lists, Protocol::OnePerObject);
    assert_eq!(one.len(), 5);
    assert!(one.iter().all(|t| (t.ref_scene_id, t.ref_im_id) == (one[0].ref_scene_id, one[0].ref_im_id)));
    // With all views in the pool there is one within 50 degrees for each.
    assert!(entries(&lists, Protocol::FewPerObject(8)).iter().all(|t| t.rot_deg.unwrap() < 50.0));
    // The seed alone decides.
    assert_eq!(entries(&built(&split, &split, None, 3), Protocol::Rot50), entries(&lists, Protocol::Rot50));
    let others = (4..9).map(|seed| built(&split, &split, None, seed));
    let mut rot50 = others.map(|lists| entries(&lists, Protocol::Rot50).to_vec());
    assert!(rot50.any(|other| other != entries(&lists, Protocol::Rot50)));
}

#[test]
fn references_come_from_images_without_targets_and_from_other_splits() {
    let folder = tempfile::tempdir().unwrap();
    let test = split(&folder.path().join("test"), &TURNS);
    let target = |im_id| Target { scene_id: 1, im_id, obj_id: 1, inst_count: 1 };
    let lists = built(&test, &test, Some(&[target(0), target(1)]), 1);
    // Images 0 and 1 of scene 1 are taken.
    let rot50 = entries(&lists, Protocol::Rot50);
    assert_eq!(rot50.len(), 2);
    assert!(rot50.iter().all(|t| t.ref_scene_id == 2 || t.ref_im_id == 2), "{rot50:?}");
    // Scene 1 of another split is another scene, and image 0 of it another image.
    let train = split(&folder.path().join("train_real"), &[(1, [0.0, 100.0, 120.0])]);
    let lists = built(&test, &train, Some(&[target(0)]), 1);
    let found = entries(&lists, Protocol::CrossScene);
    assert_eq!((found.len(), found[0].ref_im_id, found[0].rot_deg), (1, 0, Some(0.0)));
    assert!((found[0].overlap.unwrap() - 1.0).abs() < 1e-12);
    let joined = train.joined(split(&folder.path().join("more"), &[(5, [3.0, 4.0, 5.0])]));
    assert_eq!((joined.name().as_str(), joined.scene_ids()), ("train_real,more", &[1, 5][..]));
    assert!(joined.scene(5).unwrap().folder.ends_with("more/000005"));
}

#[test]
fn names_are_those_of_the_files() {
    for protocol in Protocol::all() {
        assert_eq!(Protocol::by_name(&protocol.name()).unwrap(), protocol);
    }
    assert_eq!(Protocol::by_name("5_per_object").unwrap(), Protocol::FewPerObject(5));
    let message = Protocol::by_name("rot60").unwrap_err().to_string();
    assert!(message.contains("\"rot60\"") && message.contains("crossscene_rot50"), "{message}");
}
