//! Dropping objects on tables, into bins and on shelves with rigid-body physics.

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rapier3d::{parry::query::contact, prelude::*};
use unopose_core::geometry::Pose;

use super::{object::SynthObject, place::Place, random::Draw};

/// Time step, seconds.
const STEP: f32 = 1.0 / 120.0;
/// Longest simulated time, seconds.
const LONGEST: f32 = 2.5;
/// Objects are never deeper in each other, metres.
const OVERLAP: f32 = 0.0015;

/// Drops the objects; `None` for one that left its place or whose simulation failed.
///
/// With `tumbling` the simulation stops shortly after the first contacts, so that objects stand on edges and corners.
pub(super) fn drop_objects(
    objects: &[&SynthObject],
    place: &Place,
    tumbling: bool,
    rng: &mut ChaCha8Rng,
) -> Vec<Option<Pose>> {
    let mut bodies = RigidBodySet::new();
    let mut colliders = ColliderSet::new();
    // A box, not a half-space: parry finds the deepest point of a hull against a box, but only the face that looks down
    // most against a half-space. Its top is half a millimetre above the visible table, as contacts give way a little.
    let ground =
        ColliderBuilder::cuboid(2.0, 2.0, 0.2).translation(Vector3::z() * (5e-4 - 0.2)).friction(0.9);
    colliders.insert(ground);
    for (center, [x, y, z]) in place.walls() {
        colliders.insert(ColliderBuilder::cuboid(x, y, z).translation(center).friction(0.5));
    }
    let size = |o: &SynthObject| Vector3::from(o.mesh.bounds().size()).norm();
    let mean_size = objects.iter().map(|o| size(o)).sum::<f32>() / objects.len().max(1) as f32;
    let spread = mean_size * rng.between(0.25, 0.6) * (objects.len() as f32).sqrt();
    let friction = rng.between(0.4, 0.9);
    let mut taken: Vec<(Vector3<f32>, f32)> = Vec::new();
    let handles: Vec<Option<RigidBodyHandle>> = objects
        .iter()
        .map(|object| {
            let radius = 0.5 * size(object);
            let start = lowest_free_place(&taken, radius, spread, place.area(), rng);
            taken.push((start, radius));
            let turn = rng.unit_vector() * rng.between(0.0, std::f32::consts::PI);
            let collider = collider(object)?;
            let body = RigidBodyBuilder::dynamic()
                .pose(Isometry3::new(start, turn))
                .angvel(rng.unit_vector() * rng.between(0.0, 3.0))
                .linear_damping(0.3)
                .angular_damping(1.5);
            let handle = bodies.insert(body);
            let collider = collider.density(400.0).friction(friction).restitution(0.05);
            colliders.insert_with_parent(collider, handle, &mut bodies);
            Some(handle)
        })
        .collect();
    let top = taken.iter().map(|t| t.0.z).fold(0.0, f32::max);
    // The time of a free fall from the top, and a little more.
    let end = if tumbling { (top / 4.9).sqrt() + rng.between(0.0, 0.35) } else { LONGEST };
    simulate(&mut bodies, &mut colliders, end.min(LONGEST));
    let pose = |(object, handle): (&&SynthObject, &Option<RigidBodyHandle>)| {
        let isometry = bodies.get((*handle)?)?.position();
        let mut pose = to_pose(isometry, spread + 3.0 * mean_size)?;
        let left = |[a, b]: [f32; 2]| {
            let t = isometry.translation.vector;
            t.x.abs() > a || t.y.abs() > b
        };
        if place.area().is_some_and(left) {
            return None;
        }
        // What the solver left inside the table, a few millimetres at most in a heap.
        let bottom = pose.translation.z + lowest(object, &pose.rotation);
        pose.translation.z -= bottom.min(0.0);
        Some(pose)
    };
    let mut poses: Vec<Option<Pose>> = objects.iter().zip(&handles).map(pose).collect();
    let shape = |handle: &Option<RigidBodyHandle>| {
        let collider = *bodies.get((*handle)?)?.colliders().first()?;
        Some(colliders.get(collider)?.shared_shape().clone())
    };
    let shapes: Vec<Option<SharedShape>> = handles.iter().map(shape).collect();
    take_out_overlapping(&mut poses, &shapes);
    poses
}

/// Takes away the upper one of two objects that the solver left in each other by more than [`OVERLAP`].
fn take_out_overlapping(poses: &mut [Option<Pose>], shapes: &[Option<SharedShape>]) {
    let isometry = |pose: &Pose| {
        let rotation = UnitQuaternion::from_matrix(&pose.rotation.cast::<f32>());
        Isometry3::from_parts(pose.translation.cast::<f32>().into(), rotation)
    };
    for i in 0..poses.len() {
        for j in 0..i {
            let (Some(a), Some(b)) = (&poses[i], &poses[j]) else { continue };
            let (Some(shape_a), Some(shape_b)) = (&shapes[i], &shapes[j]) else { continue };
            let met = contact(&isometry(a), &**shape_a, &isometry(b), &**shape_b, 0.0);
            if met.is_ok_and(|c| c.is_some_and(|c| c.dist < -OVERLAP)) {
                let upper = if a.translation.z > b.translation.z { i } else { j };
                poses[upper] = None;
            }
        }
    }
}

