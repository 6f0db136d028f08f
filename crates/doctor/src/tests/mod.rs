//! A drawn view whose distances, sizes and faults are known.

mod faults;
mod sets;

use std::sync::{Arc, OnceLock};

use image::{Rgb, RgbImage, imageops};
use nalgebra::{Matrix3, Vector3};
use unopose_core::{
    frame::{Mask, MaskedView, RgbdFrame},
    geometry::{Intrinsics, Pose},
};
use unopose_dataset::{mesh::TriangleMesh, render::posed_view};

use super::*;

const CAMERA: Intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 159.5, cy: 119.5 };
/// Sides of the box on the table, metres.
const BOX: [f32; 3] = [0.18, 0.12, 0.08];

/// A view with the mask of its box.
#[derive(Clone)]
struct Shot {
    frame: RgbdFrame,
    mask: Mask,
    t_camera_object: Pose,
}

impl Shot {
    fn findings(&self) -> Vec<Finding> {
        let expected = Expected { depth_scale: None, points: 1024 };
        findings(MaskedView { frame: &self.frame, mask: &self.mask }, &expected)
    }

    fn finding(&self, check: Check) -> Finding {
        self.findings().into_iter().find(|finding| finding.check == check).unwrap()
    }
}

/// A box from `low` to `high` of one colour.
fn cuboid(low: [f32; 3], high: [f32; 3], color: [u8; 3]) -> Arc<TriangleMesh> {
    let mut mesh = TriangleMesh::default();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (side, order, sign) in [(low, [0, 2, 1, 1, 2, 3], -1.0), (high, [0, 1, 2, 2, 1, 3], 1.0)] {
            let first = mesh.vertices.len() as u32;
            for (a, b) in [(low, low), (high, low), (low, high), (high, high)] {
                let mut corner = side;
                (corner[u], corner[v]) = (a[u], b[v]);
                mesh.vertices.push(corner);
                mesh.colors.push(color);
                mesh.normals.push(std::array::from_fn(|i| if i == axis { sign } else { 0.0 }));
            }
            mesh.faces.extend([0, 3].map(|i| [order[i], order[i + 1], order[i + 2]].map(|k: u32| first + k)));
        }
    }
    Arc::new(mesh)
}

/// A reddish box on a light table that goes on behind it, seen from above at an angle.
fn shot() -> Shot {
    static SHOT: OnceLock<Shot> = OnceLock::new();
    let make = || {
        let half = BOX.map(|side| side / 2.0);
        let object = cuboid([-half[0], -half[1], 0.0], [half[0], half[1], BOX[2]], [200, 70, 40]);
        let table = cuboid([-3.0, -0.4, -0.1], [0.4, 3.0, 0.0], [190, 190, 180]);
        let eye = Vector3::new(0.35, -0.42, 0.45);
        let forward = (Vector3::new(0.0, 0.0, 0.03) - eye).normalize();
        let right = forward.cross(&Vector3::z()).normalize();
        let down = forward.cross(&right);
        let rotation = Matrix3::from_rows(&[right, down, forward].map(|axis| axis.transpose()));
        let pose = Pose::new(rotation, -rotation * eye);
        let view = posed_view(&[(object, pose), (table, pose)], CAMERA, [320, 240]);
        let mask = view.instances[0].mask_visib.clone();
        Shot { frame: view.frame, mask, t_camera_object: pose }
    };
    SHOT.get_or_init(make).clone()
}

/// The mask with every pixel set that has a set one within `reach` rows and columns.
fn grown(mask: &Mask, reach: i64) -> Mask {
    let inside = |c: i64, r: i64| {
        (0..i64::from(mask.width)).contains(&c)
            && (0..i64::from(mask.height)).contains(&r)
            && mask.get(c as u32, r as u32)
    };
    let mut grown = Mask::empty(mask.width, mask.height);
    for (i, set) in grown.data.iter_mut().enumerate() {
        let (c, r) = ((i % mask.width as usize) as i64, (i / mask.width as usize) as i64);
        *set = (-reach..=reach).any(|dr| (-reach..=reach).any(|dc| inside(c + dc, r + dr)));
    }
    grown
}

fn inverted(mask: &Mask) -> Mask {
    Mask { data: mask.data.iter().map(|set| !set).collect(), ..mask.clone() }
}

#[test]
fn a_clean_view_is_ok_and_measured() {
    let shot = shot();
    for finding in shot.findings() {
        assert_eq!(finding.level, Level::Ok, "{finding}");
        assert!(finding.advice.is_empty());
    }
    let unit = shot.finding(Check::Unit);
    for (name, expected) in [("length_m", BOX[0]), ("width_m", BOX[1]), ("height_m", BOX[2])] {
        let ratio = unit.values[name] / f64::from(expected);
        assert!((ratio - 1.0).abs() < 0.02, "{name} {ratio}: {unit}");
    }
    // The nearest edge of the top is 0.58 m away, the farthest corner 0.75 m.
    let distance = unit.values["distance_m"];
    assert!((0.6..0.68).contains(&distance), "{distance}");
    assert!(unit.text.contains("is that right?") && unit.text.contains(" cm, 0.6"), "{unit}");
    let camera = shot.finding(Check::Camera);
    assert!((camera.values["field_of_view_deg"] - 56.14).abs() < 0.01, "{camera}");
}

#[test]
fn a_plate_is_measured_where_it_is() {
    let points: Vec<[f32; 3]> = (0..121)
        .flat_map(|i| (0..81).map(move |j| [0.001 * i as f32 - 0.06, 0.001 * j as f32 - 0.04, 0.74]))
        .map(|[x, y, z]| [0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y, z])
        .collect();
    let object = MaskedObject::measure(&points).unwrap();
    assert!((object.distance / 0.74 - 1.0).abs() < 1e-3, "{object:?}");
    for (side, expected) in object.extent.iter().zip([0.12, 0.08, 0.0]) {
        assert!((side - expected).abs() < 0.02 * 0.12, "{object:?}");
    }
    assert_eq!(MaskedObject::measure(&points[..15]), None);
}

#[test]
fn a_picture_shows_every_view_in_a_row() {
    let folder = tempfile::tempdir().unwrap();
    let (shot, path) = (shot(), folder.path().join("doctor.png"));
    let view = MaskedView { frame: &shot.frame, mask: &shot.mask };
    write_picture(&path, &[view, view]).unwrap();
    let picture = image::open(&path).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (5 * 322, 2 * 242));
    // The box's points are seen in its colour from both sides, and the bar is white.
    let tile = |index: u32| imageops::crop_imm(&picture, 322 * index, 0, 320, 240).to_image();
    let reddish = |tile: &RgbImage| tile.pixels().filter(|p| p.0[0] > 90 && p.0[0] / 2 > p.0[1]).count();
    assert!(reddish(&tile(3)) > 2000 && reddish(&tile(4)) > 2000);
    let object = MaskedObject::measure(&view.points()).unwrap();
    assert_eq!(bar_length(&object), 0.05);
    let bar = (10..320).filter(|col| tile(3).get_pixel(*col, 228) == &Rgb([255; 3])).count() as f64;
    let expected = 0.05 * 0.85 * 240.0 / (2.0 * object.radius);
    assert!((bar - expected).abs() < 4.0, "{bar} {expected}");
}
