//! One view of a scene: visibility, then shading of every sample.

use unopose_core::frame::DepthMap;

use super::{
    buffer::VisibilityBuffer,
    camera::Camera,
    color::radiance,
    indirect::IndirectLight,
    lighting::LitScene,
    rays::Rays,
    room::RoomView,
    scene::{Finish, Scene},
    surfel::SurfaceKey,
};

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
    /// Reflection properties of the surface.
    pub finish: Vec<Finish>,
}

/// A scene with what its views share.
pub struct SceneRenderer<'a> {
    lit_scene: LitScene<'a>,
    indirect: Option<IndirectLight>,
}

impl<'a> SceneRenderer<'a> {
    /// Makes the shadow maps of all lights.
    pub fn new(scene: &'a Scene) -> Self {
        Self { lit_scene: LitScene::new(scene), indirect: None }
    }

    /// Ambient light is gathered by this many rays per pixel instead of being taken from the sky's shadow map; 0: not.
    pub fn with_indirect_rays(self, rays: u32) -> Self {
        Self { indirect: (rays > 0).then(|| IndirectLight::new(self.lit_scene.scene, rays)), ..self }
    }

    /// Renders with `density`² colour samples per pixel.
    pub fn render(&self, camera: &Camera, density: u32) -> Rendering {
        let scene = self.lit_scene.scene;
        let pixels = VisibilityBuffer::new(&scene.objects, camera, 1);
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
        let room = RoomView::new(&scene.room, camera);
        for row in 0..camera.height {
            let line = room.scanline(row);
            for col in 0..camera.width {
                let i = surfels.len();
                let direction = rays.direction(col, row);
                let (z, (key, surfel)) =
                    self.lit_scene.seen(&rays.origin, &direction, &pixels.samples[i], &line, col);
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
        let gathered = self
            .indirect
            .as_ref()
            .map(|light| light.gather(&self.lit_scene, &out.ids, camera.width, &surfels));
        out.radiance = radiance(&self.lit_scene, camera, density, &surfels, gathered.as_deref());
        out
    }
}

fn luminance(c: &[f32; 3]) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}
