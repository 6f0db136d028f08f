//! Colour of every pixel: several samples each, one look-up of lights and shadows per surface in the pixel.

use nalgebra::Vector3;

use super::{
    buffer::VisibilityBuffer,
    camera::Camera,
    lighting::LitScene,
    rays::Rays,
    room::RoomView,
    shading::Reflection,
    surfel::{SurfaceKey, Surfel},
};

/// Samples of one surface whose normals differ by less than this cosine share their light.
const SAME_SURFACE_COSINE: f32 = 0.985;

/// A surface in a pixel and its light.
struct ShadedSurface {
    key: SurfaceKey,
    normal: Vector3<f32>,
    reflection: Reflection,
}

/// Radiance averaged over `density`² samples per pixel. `surfels` are those of the pixel centres,
/// `gathered` is the ambient light there, if it was gathered.
pub(super) fn radiance(
    lit_scene: &LitScene,
    camera: &Camera,
    density: u32,
    surfels: &[(SurfaceKey, Surfel)],
    gathered: Option<&[[f32; 3]]>,
) -> Vec<[f32; 3]> {
    let buffer = VisibilityBuffer::new(&lit_scene.scene.objects, camera, density);
    let rays = Rays::new(camera, &buffer.intrinsics);
    let room = RoomView::new(&lit_scene.scene.room, camera);
    let mut lit: Vec<ShadedSurface> = Vec::new();
    let mut radiance = Vec::with_capacity(surfels.len());
    for row in 0..camera.height {
        let line = room.scanline(row);
        for col in 0..camera.width {
            let pixel = radiance.len();
            let arriving = gathered.map(|g| g[pixel]);
            lit.clear();
            let mut sum = [0f32; 3];
            for k in 0..density * density {
                let (x, y) = (col * density + k % density, row * density + k / density);
                let sample = &buffer.samples[(y * buffer.width + x) as usize];
                let direction = rays.direction(x, y);
                let (key, surfel) = lit_scene.seen(&rays.origin, &direction, sample, &line, col).1;
                let near =
                    |l: &&ShadedSurface| l.key == key && l.normal.dot(&surfel.normal) > SAME_SURFACE_COSINE;
                let reflection = match lit.iter().find(near) {
                    Some(known) => known.reflection,
                    None => {
                        // The light of a pixel's centre where it belongs to the same surface.
                        let center = Some(&surfels[pixel]).filter(|(center_key, center)| {
                            *center_key == key && center.normal.dot(&surfel.normal) > SAME_SURFACE_COSINE
                        });
                        let of = center.map_or(&surfel, |c| &c.1);
                        let to_camera = (rays.origin - of.point).normalize();
                        let turn = filter_turn(col, row, lit.len() as u32);
                        let reflection = lit_scene.reflection(of, &to_camera, turn, arriving);
                        lit.push(ShadedSurface { key, normal: of.normal, reflection });
                        reflection
                    }
                };
                let color = reflection.of(&surfel.albedo);
                // A clipped sample keeps its edge smooth; an unclipped highlight would turn the whole pixel white.
                (0..3).for_each(|k| sum[k] += color[k].min(4.0));
            }
            radiance.push(sum.map(|s| s / (density * density) as f32));
        }
    }
    radiance
}
/// Rotation (cos, sin) of the shadow filter, varying from pixel to pixel so that banding becomes grain.
fn filter_turn(col: u32, row: u32, surface: u32) -> [f32; 2] {
    let place =
        col.wrapping_mul(0x9E37_79B1) ^ row.wrapping_mul(0x85EB_CA77) ^ surface.wrapping_mul(0x27D4_EB2F);
    let hash = place.wrapping_mul(0xC2B2_AE3D);
    static TURNS: std::sync::OnceLock<[[f32; 2]; 64]> = std::sync::OnceLock::new();
    let turns = TURNS.get_or_init(|| {
        std::array::from_fn(|k| {
            let (s, c) = (k as f32 * std::f32::consts::TAU / 64.0).sin_cos();
            [c, s]
        })
    });
    turns[(hash >> 26) as usize]
}
