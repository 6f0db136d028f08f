//! Posed meshes alone, lit evenly and from beside the camera: a reference view or template drawn from models.

use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use unopose_core::{
    frame::RgbdFrame,
    geometry::{Intrinsics, Pose},
};

use super::{
    Camera, Finish, InstanceView, Light, PosedMesh, Room, Scene, SceneRenderer, Surface, instance_views,
    linear_to_srgb,
};
use crate::mesh::TriangleMesh;

const MATT: Finish = Finish { roughness: 0.8, metallic: 0.0 };
/// Samples per pixel and direction.
const DENSITY: u32 = 2;
/// Part of the light that comes from everywhere, and from the lamp beside the camera.
const AMBIENT: f32 = 0.35;
const LAMP: f32 = 0.65;

/// A drawn view.
#[derive(Clone, Debug)]
pub struct PosedView {
    /// Depth is exact, and zero where no object is.
    pub frame: RgbdFrame,
    /// One per object; they hide each other.
    pub instances: Vec<InstanceView>,
}

/// Draws meshes with their poses `t_camera_object` into an image of `[width, height]` pixels.
pub fn posed_view(
    objects: &[(Arc<TriangleMesh>, Pose)],
    intrinsics: Intrinsics,
    [width, height]: [u32; 2],
) -> PosedView {
    // z up, the camera at the origin, level.
    let t_camera_world =
        Pose::new(Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0), Vector3::zeros());
    let t_world_camera = t_camera_world.inverse();
    let placed = objects.iter().map(|(mesh, t_camera_object)| PosedMesh {
        mesh: mesh.clone(),
        finish: MATT,
        t_world_object: t_world_camera * *t_camera_object,
    });
    let camera = Camera { t_camera_world, intrinsics, width, height };
    let lamp = Light { position: Vector3::new(0.3, -0.2, 0.5), radius: 0.2, color: [LAMP; 3] };
    let scene = Scene {
        objects: placed.collect(),
        room: empty_room(),
        lights: vec![lamp],
        sky: [AMBIENT; 3],
        ground: [AMBIENT; 3],
    };
    let rendering = SceneRenderer::new(&scene).render(&camera, DENSITY);
    let instances = instance_views(&scene.objects, &camera, &rendering.ids);
    let code = |c: f32| (linear_to_srgb(c.clamp(0.0, 1.0)) * 255.0).round() as u8;
    let rgb = image::RgbImage::from_fn(width, height, |col, row| {
        image::Rgb(rendering.radiance[row as usize * width as usize + col as usize].map(code))
    });
    let mut depth = rendering.depth;
    depth.data.iter_mut().zip(&rendering.ids).filter(|(_, id)| **id == 0).for_each(|(z, _)| *z = 0.0);
    PosedView { frame: RgbdFrame { rgb, depth, intrinsics }, instances }
}

/// Grey walls far from everything.
fn empty_room() -> Room {
    let picture = Arc::new(image::RgbImage::from_pixel(1, 1, image::Rgb([128; 3])));
    let surface = Surface { picture, tile: 1.0, angle: 0.0, finish: MATT };
    Room {
        blocks: Vec::new(),
        floor: surface.clone(),
        wall: surface,
        floor_drop: 20.0,
        half: 20.0,
        ceiling: 20.0,
    }
}
