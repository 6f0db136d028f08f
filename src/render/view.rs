//! One view of a scene: visibility, then shading of every sample.

use nalgebra::{Matrix3, Vector3};

use super::{
    buffer::{Sample, VisibilityBuffer},
    indirect::Bounces,
    room::RoomPlace,
    scene::{Block, Finish, Light, Placed, Scene},
    shading::Shaded,
    shadow::ShadowMap,
    texture::{self, Wrap},
};
use crate::{
    frame::DepthMap,
    geometry::{Intrinsics, Pose},
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
    bounces: Option<Bounces>,
}

/// A surface point under a pixel or ray.
pub(super) struct Surfel {
    pub point: Vector3<f32>,
    pub normal: Vector3<f32>,
    pub albedo: [f32; 3],
    pub finish: Finish,
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
        let mut surfels = Vec::new();
        let mut out = Rendering {
            radiance: Vec::new(),
            depth: DepthMap::zeros(camera.width, camera.height),
            ids: vec![0; pixels.samples.len()],
            incidence: vec![0.0; pixels.samples.len()],
            albedo: vec![0.0; pixels.samples.len()],
            finish: vec![Finish { roughness: 1.0, metallic: 0.0 }; pixels.samples.len()],
        };
        let rays = Rays::new(camera, &pixels.intrinsics);
        for (i, sample) in pixels.samples.iter().enumerate() {
            let direction = rays.direction(i as u32 % pixels.width, i as u32 / pixels.width);
            let (z, room) = self.nearest(&rays.origin, &direction, sample);
            let surfel = self.surfel(&rays.origin, &direction, sample, &room);
            out.depth.data[i] = z;
            out.ids[i] = if room.is_none() { sample.object as u16 + 1 } else { 0 };
            out.incidence[i] = -surfel.normal.dot(&direction) / direction.norm();
            out.albedo[i] = luminance(&surfel.albedo);
            out.finish[i] = surfel.finish;
            if self.bounces.is_some() {
                surfels.push(surfel);
            }
        }
        let gathered = self.bounces.as_ref().map(|b| b.gather(self, &out, &surfels));
        out.radiance = self.radiance(camera, density, gathered.as_deref());
        out
    }

    fn radiance(&self, camera: &Camera, density: u32, gathered: Option<&[[f32; 3]]>) -> Vec<[f32; 3]> {
        let buffer = VisibilityBuffer::new(&self.scene.objects, camera, density);
        let rays = Rays::new(camera, &buffer.intrinsics);
        let (width, per_pixel) = (camera.width as usize, (density * density) as f32);
        let mut sums = vec![[0f32; 3]; width * camera.height as usize];
        for (i, sample) in buffer.samples.iter().enumerate() {
            let (col, row) = (i as u32 % buffer.width, i as u32 / buffer.width);
            let direction = rays.direction(col, row);
            let (_, room) = self.nearest(&rays.origin, &direction, sample);
            let surfel = self.surfel(&rays.origin, &direction, sample, &room);
            let pixel = (row / density) as usize * width + (col / density) as usize;
            let arriving = gathered.map(|g| g[pixel]);
            let color = self.shade(&surfel, &(-direction.normalize()), filter_turn(col, row), arriving);
            let sum = &mut sums[pixel];
            for k in 0..3 {
                // A clipped sample keeps its edge smooth; an unclipped highlight would turn the whole pixel white.
                sum[k] += color[k].min(4.0) / per_pixel;
            }
        }
        sums
    }

    /// Depth along the optical axis, and the place in the room unless an object is in front of it.
    fn nearest(
        &self,
        origin: &Vector3<f32>,
        direction: &Vector3<f32>,
        sample: &Sample,
    ) -> (f32, Option<RoomPlace>) {
        let room = self.scene.room.meet(origin, direction);
        if sample.inv_z * room.t > 1.0 { (1.0 / sample.inv_z, None) } else { (room.t, Some(room)) }
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
        let placed = &self.scene.objects[sample.object as usize];
        let mesh = &placed.mesh;
        let face = mesh.faces[sample.face as usize].map(|i| i as usize);
        let [b, c] = sample.weights;
        let weights = [1.0 - b - c, b, c];
        let mix =
            |k: usize, of: &dyn Fn(usize, usize) -> f32| (0..3).map(|j| weights[j] * of(face[j], k)).sum();
        let local: Vector3<f32> = Vector3::from_fn(|k, _| mix(k, &|v, k| mesh.normals[v][k]));
        let mut normal = (placed.t_world_object.rotation.cast::<f32>() * local).normalize();
        if normal.dot(direction) > 0.0 {
            normal = -normal;
        }
        let albedo = match &mesh.texture {
            Some(picture) if !mesh.uvs.is_empty() => {
                let uv = [mix(0, &|v, k| mesh.uvs[v][k]), mix(1, &|v, k| mesh.uvs[v][k])];
                texture::sample(picture, uv, Wrap::Repeat)
            }
            _ if !mesh.colors.is_empty() => texture::color_to_linear(mesh.colors[face[0]]),
            _ => [0.5; 3],
        };
        Surfel { point: origin + direction / sample.inv_z, normal, albedo, finish: placed.finish }
    }

    /// Light that a surface met by a gathering ray sends back: what the lights give it, and some of the ambient light.
    pub(super) fn bounced(&self, surfel: &Surfel, direction: &Vector3<f32>) -> Vector3<f32> {
        let ambient = self.surroundings(&surfel.normal).map(|c| 0.5 * c).into();
        let color = self.shade(surfel, &-direction, [1.0, 0.0], Some(ambient));
        // Fireflies would need more rays to average out.
        color.map(|c| c.min(2.0)).into()
    }

    /// Radiance of the far surroundings in a direction.
    pub(super) fn surroundings(&self, direction: &Vector3<f32>) -> Vector3<f32> {
        let up = 0.5 + 0.5 * direction.z;
        Vector3::from(self.scene.sky) * up + Vector3::from(self.scene.ground) * (1.0 - up)
    }

    /// Radiance towards `view`; `arriving` is the gathered ambient light where there is any.
    fn shade(
        &self,
        surfel: &Surfel,
        view: &Vector3<f32>,
        turn: [f32; 2],
        arriving: Option<[f32; 3]>,
    ) -> [f32; 3] {
        let shaded = Shaded { normal: &surfel.normal, view, albedo: surfel.albedo, finish: surfel.finish };
        let mut color = match arriving {
            Some(light) => shaded.ambient(&light, &light, 1.0),
            None => {
                let open = self.sky.visibility(&surfel.point, &surfel.normal, turn);
                shaded.ambient(&self.scene.sky, &self.scene.ground, 0.35 + 0.65 * open)
            }
        };
        for (light, shadow) in self.scene.lights.iter().zip(&self.shadows) {
            let to_light = light.position - surfel.point;
            let squared = to_light.norm_squared();
            let direction = to_light / squared.sqrt();
            let Some((diffuse, specular)) = shaded.reflect(&direction) else { continue };
            let visible = shadow.visibility(&surfel.point, &surfel.normal, turn);
            let falloff = (light.position - self.center).norm_squared() / squared * visible;
            for k in 0..3 {
                color[k] += light.color[k] * falloff * (diffuse[k] + specular[k]);
            }
        }
        color
    }
}

