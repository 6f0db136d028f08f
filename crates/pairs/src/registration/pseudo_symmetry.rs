//! Turns that a seen shape hardly tells apart: about an axis of revolution, or by right angles of a box.
//!
//! The axis comes from slippage analysis (Gelfand, Guibas, "Shape Segmentation Using Local Slippage Analysis", SGP 2004):
//! the motion along which the points slide on their own tangent planes. A box has no such motion; its axes are the
//! directions that its normals prefer.

use nalgebra::{Matrix3, Matrix6, Rotation3, SymmetricEigen, Unit, Vector3, Vector6};
use unopose_core::geometry::Pose;

use super::surface::{Surface, vector};

/// Eigenvalue of the normalised slippage matrix below which a motion slides: noise and edges keep a real can's above 0.
const SLIPPABLE: f64 = 0.02;
/// Share of rotation in a unit motion from which it counts as a turn.
const MIN_TURN: f64 = 0.5;
/// Step of the turns about an axis of revolution, degrees.
const STEP_DEG: usize = 10;
/// Cosine up to which a normal belongs to a face: 25 degrees.
const FACE_COSINE: f64 = 0.906;
/// Share of the points left out at either end of a box's side.
const TRIM: f64 = 0.02;

/// Motions of a camera's frame (metres) that a view of a shape in it hardly tells apart.
#[derive(Clone, Debug)]
pub struct PseudoSymmetries {
    /// Turns about [`Self::axis`] by 10 degrees each, or a box's turns by right angles; without the identity.
    pub turns: Vec<Pose>,
    /// Of a body of revolution.
    pub axis: Option<Axis>,
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
    /// Of a surface.
    pub(super) fn of(surface: &Surface) -> Self {
        let Some(axis) = axis_of_revolution(surface) else {
            return Self { turns: right_angles(surface), axis: None };
        };
        let direction = Unit::new_normalize(axis.direction);
        let turn = |degrees: usize| Rotation3::from_axis_angle(&direction, (degrees as f64).to_radians());
        let turns = (STEP_DEG..360).step_by(STEP_DEG).map(|degrees| about(turn(degrees), &axis.point));
        Self { turns: turns.collect(), axis: Some(axis) }
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

/// The 23 turns by right angles about the middle of the surface's box.
fn right_angles(surface: &Surface) -> Vec<Pose> {
    let frame = face_directions(&surface.normals);
    let center = box_center(surface, &frame);
    let mut turns = Vec::new();
    for first in 0..3 {
        for second in (0..3).filter(|&second| second != first) {
            for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
                let x = Vector3::ith(first, signs[0]);
                let y = Vector3::ith(second, signs[1]);
                let turn = Matrix3::from_columns(&[x, y, x.cross(&y)]);
                turns.push(Rotation3::from_matrix_unchecked(frame * turn * frame.transpose()));
            }
        }
    }
    // All but the identity, whose trace is 3.
    turns.retain(|turn| turn.matrix().trace() < 2.5);
    turns.into_iter().map(|turn| about(turn, &center)).collect()
}

/// Three orthogonal directions, the columns: what most normals are near to, what most of the rest are near to, and across.
fn face_directions(normals: &[Vector3<f64>]) -> Matrix3<f64> {
    let step = normals.len().div_ceil(300).max(1);
    let some: Vec<&Vector3<f64>> = normals.iter().step_by(step).collect();
    let face = |candidates: &[Vector3<f64>]| -> Option<Vector3<f64>> {
        let near = |n: &Vector3<f64>, direction: &Vector3<f64>| n.dot(direction).abs() > FACE_COSINE;
        let votes = |direction: &Vector3<f64>| some.iter().filter(|n| near(n, direction)).count();
        let best = candidates.iter().max_by_key(|direction| votes(direction))?;
        let members = some.iter().filter(|n| near(n, best));
        let mean: Vector3<f64> = members.map(|n| **n * n.dot(best).signum()).sum();
        Some(mean.normalize())
    };
    let all: Vec<Vector3<f64>> = some.iter().map(|n| **n).collect();
    let first = face(&all).unwrap_or_else(Vector3::z);
    let across: Vec<Vector3<f64>> =
        all.iter().filter(|n| n.dot(&first).abs() < 0.4).map(|n| n - first * n.dot(&first)).collect();
    let across: Vec<Vector3<f64>> = across.iter().map(|n| n.normalize()).collect();
    let second = face(&across).unwrap_or_else(|| {
        // A single face: any direction along it.
        let helper = if first.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
        helper - first * helper.dot(&first)
    });
    let second = (second - first * second.dot(&first)).normalize();
    Matrix3::from_columns(&[first, second, first.cross(&second)])
}

/// Middle of the surface's extents along the columns of `frame`.
fn box_center(surface: &Surface, frame: &Matrix3<f64>) -> Vector3<f64> {
    let middles = Vector3::from_fn(|axis, _| {
        let mut along: Vec<f64> = surface.points.iter().map(|p| frame.column(axis).dot(&vector(p))).collect();
        along.sort_unstable_by(f64::total_cmp);
        let cut = (along.len() as f64 * TRIM) as usize;
        (along[cut] + along[along.len() - 1 - cut]) / 2.0
    });
    frame * middles
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
        let PseudoSymmetries { turns, axis } = PseudoSymmetries::of(&can);
        let axis = axis.unwrap();
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
    fn a_box_turns_by_right_angles_about_its_middle() {
        // Three faces of a box of 6 x 10 x 4 cm, turned towards the camera, its middle 0.6 m away.
        let turn = Rotation3::from_euler_angles(0.5, 0.6, 0.1);
        let middle = Vector3::new(0.02, -0.01, 0.6);
        let half = [0.03, 0.05, 0.02];
        let mut points: Vec<[f32; 3]> = Vec::new();
        for axis in 0..3 {
            for i in 0..3000 {
                let (u, v) = ((i % 60) as f64 / 30.0 - 1.0, (i / 60) as f64 / 25.0 - 1.0);
                let mut p = Vector3::zeros();
                // The faces whose outward normal looks at the camera, which is at -z.
                let normal = turn * Vector3::ith(axis, 1.0);
                p[axis] = if normal.z < 0.0 { half[axis] } else { -half[axis] };
                p[(axis + 1) % 3] = u * half[(axis + 1) % 3];
                p[(axis + 2) % 3] = v * half[(axis + 2) % 3];
                let p = turn * p + middle;
                points.push([p.x as f32, p.y as f32, p.z as f32]);
            }
        }
        let PseudoSymmetries { turns, axis } =
            PseudoSymmetries::of(&Surface::new(&points, 0.0015, "reference").unwrap());
        assert_eq!(axis, None);
        assert_eq!(turns.len(), 23);
        for axis in 0..3 {
            let half_turn = turn * Rotation3::from_scaled_axis(Vector3::ith(axis, std::f64::consts::PI));
            let flip = about(half_turn * turn.inverse(), &middle);
            let nearest = turns.iter().map(|t| t.rotation_angle_deg(&flip)).fold(f64::MAX, f64::min);
            assert!(nearest < 4.0, "axis {axis}: {nearest} degrees");
        }
        let shift = |t: &Pose| (t.rotation * middle + t.translation - middle).norm();
        assert!(turns.iter().all(|t| shift(t) < 0.005), "{:?}", turns.iter().map(shift).collect::<Vec<_>>());
    }
}
