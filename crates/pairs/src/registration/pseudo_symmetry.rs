//! Turns about an axis of revolution, which a seen shape hardly tells apart.
//!
//! The axis comes from slippage analysis (Gelfand, Guibas, "Shape Segmentation Using Local Slippage Analysis", SGP 2004):
//! the motion along which the points slide on their own tangent planes.

use nalgebra::{Matrix3, Matrix6, Rotation3, SymmetricEigen, Unit, Vector3, Vector6};
use unopose_core::geometry::Pose;

use super::surface::{Surface, vector};

/// Eigenvalue of the normalised slippage matrix below which a motion slides: noise and edges keep a real can's above 0.
const SLIPPABLE: f64 = 0.02;
/// Share of rotation in a unit motion from which it counts as a turn.
const MIN_TURN: f64 = 0.5;
/// Step of the turns about an axis of revolution, degrees.
const STEP_DEG: usize = 10;

/// Motions of a camera's frame (metres) that a view of a shape in it hardly tells apart.
#[derive(Clone, Debug)]
pub struct PseudoSymmetries {
    /// Of the body of revolution.
    pub axis: Axis,
    /// Turns about it by 10 degrees each, without the identity.
    pub turns: Vec<Pose>,
}

/// A line in a camera's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Unit vector.
    pub direction: Vector3<f64>,
    /// A point of it, metres.
    pub point: Vector3<f64>,
}

impl PseudoSymmetries {
    /// Of a surface; `None` where no axis is its own.
    pub(super) fn of(surface: &Surface) -> Option<Self> {
        let axis = axis_of_revolution(surface)?;
        let direction = Unit::new_normalize(axis.direction);
        let turn = |degrees: usize| Rotation3::from_axis_angle(&direction, (degrees as f64).to_radians());
        let turns = (STEP_DEG..360).step_by(STEP_DEG).map(|degrees| about(turn(degrees), &axis.point));
        Some(Self { turns: turns.collect(), axis })
    }
}

/// The axis about which the surface slides best.
fn axis_of_revolution(surface: &Surface) -> Option<Axis> {
    let scale = surface.extent / 2.0;
    let row = |(p, n): (&[f32; 3], &Vector3<f64>)| {
        let moment = ((vector(p) - surface.center) / scale).cross(n);
        Vector6::new(moment.x, moment.y, moment.z, n.x, n.y, n.z)
    };
    let rows = surface.points.iter().zip(&surface.normals).map(row);
    let sum = rows.map(|row| row * row.transpose()).sum::<Matrix6<f64>>() / surface.points.len() as f64;
    let eigen = SymmetricEigen::new(sum);
    // Of all slipping motions the one that turns most: a can's side slides along its axis, too.
    let slipping: Vec<Vector6<f64>> = (0..6)
        .filter(|&i| eigen.eigenvalues[i] < SLIPPABLE)
        .map(|i| eigen.eigenvectors.column(i).into_owned())
        .collect();
    let turn = |motion: &Vector6<f64>| Vector3::new(motion[0], motion[1], motion[2]);
    let turns = slipping.iter().map(|m| turn(m) * turn(m).transpose()).sum::<Matrix3<f64>>();
    let turns = SymmetricEigen::new(turns);
    let most = turns.eigenvalues.imax();
    if slipping.is_empty() || turns.eigenvalues[most] < MIN_TURN * MIN_TURN {
        return None;
    }
    let axis = turns.eigenvectors.column(most).into_owned();
    let motion = slipping.iter().map(|m| m * turn(m).dot(&axis)).sum::<Vector6<f64>>();
    let (turn, shift) = (turn(&motion), Vector3::new(motion[3], motion[4], motion[5]));
    let point = surface.center + turn.cross(&shift) / turn.norm_squared() * scale;
    Some(Axis { direction: turn.normalize(), point })
}

/// A turn about a point.
fn about(turn: Rotation3<f64>, point: &Vector3<f64>) -> Pose {
    let rotation = turn.into_inner();
    Pose::new(rotation, point - rotation * point)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid over two parameters in [0, 1].
    fn surface(at: impl Fn(f64, f64) -> [f64; 3]) -> Surface {
        let side = 70;
        let points: Vec<[f32; 3]> = (0..side * side)
            .map(|i| at((i % side) as f64 / side as f64, (i / side) as f64 / side as f64).map(|x| x as f32))
            .collect();
        Surface::new(&points, 0.0015, "reference").unwrap()
    }

    #[test]
    fn a_can_turns_about_its_axis() {
        // The visible half of a can of 4 cm radius and 10 cm height, its axis along y through (0.01, 0, 0.6).
        let can = surface(|u, v| {
            let angle = std::f64::consts::PI * (u - 0.5);
            [0.01 + 0.04 * angle.sin(), 0.1 * (v - 0.5), 0.6 - 0.04 * angle.cos()]
        });
        let PseudoSymmetries { turns, axis } = PseudoSymmetries::of(&can).unwrap();
        assert!(axis.direction.y.abs() > 0.999, "{axis:?}");
        assert_eq!(turns.len(), 35);
        let quarter = &turns[8];
        assert!((quarter.rotation_angle_deg(&Pose::identity()) - 90.0).abs() < 1e-6);
        // The axis stays where it is.
        for y in [-0.05, 0.05] {
            let on_axis = Vector3::new(0.01, y, 0.6);
            let moved = quarter.rotation * on_axis + quarter.translation;
            assert!((moved - on_axis).norm() < 0.002, "{moved}");
        }
    }

    #[test]
    fn a_corner_has_no_axis() {
        // Three faces of a box that meet in a corner.
        let corner = surface(|u, v| match (3.0 * u) as usize {
            0 => [0.1 * (3.0 * u), 0.1 * v, 0.6],
            1 => [0.1 * (3.0 * u - 1.0), 0.0, 0.6 + 0.1 * v],
            _ => [0.0, 0.1 * (3.0 * u - 2.0), 0.6 + 0.1 * v],
        });
        assert!(PseudoSymmetries::of(&corner).is_none());
    }
}