/// Viewing rays in the world; `origin + z * direction` lies at depth z.
struct Rays {
    origin: Vector3<f32>,
    rotation: Matrix3<f32>,
    intrinsics: Intrinsics,
}

impl Rays {
    fn new(camera: &Camera, intrinsics: &Intrinsics) -> Self {
        let t_world_camera = camera.t_camera_world.inverse();
        Self {
            origin: t_world_camera.translation.cast(),
            rotation: t_world_camera.rotation.cast(),
            intrinsics: *intrinsics,
        }
    }

    fn direction(&self, col: u32, row: u32) -> Vector3<f32> {
        let p = self.intrinsics.back_project(col.into(), row.into(), 1.0);
        self.rotation * p.coords.cast::<f32>()
    }
}

/// Rotation (cos, sin) of the shadow filter, varying from sample to sample so that banding becomes grain.
fn filter_turn(col: u32, row: u32) -> [f32; 2] {
    let hash = (col.wrapping_mul(0x9E37_79B1) ^ row.wrapping_mul(0x85EB_CA77)).wrapping_mul(0xC2B2_AE3D);
    static TURNS: std::sync::OnceLock<[[f32; 2]; 64]> = std::sync::OnceLock::new();
    let turns = TURNS.get_or_init(|| {
        std::array::from_fn(|k| {
            let (s, c) = (k as f32 * std::f32::consts::TAU / 64.0).sin_cos();
            [c, s]
        })
    });
    turns[(hash >> 26) as usize]
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
