//! Visible surface discrepancy (Hodan et al., "BOP: Benchmark for 6D object pose estimation", ECCV 2018) in
//! the form of the BOP challenges since 2019: distances to the camera centre, step cost, pixels without a
//! measurement count as visible.

use unopose_core::{
    frame::DepthMap,
    geometry::{Intrinsics, Pose},
};
use unopose_dataset::render::depth::{DepthWindow, render_depth};

use super::{TAUS, object::EvalObject};

/// The measured side of the comparison.
#[derive(Clone, Copy, Debug)]
pub struct TestView<'a> {
    /// Measured depth; 0 where there is no measurement, which counts as visible.
    pub depth: &'a DepthMap,
    /// Intrinsics of the depth image.
    pub camera: &'a Intrinsics,
    /// How far behind the measured surface a pixel still counts as visible, metres.
    pub delta: f64,
}

impl TestView<'_> {
    /// Depth of an object in this view.
    pub fn render(&self, object: &EvalObject, t_camera_object: &Pose) -> DepthWindow {
        render_depth(&object.mesh, t_camera_object, self.camera, self.depth.width, self.depth.height)
    }
}

/// VSD for every misalignment tolerance of [`TAUS`] (shares of the diameter), each in 0..=1. `rendered_gt` is
/// the object's depth in `t_gt`.
pub fn vsd(
    object: &EvalObject,
    view: &TestView,
    t_est: &Pose,
    t_gt: &Pose,
    rendered_gt: &DepthWindow,
) -> [f64; TAUS] {
    if !sphere_projections_overlap(0.5 * object.diameter, t_est, t_gt) {
        return [1.0; TAUS];
    }
    compare(view, &view.render(object, t_est), rendered_gt, object.diameter)
}

/// Do the silhouettes of two spheres around the origins of the poses overlap?
fn sphere_projections_overlap(radius: f64, t_a: &Pose, t_b: &Pose) -> bool {
    let (a, b) = (t_a.translation, t_b.translation);
    let distance = (a.xy() / a.z - b.xy() / b.z).norm();
    distance < radius / a.z + radius / b.z
}

fn compare(view: &TestView, est: &DepthWindow, gt: &DepthWindow, diameter: f64) -> [f64; TAUS] {
    let (mut union, mut intersection) = (0u32, 0u32);
    let mut costs = [0u32; TAUS];
    let camera = view.camera;
    let rows = est.bounds.row_min.min(gt.bounds.row_min)..est.bounds.row_max.max(gt.bounds.row_max);
    let columns = est.bounds.col_min.min(gt.bounds.col_min)..est.bounds.col_max.max(gt.bounds.col_max);
    for row in rows {
        let y = (f64::from(row) - camera.cy) / camera.fy;
        for col in columns.clone() {
            let [z_est, z_gt] = [est, gt].map(|window| f64::from(window.get(col, row)));
            if z_est == 0.0 && z_gt == 0.0 {
                continue;
            }
            let x = (f64::from(col) - camera.cx) / camera.fx;
            // Distance to the camera centre per unit of depth.
            let stretch = (x * x + y * y + 1.0).sqrt();
            let z_test = f64::from(view.depth.get(col, row));
            let in_front = |z: f64| z_test == 0.0 || (z - z_test) * stretch <= view.delta;
            let visible_gt = z_gt > 0.0 && in_front(z_gt);
            let visible_est = z_est > 0.0 && (in_front(z_est) || visible_gt);
            union += u32::from(visible_gt || visible_est);
            if visible_gt && visible_est {
                intersection += 1;
                let distance = (z_gt - z_est).abs() * stretch / diameter;
                for (tau, cost) in costs.iter_mut().enumerate() {
                    *cost += u32::from(distance >= super::threshold(tau));
                }
            }
        }
    }
    if union == 0 {
        return [1.0; TAUS];
    }
    costs.map(|cost| f64::from(cost + union - intersection) / f64::from(union))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};
    use unopose_dataset::{formats::ObjectSymmetries, mesh::TriangleMesh};

    use super::*;

    const CAMERA: Intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 31.5, cy: 31.5 };

    /// A square of 20 cm facing the camera; at 1 m it covers 20 x 20 pixels.
    fn square() -> EvalObject {
        let mesh = TriangleMesh {
            vertices: vec![[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0]],
            faces: vec![[0, 1, 2], [0, 2, 3]],
            ..Default::default()
        };
        EvalObject::new(mesh, 0.2 * 2f64.sqrt(), &ObjectSymmetries::default())
    }

    fn at(x: f64, z: f64) -> Pose {
        Pose::new(Matrix3::identity(), Vector3::new(x, 0.0, z))
    }

    fn error(depth: &DepthMap, t_est: &Pose) -> [f64; TAUS] {
        let (object, view) = (square(), TestView { depth, camera: &CAMERA, delta: 0.015 });
        let gt = at(0.0, 1.0);
        vsd(&object, &view, t_est, &gt, &view.render(&object, &gt))
    }

    #[test]
    fn shifted_by_half_its_width_a_third_of_the_union_is_common() {
        let errors = error(&DepthMap::zeros(64, 64), &at(0.1, 1.0));
        assert!(errors.iter().all(|e| (e - 2.0 / 3.0).abs() < 1e-12), "{errors:?}");
        assert_eq!(error(&DepthMap::zeros(64, 64), &at(0.0, 1.0)), [0.0; TAUS]);
    }

    #[test]
    fn a_shift_in_depth_costs_where_it_exceeds_the_tolerance() {
        // 2.5 cm nearer: 8.8 % of the diameter along the axis, a bit more along oblique rays. The nearer
        // square projects to 20.5 pixels, which cover the same centres.
        let errors = error(&DepthMap::zeros(64, 64), &at(0.0, 0.975));
        assert_eq!(errors[0], 1.0);
        assert_eq!(errors[1..], [0.0; 9]);
    }

    #[test]
    fn hidden_parts_do_not_count() {
        // A wall at 0.5 m hides the left half; the estimate 3 cm behind is hidden by the true surface only
        // where that is not visible itself.
        let mut depth = DepthMap { width: 64, height: 64, data: vec![1.0; 64 * 64] };
        for i in 0..64 * 64 {
            if i % 64 < 32 {
                depth.data[i] = 0.5;
            }
        }
        let errors = error(&depth, &at(0.1, 1.0));
        // Visible: true columns 32..42, estimated 32..52.
        assert!((errors[0] - 0.5).abs() < 1e-12, "{errors:?}");
        let all_hidden = DepthMap { width: 64, height: 64, data: vec![0.5; 64 * 64] };
        assert_eq!(error(&all_hidden, &at(0.0, 1.0)), [1.0; TAUS]);
        assert_eq!(error(&depth, &at(0.4, 1.0)), [1.0; TAUS]);
    }
}
