//! Symmetries of an object and their expansion into poses (`models_info.json`).

use std::f64::consts::PI;

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use unopose_core::geometry::Pose;

/// Poses that map an object onto itself, object frame, metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ObjectSymmetries {
    /// Without the identity.
    pub discrete: Vec<Pose>,
    /// Axes of revolution.
    pub continuous: Vec<SymmetryAxis>,
}

/// Every rotation about this line is a symmetry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SymmetryAxis {
    /// Unit vector.
    pub axis: Vector3<f64>,
    /// A point on the axis, metres.
    pub offset: Vector3<f64>,
}

impl SymmetryAxis {
    /// Rotation by `angle` radians about the axis.
    pub fn rotation(&self, angle: f64) -> Pose {
        let rotation = *Rotation3::from_axis_angle(&Unit::new_unchecked(self.axis), angle).matrix();
        Pose::new(rotation, self.offset - rotation * self.offset)
    }
}

impl ObjectSymmetries {
    /// BOP's step of continuous symmetries: the arc between neighbours is at most this share of the diameter.
    pub const BOP_STEP: f64 = 0.01;

    /// Is the identity the only one?
    pub fn is_empty(&self) -> bool {
        self.discrete.is_empty() && self.continuous.is_empty()
    }

    /// All symmetries, identity first: every sampled rotation after every discrete one. Each continuous axis
    /// gets `ceil(pi / max_step)` rotations; several axes are a union, not a product.
    pub fn expand(&self, max_step: f64) -> Vec<Pose> {
        let steps = (PI / max_step).ceil().max(1.0) as usize;
        let angle = |i: usize| 2.0 * PI * i as f64 / steps as f64;
        let rotations: Vec<Pose> = if self.continuous.is_empty() {
            vec![Pose::identity()]
        } else {
            let of_axis =
                |axis: &SymmetryAxis| (0..steps).map(|i| axis.rotation(angle(i))).collect::<Vec<_>>();
            self.continuous.iter().flat_map(of_axis).collect()
        };
        std::iter::once(Pose::identity())
            .chain(self.discrete.iter().copied())
            .flat_map(|t| rotations.iter().map(move |r| *r * t))
            .collect()
    }

    /// Angle between two object-to-camera rotations in degrees, the smallest over the symmetries. Continuous
    /// axes are solved exactly.
    pub fn rotation_distance_deg(&self, t_a: &Pose, t_b: &Pose) -> f64 {
        let rotation_only = |m: Matrix3<f64>| Pose::new(m, Vector3::zeros());
        let discrete = std::iter::once(Matrix3::identity()).chain(self.discrete.iter().map(|s| s.rotation));
        let distance = |s: Matrix3<f64>| {
            let difference = rotation_only(t_a.rotation.transpose() * t_b.rotation * s);
            let direct = difference.rotation_angle_deg(&Pose::identity());
            self.continuous.iter().map(|c| angle_modulo_axis(&difference, &c.axis)).fold(direct, f64::min)
        };
        discrete.map(distance).fold(f64::INFINITY, f64::min)
    }
}

/// Smallest angle of `rotation * (any rotation about axis)`, degrees: the angle the axis itself is turned by.
fn angle_modulo_axis(rotation: &Pose, axis: &Vector3<f64>) -> f64 {
    let turned = rotation.rotation * axis;
    turned.cross(axis).norm().atan2(turned.dot(axis)).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about_z(degrees: f64) -> Pose {
        Pose::new(
            *Rotation3::from_axis_angle(&Vector3::z_axis(), degrees.to_radians()).matrix(),
            Vector3::zeros(),
        )
    }

    #[test]
    fn one_axis_gives_315_rotations_about_its_line() {
        let axis = SymmetryAxis { axis: Vector3::z(), offset: Vector3::new(0.1, 0.0, 0.3) };
        let flip = Pose::new(Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0)), Vector3::zeros());
        let symmetries = ObjectSymmetries { discrete: vec![flip], continuous: vec![axis] };
        let all = symmetries.expand(ObjectSymmetries::BOP_STEP);
        assert_eq!(all.len(), 2 * 315);
        assert_eq!(all[0], Pose::identity());
        // A point on the axis stays where it is.
        let on_axis = nalgebra::Point3::new(0.1, 0.0, -5.0);
        assert!((all[100].transform(&on_axis) - on_axis).norm() < 1e-12);
        assert!((all[1].rotation_angle_deg(&all[0]) - 360.0 / 315.0).abs() < 1e-9);
        // R_cont R_disc.
        assert_eq!(all[315 + 7], all[7] * flip);
    }

    #[test]
    fn several_axes_are_a_union() {
        let axis = |axis| SymmetryAxis { axis, offset: Vector3::zeros() };
        let symmetries =
            ObjectSymmetries { discrete: vec![], continuous: vec![axis(Vector3::x()), axis(Vector3::y())] };
        assert_eq!(symmetries.expand(0.5).len(), 2 * 7);
        assert_eq!(ObjectSymmetries::default().expand(0.01), [Pose::identity()]);
    }

    #[test]
    fn rotation_distance_leaves_out_the_symmetric_part() {
        let tilt = Pose::new(*Rotation3::from_axis_angle(&Vector3::x_axis(), 0.3).matrix(), Vector3::zeros());
        let a = Pose::identity();
        let b = about_z(10.0) * tilt * about_z(133.0);
        let axis = SymmetryAxis { axis: Vector3::z(), offset: Vector3::zeros() };
        let round = ObjectSymmetries { discrete: vec![], continuous: vec![axis] };
        assert!((round.rotation_distance_deg(&a, &b) - 0.3f64.to_degrees()).abs() < 1e-9);
        let half_turn = ObjectSymmetries { discrete: vec![about_z(180.0)], continuous: vec![] };
        assert!((half_turn.rotation_distance_deg(&a, &about_z(170.0)) - 10.0).abs() < 1e-9);
        assert!(
            (ObjectSymmetries::default().rotation_distance_deg(&a, &about_z(170.0)) - 170.0).abs() < 1e-9
        );
    }
}
