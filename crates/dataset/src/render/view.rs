//! One view of a scene: visibility, then shading of every sample.

use nalgebra::{Matrix3, Vector3};
use unopose_core::{
    frame::DepthMap,
    geometry::{Intrinsics, Pose},
};

use super::{
    buffer::{Sample, VisibilityBuffer},
    indirect::Bounces,
    rays::Rays,
    room::{RoomLine, RoomPlace, RoomView},
    scene::{Block, Finish, Light, Placed, Scene},
    shading::{Reflection, Shaded},
    shadow::ShadowMap,
    texture::{self, Wrap},
};

/// A pinhole camera in the world.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    pub t_camera_world: Pose,
    pub intrinsics: Intrinsics,
    pub width: u32,
    pub height: u32,
}

/// A rendered view. All lists are row-major `[height, width]`.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Linear radiance, averaged over the samples of a pixel.
    pub radiance: Vec<[f32; 3]>,
    /// Exact depth at pixel centres, surroundings included.
    pub depth: DepthMap,
    /// 0 for the surroundings, index into the scene's objects + 1 otherwise.
    pub ids: Vec<u16>,
    /// Cosine between the surface normal and the direction to the camera.
    pub incidence: Vec<f32>,
    /// Luminance of the surface colour, linear.
    pub albedo: Vec<f32>,
    pub finish: Vec<Finish>,
}

/// A scene with what its views share.
pub struct SceneRenderer<'a> {
    scene: &'a Scene,
    shadows: Vec<ShadowMap>,
    /// Large light straight above: how open the sky is.
    sky: ShadowMap,
    center: Vector3<f32>,
    /// Of each object, object to world.
    rotations: Vec<Matrix3<f32>>,
    bounces: Option<Bounces>,
}

/// A surface point under a pixel or ray.
pub(super) struct Surfel {
    pub point: Vector3<f32>,
    pub normal: Vector3<f32>,
    pub albedo: [f32; 3],
    pub finish: Finish,
}

/// What a point belongs to: an object, or one flat side of the surroundings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SurfaceKey {
    Object(u32),
    Room(Option<usize>, usize),
}

impl<'a> SceneRenderer<'a> {
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
            bounces: None,
        }
    }

    /// Ambient light is gathered by this many rays per pixel instead of being taken from the sky's shadow map; 0: not.
    pub fn with_indirect_rays(self, rays: u32) -> Self {
        Self { bounces: (rays > 0).then(|| Bounces::new(self.scene, rays)), ..self }
    }

    pub(super) fn scene(&self) -> &Scene {
        self.scene
    }

    /// Renders with `density`² colour samples per pixel.
    pub fn render(&self, camera: &Camera, density: u32) -> Rendering {
        let pixels = VisibilityBuffer::new(&self.scene.objects, camera, 1);
        let mut surfels = Vec::with_capacity(pixels.samples.len());
        let mut out = Rendering {
            radiance: Vec::new(),
            depth: DepthMap::zeros(camera.width, camera.height),
            ids: vec![0; pixels.samples.len()],
            incidence: vec![0.0; pixels.samples.len()],
            albedo: vec![0.0; pixels.samples.len()],
            finish: vec![Finish { roughness: 1.0, metallic: 0.0 }; pixels.samples.len()],
        };
        let rays = Rays::new(camera, &pixels.intrinsics);
        let room = RoomView::new(&self.scene.room, camera);
        for row in 0..camera.height {
            let line = room.line(row);
            for col in 0..camera.width {
                let i = surfels.len();
                let direction = rays.direction(col, row);
                let (z, (key, surfel)) = self.seen(&rays.origin, &direction, &pixels.samples[i], &line, col);
                out.depth.data[i] = z;
                if let SurfaceKey::Object(object) = key {
                    out.ids[i] = object as u16 + 1;
                }
                out.incidence[i] = -surfel.normal.dot(&direction) / direction.norm();
                out.albedo[i] = luminance(&surfel.albedo);
                out.finish[i] = surfel.finish;
                surfels.push((key, surfel));
            }
        }
        let gathered = self.bounces.as_ref().map(|b| b.gather(self, &out, &surfels));
        out.radiance = self.radiance(camera, density, &surfels, gathered.as_deref());
        out
    }

    /// Depth along the optical axis and what is there, through pixel column `col` of the row that `line` stands for.
    pub(super) fn seen(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
        sample: &Sample,
        line: &RoomLine,
        col: u32,
    ) -> (f32, (SurfaceKey, Surfel)) {
        let z = if sample.inv_z > 0.0 { 1.0 / sample.inv_z } else { f32::INFINITY };
        let room = line.meet(col, direction, z);
        let surfel = self.surfel(origin, direction, sample, &room);
        match room {
            Some(place) => {
                let (block, axis) = place.side();
                (place.t, (SurfaceKey::Room(block, axis), surfel))
            }
            None => (z, (SurfaceKey::Object(sample.object), surfel)),
        }
    }

    pub(super) fn surfel(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
        sample: &Sample,
        room: &Option<RoomPlace>,
    ) -> Surfel {
        if let Some(place) = room {
            let hit = self.scene.room.surface_at(origin, direction, place);
            let point = origin + direction * place.t;
            return Surfel { point, normal: hit.normal, albedo: hit.albedo, finish: hit.finish };
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
                texture::sample(picture, uv, Wrap::Repeat)
            }
            _ if !mesh.colors.is_empty() => texture::color_to_linear(mesh.colors[i]),
            _ => [0.5; 3],
        };
        Surfel { point: origin + direction / sample.inv_z, normal, albedo, finish: placed.finish }
    }

    /// Light that a surface met by a gathering ray sends back: what the lights give it, and some of the ambient light.
    pub(super) fn bounced(&self, surfel: &Surfel, direction: &Vector3<f32>) -> Vector3<f32> {
        let ambient = 0.5 * self.surroundings(&surfel.normal);
        let color = self.reflection(surfel, &-direction, [1.0, 0.0], Some(ambient.into())).of(&surfel.albedo);
        // Fireflies would need more rays to average out.
        color.map(|c| c.min(2.0)).into()
    }

    /// Radiance of the far surroundings in a direction.
    pub(super) fn surroundings(&self, direction: &Vector3<f32>) -> Vector3<f32> {
        let up = 0.5 + 0.5 * direction.z;
        Vector3::from(self.scene.sky) * up + Vector3::from(self.scene.ground) * (1.0 - up)
    }

    /// Light that goes towards `view`; `arriving` is the gathered ambient light where there is any.
    pub(super) fn reflection(
        &self,
        surfel: &Surfel,
        view: &Vector3<f32>,
        turn: [f32; 2],
        arriving: Option<[f32; 3]>,
    ) -> Reflection {
        let shaded = Shaded { normal: &surfel.normal, view, finish: surfel.finish };
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

pub(super) fn luminance(c: &[f32; 3]) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

fn bounding_sphere(objects: &[Placed]) -> (Vector3<f32>, f32) {
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