/// The hull, or the convex parts.
fn collider(object: &SynthObject) -> Option<ColliderBuilder> {
    if object.parts.is_empty() {
        return ColliderBuilder::convex_hull(&object.hull);
    }
    let shapes = object.parts.iter().filter_map(|part| SharedShape::convex_hull(part));
    let shapes: Vec<_> = shapes.map(|shape| (Isometry3::identity(), shape)).collect();
    (!shapes.is_empty()).then(|| ColliderBuilder::compound(shapes))
}

/// The lowest of several random places within `spread` of the centre where a sphere touches no other.
fn lowest_free_place(
    taken: &[(Vector3<f32>, f32)],
    radius: f32,
    spread: f32,
    area: Option<[f32; 2]>,
    rng: &mut ChaCha8Rng,
) -> Vector3<f32> {
    let mut lowest = Vector3::new(0.0, 0.0, f32::MAX);
    for _ in 0..6 {
        let angle = rng.between(0.0, std::f32::consts::TAU);
        let distance = spread * rng.between(0.0, 1.0).sqrt();
        let (x, y) = match area {
            None => (distance * angle.cos(), distance * angle.sin()),
            Some(half) => {
                let [a, b] = half.map(|h| (h - radius).max(0.0));
                (rng.between(-a, a), rng.between(-b, b))
            }
        };
        let above = |(other, r): &(Vector3<f32>, f32)| {
            let (reach, flat) = (r + radius, (other.x - x).hypot(other.y - y));
            other.z + (reach * reach - flat * flat).max(0.0).sqrt()
        };
        let under = taken.iter().filter(|t| (t.0.x - x).hypot(t.0.y - y) < t.1 + radius);
        let z = under.map(above).fold(radius, f32::max) + 0.002;
        if z < lowest.z {
            lowest = Vector3::new(x, y, z);
        }
    }
    lowest
}

fn simulate(bodies: &mut RigidBodySet, colliders: &mut ColliderSet, duration: f32) {
    let mut parameters = IntegrationParameters { dt: STEP, length_unit: 0.1, ..Default::default() };
    parameters.num_solver_iterations = 6.try_into().unwrap_or(parameters.num_solver_iterations);
    let mut pipeline = PhysicsPipeline::new();
    let mut islands = IslandManager::new();
    let mut broad_phase = DefaultBroadPhase::new();
    let mut narrow_phase = NarrowPhase::new();
    let (mut joints, mut multibody) = (ImpulseJointSet::new(), MultibodyJointSet::new());
    let mut ccd = CCDSolver::new();
    let mut time = 0.0;
    while time < duration {
        pipeline.step(
            &Vector3::new(0.0, 0.0, -9.81),
            &parameters,
            &mut islands,
            &mut broad_phase,
            &mut narrow_phase,
            bodies,
            colliders,
            &mut joints,
            &mut multibody,
            &mut ccd,
            &(),
            &(),
        );
        time += STEP;
        let still = |b: &RigidBody| b.linvel().norm() < 0.01 && b.angvel().norm() < 0.1;
        if time > 0.4 && bodies.iter().all(|(_, b)| b.is_sleeping() || still(b)) {
            break;
        }
    }
}

fn to_pose(isometry: &Isometry3<f32>, reach: f32) -> Option<Pose> {
    let t = isometry.translation.vector;
    let inside = t.iter().all(|x| x.is_finite()) && t.xy().norm() < reach && t.z > -0.01 && t.z < 1.5;
    let rotation: UnitQuaternion<f64> = isometry.rotation.cast();
    // Normalised again in double precision: a written rotation is orthogonal to the last digits.
    let rotation = UnitQuaternion::new_normalize(rotation.into_inner());
    inside.then(|| Pose::new(*rotation.to_rotation_matrix().matrix(), t.cast()))
}

/// Smallest z of the rotated object.
fn lowest(object: &SynthObject, rotation: &Matrix3<f64>) -> f64 {
    object.hull.iter().map(|p| (rotation * p.coords.cast::<f64>()).z).fold(f64::MAX, f64::min)
}

/// Objects side by side in any orientation, touching the table: what is left when physics fails.
pub(super) fn lay_out(objects: &[&SynthObject], rng: &mut ChaCha8Rng) -> Vec<Option<Pose>> {
    let columns = (objects.len() as f32).sqrt().ceil() as usize;
    let cell = objects.iter().map(|o| Vector3::from(o.mesh.bounds().size()).norm()).fold(0.05, f32::max);
    let place = |(i, object): (usize, &&SynthObject)| {
        let turn = rng.unit_vector() * rng.between(0.0, std::f32::consts::PI);
        let rotation = UnitQuaternion::from_scaled_axis(turn.cast::<f64>()).to_rotation_matrix();
        let at = |k: usize| (k as f32 - 0.5 * (columns - 1) as f32) * cell;
        let (x, y) = (at(i % columns), at(i / columns));
        let z = -lowest(object, rotation.matrix());
        Some(Pose::new(*rotation.matrix(), Vector3::new(x.into(), y.into(), z)))
    };
    objects.iter().enumerate().map(place).collect()
}
