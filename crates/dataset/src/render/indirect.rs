//! Light that arrives by way of other surfaces: one bounce, gathered by rays over the hemisphere.
//!
//! A quality option: contact shadows of ambient light, colour bleeding and dark insides of cups come out as in a path
//! tracer with two segments. Rays are cast through parry's bounding volume hierarchies.

use nalgebra::{Matrix3, Point3, Vector3};
use parry3d::{
    query::{Ray, RayCast},
    shape::{FeatureId, TriMesh},
};

use super::{
    buffer::Sample,
    lighting::LitScene,
    scene::{PosedMesh, Scene},
    surfel::{SurfaceKey, Surfel},
};

/// An object ready for rays.
struct RayTarget {
    shape: TriMesh,
    rotation: Matrix3<f32>,
    translation: Vector3<f32>,
    center: Vector3<f32>,
    radius: f32,
}

impl RayTarget {
    /// `None` for a mesh that no hierarchy can be built over.
    fn new(placed: &PosedMesh) -> Option<Self> {
        let (mesh, t) = (&placed.mesh, &placed.t_world_object);
        let bounds = mesh.bounds();
        let vertices = mesh.vertices.iter().map(|v| Point3::from(*v)).collect();
        Some(Self {
            shape: TriMesh::new(vertices, mesh.faces.clone()).ok()?,
            rotation: t.rotation.cast(),
            translation: t.translation.cast(),
            center: t.transform_f32(&bounds.center()).into(),
            radius: 0.5 * Vector3::from(bounds.size()).norm(),
        })
    }

    /// Distance, face and the weights of its second and third corner.
    fn cast(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
        limit: f32,
    ) -> Option<(f32, u32, [f32; 2])> {
        let to = self.center - origin;
        let along = to.dot(direction);
        if to.norm_squared() - along * along > self.radius * self.radius || along < -self.radius {
            return None;
        }
        let local = self.rotation.tr_mul(&(origin - self.translation));
        let ray = Ray::new(local.into(), self.rotation.tr_mul(direction));
        let hit = self.shape.cast_local_ray_and_get_normal(&ray, limit, false)?;
        let FeatureId::Face(face) = hit.feature else { return None };
        // The back sides are counted on.
        let face = face % self.shape.indices().len() as u32;
        let [a, b, c] = self.shape.indices()[face as usize].map(|i| self.shape.vertices()[i as usize]);
        let (ab, ac, ap) = (b - a, c - a, ray.point_at(hit.time_of_impact) - a);
        let (d00, d01, d11, d20, d21) = (ab.dot(&ab), ab.dot(&ac), ac.dot(&ac), ap.dot(&ab), ap.dot(&ac));
        let determinant = (d00 * d11 - d01 * d01).max(1e-20);
        let weights = [(d11 * d20 - d01 * d21) / determinant, (d00 * d21 - d01 * d20) / determinant];
        Some((hit.time_of_impact, face, weights))
    }
}

/// The objects of a scene under rays.
pub(super) struct IndirectLight {
    targets: Vec<Option<RayTarget>>,
    rays: u32,
}

/// Rays start this far above their surface, metres.
const RAY_OFFSET: f32 = 5e-4;
/// Half side of the window over which neighbouring pixels share their rays.
const FILTER_RADIUS: i32 = 2;

impl IndirectLight {
    pub fn new(scene: &Scene, rays: u32) -> Self {
        Self { targets: scene.objects.iter().map(RayTarget::new).collect(), rays }
    }

    /// Mean radiance that reaches every pixel's surface from its hemisphere, cosine-weighted. `ids` and `surfels` are
    /// row-major with `width` columns.
    pub fn gather(
        &self,
        lit_scene: &LitScene,
        ids: &[u16],
        width: u32,
        surfels: &[(SurfaceKey, Surfel)],
    ) -> Vec<[f32; 3]> {
        let width = width as usize;
        let height = ids.len() / width.max(1);
        let raw: Vec<Vector3<f32>> =
            surfels.iter().enumerate().map(|(i, s)| self.hemisphere(lit_scene, &s.1, i)).collect();
        let smooth = |i: usize| {
            let (col, row) = ((i % width) as i32, (i / width) as i32);
            let (mut sum, mut weight) = (Vector3::zeros(), 0.0);
            for r in row - FILTER_RADIUS..=row + FILTER_RADIUS {
                for c in col - FILTER_RADIUS..=col + FILTER_RADIUS {
                    if r < 0 || c < 0 || c >= width as i32 || r >= height as i32 {
                        continue;
                    }
                    let k = r as usize * width + c as usize;
                    let alike = ids[k] == ids[i]
                        && surfels[k].1.normal.dot(&surfels[i].1.normal) > 0.9
                        && (surfels[k].1.point - surfels[i].1.point).norm() < 0.05;
                    if alike {
                        sum += raw[k];
                        weight += 1.0;
                    }
                }
            }
            (sum / f32::max(weight, 1.0)).into()
        };
        (0..raw.len()).map(smooth).collect()
    }

    fn hemisphere(&self, lit_scene: &LitScene, surfel: &Surfel, pixel: usize) -> Vector3<f32> {
        let normal = surfel.normal;
        let helper = if normal.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
        let tangent = normal.cross(&helper).normalize();
        let side = normal.cross(&tangent);
        let origin = surfel.point + normal * RAY_OFFSET;
        // A rank-one lattice (R2, Roberts 2018), shifted from pixel to pixel.
        let turn = |k: usize, a: f32| (k as f32 * a).fract();
        let (shift_u, shift_v) = (turn(pixel % 8192, 0.754_877_7), turn(pixel % 8192, 0.569_840_3));
        let ray = |k: u32| {
            let u = (shift_u + (k as f32 + 0.5) / self.rays as f32).fract();
            let angle = std::f32::consts::TAU * (shift_v + k as f32 * 0.618_034).fract();
            let (r, (s, c)) = (u.sqrt(), angle.sin_cos());
            let direction = tangent * (r * c) + side * (r * s) + normal * (1.0 - u).sqrt();
            self.incoming(lit_scene, &origin, &direction)
        };
        (0..self.rays).map(ray).sum::<Vector3<f32>>() / self.rays as f32
    }

    fn incoming(
        &self,
        lit_scene: &LitScene,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
    ) -> Vector3<f32> {
        let room = lit_scene.scene.room.meet(origin, direction);
        let mut nearest = (room.t, None);
        for (i, target) in self.targets.iter().enumerate() {
            let Some(target) = target else { continue };
            if let Some((t, face, weights)) = target.cast(origin, direction, nearest.0) {
                nearest = (t, Some(Sample { inv_z: 1.0 / t.max(1e-6), object: i as u32, face, weights }));
            }
        }
        match nearest.1 {
            Some(sample) => {
                lit_scene.outgoing_radiance(&lit_scene.surfel(origin, direction, &sample, &None), direction)
            }
            // Walls far away are part of the surroundings' light.
            None if room.is_wall() => lit_scene.environment_radiance(direction),
            None => {
                let surfel = lit_scene.surfel(origin, direction, &Sample::default(), &Some(room));
                lit_scene.outgoing_radiance(&surfel, direction)
            }
        }
    }
}
