//! Overlap of two views of an object: the share of the surface seen in one that the other sees, too.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use unopose_core::{
    frame::Mask,
    geometry::{Intrinsics, Pose},
};

use crate::{mesh::TriangleMesh, render::depth::render_depth};

/// Points of a view that are looked for in the other one, and that are kept for being found.
const QUERIES: usize = 1000;
const KEPT: usize = 20_000;
/// A point counts as seen when the other view has one within this distance, metres ...
const NEAR: f32 = 0.004;
/// ... or this share of the diameter.
const NEAR_SHARE: f32 = 0.03;

/// Noise-free visible surface of an instance, object frame.
pub(crate) struct VisibleSurface {
    points: Vec<[f32; 3]>,
    tree: Option<ImmutableKdTree<f32, 3>>,
}

impl VisibleSurface {
    pub(crate) fn new(
        mesh: &TriangleMesh,
        t_camera_object: &Pose,
        camera: &Intrinsics,
        visible: &Mask,
    ) -> Self {
        let drawn = render_depth(mesh, t_camera_object, camera, visible.width, visible.height);
        let t_object_camera = t_camera_object.inverse();
        let points: Vec<[f32; 3]> = visible
            .pixels()
            .filter_map(|(col, row)| {
                let z = Some(drawn.get(col, row)).filter(|z| *z > 0.0)?;
                let p = t_object_camera.transform(&camera.back_project(col.into(), row.into(), z.into()));
                Some([p.x as f32, p.y as f32, p.z as f32])
            })
            .collect();
        let step = points.len().div_ceil(KEPT).max(1);
        let points: Vec<[f32; 3]> = points.into_iter().step_by(step).collect();
        let tree = (!points.is_empty()).then(|| ImmutableKdTree::new_from_slice(&points));
        Self { points, tree }
    }

    /// Share of the points of this view that `other` has, too.
    pub(crate) fn overlap_with(&self, other: &Self, diameter: f32) -> f64 {
        let near = NEAR.max(NEAR_SHARE * diameter);
        let Some(tree) = &other.tree else { return 0.0 };
        let seen = |p: &&[f32; 3]| tree.nearest_one::<SquaredEuclidean>(p).distance <= near * near;
        let queries = self.points.iter().step_by(self.points.len().div_ceil(QUERIES).max(1));
        queries.clone().filter(seen).count() as f64 / queries.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::*;

    /// A square of 10 cm, seen from the front, and a view that shows its left half only.
    #[test]
    fn half_a_square_overlaps_by_half() {
        let square = TriangleMesh {
            vertices: vec![[-0.05, -0.05, 0.0], [0.05, -0.05, 0.0], [0.05, 0.05, 0.0], [-0.05, 0.05, 0.0]],
            faces: vec![[0, 1, 2], [0, 2, 3]],
            ..Default::default()
        };
        let camera = Intrinsics { fx: 200.0, fy: 200.0, cx: 39.5, cy: 29.5 };
        let front = Pose::new(nalgebra::Matrix3::identity(), Vector3::new(0.0, 0.0, 0.5));
        let turned =
            Pose::new(*Rotation3::from_axis_angle(&Vector3::y_axis(), 0.6).matrix(), front.translation);
        let mut all = Mask::empty(80, 60);
        all.data.fill(true);
        let mut left = all.clone();
        left.data.iter_mut().enumerate().for_each(|(i, m)| *m = i % 80 < 40);
        let whole = VisibleSurface::new(&square, &front, &camera, &all);
        let other = VisibleSurface::new(&square, &turned, &camera, &all);
        let half = VisibleSurface::new(&square, &front, &camera, &left);
        assert!(whole.overlap_with(&other, 0.1) > 0.99 && other.overlap_with(&whole, 0.1) > 0.99);
        assert!((whole.overlap_with(&half, 0.1) - 0.5).abs() < 0.06, "{}", whole.overlap_with(&half, 0.1));
        assert!(half.overlap_with(&whole, 0.1) > 0.99);
    }
}
