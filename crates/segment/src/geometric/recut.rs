//! A mask cut anew by what a pose says the image should show.

use unopose_core::{
    frame::{Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::{mesh::TriangleMesh, render::depth::render_depth};
use unopose_pairs::data::dilated;

/// Cells of the surface along the longer side of the reference's mask.
const CELLS: u32 = 96;
/// Neighbouring cells whose depths differ by more than this share of the object's radius are not one surface.
const STEP: f32 = 0.3;
/// A point of the old mask that the reference does not show stays within this many radii of the object's middle.
const REACH_OF_OBJECT: f32 = 1.1;
/// Of the posed surface's pixels with depth, the share that must agree before a mask is changed.
const AGREEING: f64 = 0.5;
/// Extents of the mask per diameter of the smallest part that is changed.
const BROAD: u32 = 20;
/// The new mask's size in shares of the old one's.
const SIZES: [f64; 2] = [0.4, 2.5];

/// The surface that a reference view shows, as triangles between its pixels.
#[derive(Clone, Debug)]
pub struct ReferenceSurface {
    mesh: TriangleMesh,
    /// Mean of the vertices and the largest distance to it, metres.
    middle: [f32; 3],
    radius: f32,
}

impl ReferenceSurface {
    /// Of the measured pixels of a mask; `radius` of the object in metres tells which depths belong together.
    pub fn new(frame: &RgbdFrame, mask: &Mask, radius: f32) -> Self {
        let mut mesh = TriangleMesh::default();
        let Some(bounds) = mask.bounding_box() else { return Self { mesh, middle: [0.0; 3], radius } };
        let side = (bounds.col_max - bounds.col_min).max(bounds.row_max - bounds.row_min);
        let step = side.div_ceil(CELLS).max(1);
        let (columns, rows) =
            ((bounds.col_max - bounds.col_min) / step + 1, (bounds.row_max - bounds.row_min) / step + 1);
        let mut index = vec![None; (columns * rows) as usize];
        for (cell, place) in index.iter_mut().enumerate() {
            let (col, row) = (
                bounds.col_min + cell as u32 % columns * step,
                bounds.row_min + cell as u32 / columns * step,
            );
            if col >= mask.width || row >= mask.height || !mask.get(col, row) {
                continue;
            }
            let z = frame.depth.get(col, row);
            if z.is_finite() && z > 0.0 {
                let p = frame.intrinsics.back_project(col.into(), row.into(), z.into());
                *place = Some(mesh.vertices.len() as u32);
                mesh.vertices.push([p.x as f32, p.y as f32, p.z as f32]);
            }
        }
        let at = |column: u32, row: u32| index[(row * columns + column) as usize];
        for row in 0..rows.saturating_sub(1) {
            for column in 0..columns.saturating_sub(1) {
                let corners =
                    [at(column, row), at(column + 1, row), at(column, row + 1), at(column + 1, row + 1)];
                for [a, b, c] in [[0, 1, 2], [1, 3, 2]] {
                    let (Some(a), Some(b), Some(c)) = (corners[a], corners[b], corners[c]) else { continue };
                    let depths = [a, b, c].map(|i| mesh.vertices[i as usize][2]);
                    let (near, far) =
                        depths.iter().fold((f32::MAX, f32::MIN), |(near, far), &z| (near.min(z), far.max(z)));
                    if far - near <= STEP * radius {
                        mesh.faces.push([a, b, c]);
                    }
                }
            }
        }
        let count = mesh.vertices.len().max(1) as f32;
        let middle = std::array::from_fn(|i| mesh.vertices.iter().map(|v| v[i]).sum::<f32>() / count);
        let radius = mesh.vertices.iter().map(|v| distance(v, &middle)).fold(0.0, f32::max);
        Self { mesh, middle, radius }
    }

    /// `mask` grown to where the surface under `t_query_reference` and the measured depth agree within `reach` metres, without
    /// the pixels where they contradict each other and those that are too far away to be the object. Pixels without depth stay
    /// as they are. `None` when the surfaces agree too little to say anything.
    pub fn recut(
        &self,
        query: &RgbdFrame,
        mask: &Mask,
        t_query_reference: &Pose,
        reach: f32,
    ) -> Option<Mask> {
        let (width, height) = (mask.width, mask.height);
        if self.mesh.faces.is_empty() || (query.depth.width, query.depth.height) != (width, height) {
            return None;
        }
        let seen = render_depth(&self.mesh, t_query_reference, &query.intrinsics, width, height);
        let middle = t_query_reference.transform_f32(&self.middle);
        let (mut agreeing, mut judged) = (0usize, 0usize);
        let mut cut = mask.clone();
        for row in 0..height {
            for col in 0..width {
                let (measured, expected) = (query.depth.get(col, row), seen.get(col, row));
                let at = (row * width + col) as usize;
                if !(measured.is_finite() && measured > 0.0) {
                    continue;
                }
                if expected > 0.0 {
                    let agrees = (measured - expected).abs() <= reach;
                    judged += 1;
                    agreeing += usize::from(agrees);
                    cut.data[at] = agrees;
                } else if cut.data[at] {
                    let p = query.intrinsics.back_project(col.into(), row.into(), measured.into());
                    let away = distance(&[p.x as f32, p.y as f32, p.z as f32], &middle);
                    cut.data[at] = away <= REACH_OF_OBJECT * self.radius;
                }
            }
        }
        let cut = with_broad_changes(mask, &cut);
        let share = cut.count() as f64 / mask.count().max(1) as f64;
        let usable = agreeing as f64 >= AGREEING * judged.max(1) as f64;
        (usable && (SIZES[0]..=SIZES[1]).contains(&share)).then_some(cut)
    }
}

/// `old` with those of the changes to `new` that contain a diamond of a twentieth of the mask's extent: borders are as uncertain
/// in the new mask as in the old one.
fn with_broad_changes(old: &Mask, new: &Mask) -> Mask {
    let Some(bounds) = old.bounding_box() else { return old.clone() };
    let extent = (bounds.col_max - bounds.col_min).max(bounds.row_max - bounds.row_min);
    let half = extent.div_ceil(2 * BROAD).max(1) as usize;
    let mut changed = old.clone();
    for (value, from, to) in [(false, old, new), (true, new, old)] {
        let only = from.data.iter().zip(&to.data).map(|(&a, &b)| a && !b).collect();
        let broad = opened(&Mask { data: only, ..*old }, half);
        changed
            .data
            .iter_mut()
            .zip(&broad.data)
            .filter(|(_, broad)| **broad)
            .for_each(|(pixel, _)| *pixel = value);
    }
    changed
}

/// Morphological opening by a diamond that reaches `half` pixels.
fn opened(mask: &Mask, half: usize) -> Mask {
    let inverted = |mask: &Mask| Mask { data: mask.data.iter().map(|pixel| !pixel).collect(), ..*mask };
    let eroded = inverted(&dilated(&inverted(mask), half));
    dilated(&eroded, half)
}

fn distance(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};
    use unopose_core::{frame::DepthMap, geometry::Intrinsics};

    use super::*;

    /// A square of 20 x 20 pixels 1 m away from column `left` on, before a wall at 1.5 m; a bar in front of its rows 30..34.
    fn view(left: u32, bar: bool) -> (RgbdFrame, Mask) {
        let mut depth = DepthMap { width: 64, height: 64, data: vec![1.5; 64 * 64] };
        let mut mask = Mask::empty(64, 64);
        for row in 22..42 {
            for col in left..left + 20 {
                let hidden = bar && (30..34).contains(&row);
                depth.data[(row * 64 + col) as usize] = if hidden { 0.7 } else { 1.0 };
                mask.data[(row * 64 + col) as usize] = !hidden;
            }
        }
        let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 31.5, cy: 31.5 };
        (RgbdFrame { rgb: image::RgbImage::new(64, 64), depth, intrinsics }, mask)
    }

    #[test]
    fn only_broad_parts_are_opened() {
        let mut mask = Mask::empty(12, 9);
        let mut fill = |cols: std::ops::Range<usize>, rows: std::ops::Range<usize>| {
            rows.for_each(|row| mask.data[row * 12 + cols.start..row * 12 + cols.end].fill(true));
        };
        fill(0..4, 0..3);
        fill(6..8, 0..9);
        // The bar of two columns goes; of the block in the image's corner only its one free corner.
        let kept: Vec<(u32, u32)> = opened(&mask, 1).pixels().collect();
        let block = (0..3).flat_map(|row| (0..4).map(move |col| (col, row)));
        assert_eq!(kept, block.filter(|&pixel| pixel != (3, 2)).collect::<Vec<_>>());
    }

    #[test]
    fn a_ragged_mask_becomes_the_objects() {
        let (reference, whole) = view(20, false);
        let surface = ReferenceSurface::new(&reference, &whole, 0.15);
        let (query, truth) = view(24, true);
        // 4 pixels to the right at 1 m.
        let pose = Pose::new(Matrix3::identity(), Vector3::new(0.04, 0.0, 0.0));
        // Half of the object, the bar and a piece of the wall.
        let mut ragged = Mask::empty(64, 64);
        for row in 22..42 {
            (24..34).chain(50..60).for_each(|col| ragged.data[(row * 64 + col) as usize] = true);
        }
        let cut = surface.recut(&query, &ragged, &pose, 0.01).unwrap();
        assert!(ragged.iou(&truth) < 0.5, "{}", ragged.iou(&truth));
        // The outermost pixels lie on the border of the surface.
        assert!(cut.iou(&truth) > 0.85, "{}", cut.iou(&truth));
        assert!((50..60).all(|col| !cut.get(col, 30)) && (24..44).all(|col| !cut.get(col, 31)));
        // Where nothing agrees nothing is changed.
        let wrong = Pose::new(Matrix3::identity(), Vector3::new(0.04, 0.0, 0.2));
        assert!(surface.recut(&query, &ragged, &wrong, 0.01).is_none());
        let nothing = ReferenceSurface::new(&reference, &Mask::empty(64, 64), 0.15);
        assert!(nothing.recut(&query, &ragged, &pose, 0.01).is_none());
    }
}
