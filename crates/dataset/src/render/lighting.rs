//! Light at the surface points of a scene: what reflects to the camera, from the lights and from all around.

use nalgebra::{Matrix3, Vector3};

use super::{
    buffer::Sample,
    room::{RoomHit, RoomScanline},
    scene::{Block, Light, PosedMesh, Scene},
    shading::{Reflection, ShadingPoint},
    shadow::ShadowMap,
    surfel::{SurfaceKey, Surfel},
    texture,
};

/// A scene with its shadow maps.
pub(super) struct LitScene<'a> {
    pub scene: &'a Scene,
    shadows: Vec<ShadowMap>,
    /// Large light straight above: how open the sky is.
    sky: ShadowMap,
    center: Vector3<f32>,
    /// Of each object, object to world.
    rotations: Vec<Matrix3<f32>>,
}

impl<'a> LitScene<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        let (center, radius) = bounding_sphere(&scene.objects);
        let boards: Vec<[Vector3<f32>; 8]> =
            scene.room.blocks.iter().filter(|b| b.casts_shadow).map(Block::corners).collect();
        let far = boards.iter().flatten().map(|c| (c - center).norm()).fold(radius, f32::max);
        let map = |light: &Light| ShadowMap::new(light, &scene.objects, &boards, &center, far);
        let above = Light { position: center + Vector3::z() * 2.0, radius: 0.9, color: [1.0; 3] };
        Self {
            scene,
            shadows: scene.lights.iter().map(map).collect(),
            sky: map(&above),
            center,
            rotations: scene.objects.iter().map(|o| o.t_world_object.rotation.cast()).collect(),
        }
    }

    /// Depth along the optical axis and what is there, through pixel column `col` of the row that `line` stands for.
    pub fn seen(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
        sample: &Sample,
        line: &RoomScanline,
        col: u32,
    ) -> (f32, (SurfaceKey, Surfel)) {
        let z = if sample.inv_z > 0.0 { 1.0 / sample.inv_z } else { f32::INFINITY };
        let room = line.meet(col, direction, z);
        let surfel = self.surfel(origin, direction, sample, &room);
        match room {
            Some(hit) => {
                let (block, axis) = hit.side();
                (hit.t, (SurfaceKey::Room(block, axis), surfel))
            }
            None => (z, (SurfaceKey::Object(sample.object), surfel)),
        }
    }

    pub fn surfel(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
        sample: &Sample,
        room: &Option<RoomHit>,
    ) -> Surfel {
        if let Some(hit) = room {
            let surface = self.scene.room.surface_at(origin, direction, hit);
            let point = origin + direction * hit.t;
            return Surfel { point, normal: surface.normal, albedo: surface.albedo, finish: surface.finish };
        }
        let object = sample.object as usize;
        let placed = &self.scene.objects[object];
        let mesh = &placed.mesh;
        let [i, j, k] = mesh.faces[sample.face as usize].map(|i| i as usize);
        let [b, c] = sample.weights;
        let a = 1.0 - b - c;
        let [p, q, r] = [i, j, k].map(|v| Vector3::from(mesh.normals[v]));
        let mut normal = (self.rotations[object] * (p * a + q * b + r * c)).normalize();
        if normal.dot(direction) > 0.0 {
            normal = -normal;
        }
        let albedo = match &mesh.texture {
            Some(picture) if !mesh.uvs.is_empty() => {
                let [p, q, r] = [i, j, k].map(|v| mesh.uvs[v]);
                let uv = std::array::from_fn(|axis| a * p[axis] + b * q[axis] + c * r[axis]);
                texture::sample(picture, uv)
            }
            _ if !mesh.colors.is_empty() => texture::color_to_linear(mesh.colors[i]),
            _ => [0.5; 3],
        };
        Surfel { point: origin + direction / sample.inv_z, normal, albedo, finish: placed.finish }
    }

    /// Light that a surface met by a gathering ray sends back: what the lights give it, and some of the ambient light.
    pub fn outgoing_radiance(&self, surfel: &Surfel, direction: &Vector3<f32>) -> Vector3<f32> {
        let ambient = 0.5 * self.environment_radiance(&surfel.normal);
        let color = self.reflection(surfel, &-direction, [1.0, 0.0], Some(ambient.into())).of(&surfel.albedo);
        // Fireflies would need more rays to average out.
        color.map(|c| c.min(2.0)).into()
    }

    /// Radiance of the far surroundings in a direction.
    pub fn environment_radiance(&self, direction: &Vector3<f32>) -> Vector3<f32> {
        let up = 0.5 + 0.5 * direction.z;
        Vector3::from(self.scene.sky) * up + Vector3::from(self.scene.ground) * (1.0 - up)
    }

    /// Light that goes towards `view`; `arriving` is the gathered ambient light where there is any.
    pub fn reflection(
        &self,
        surfel: &Surfel,
        view: &Vector3<f32>,
        turn: [f32; 2],
        arriving: Option<[f32; 3]>,
    ) -> Reflection {
        let shaded = ShadingPoint { normal: &surfel.normal, view, finish: surfel.finish };
        let mut reflection = match arriving.map(Vector3::from) {
            Some(light) => shaded.ambient(&light, &light, 1.0),
            None => {
                let open = self.sky.visibility(&surfel.point, &surfel.normal, turn);
                let (sky, ground) = (self.scene.sky.into(), self.scene.ground.into());
                shaded.ambient(&sky, &ground, 0.35 + 0.65 * open)
            }
        };
        for (light, shadow) in self.scene.lights.iter().zip(&self.shadows) {
            let to_light = light.position - surfel.point;
            let squared = to_light.norm_squared();
            let Some(reflected) = shaded.reflect(&(to_light / squared.sqrt())) else { continue };
            let visible = shadow.visibility(&surfel.point, &surfel.normal, turn);
            if visible > 0.0 {
                let falloff = (light.position - self.center).norm_squared() / squared * visible;
                reflection.add(&(Vector3::from(light.color) * falloff), reflected);
            }
        }
        reflection
    }
}

fn bounding_sphere(objects: &[PosedMesh]) -> (Vector3<f32>, f32) {
    let spheres: Vec<(Vector3<f32>, f32)> = objects
        .iter()
        .map(|o| {
            let bounds = o.mesh.bounds();
            let center = Vector3::from(o.t_world_object.transform_f32(&bounds.center()));
            (center, 0.5 * Vector3::from(bounds.size()).norm())
        })
        .collect();
    let count = spheres.len().max(1) as f32;
    let center = spheres.iter().map(|s| s.0).sum::<Vector3<f32>>() / count;
    (center, spheres.iter().map(|s| (s.0 - center).norm() + s.1).fold(0.05, f32::max))
}
