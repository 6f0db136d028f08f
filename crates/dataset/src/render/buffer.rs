//! Nearest face per sample.

use unopose_core::geometry::Intrinsics;

use super::{
    camera::Camera,
    raster::{self, Window},
    scene::PosedMesh,
};

/// Face seen at a sample.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sample {
    /// 0 where no object is seen.
    pub inv_z: f32,
    pub object: u32,
    pub face: u32,
    pub weights: [f32; 2],
}

/// Row-major `[height, width]` samples of the objects alone, without room.
pub(super) struct VisibilityBuffer {
    pub width: u32,
    pub intrinsics: Intrinsics,
    pub samples: Vec<Sample>,
}

impl VisibilityBuffer {
    /// `density` samples per pixel in each direction, evenly spaced within the pixel.
    pub fn new(objects: &[PosedMesh], camera: &Camera, density: u32) -> Self {
        let d = f64::from(density);
        let intrinsics = Intrinsics {
            fx: camera.intrinsics.fx * d,
            fy: camera.intrinsics.fy * d,
            cx: (camera.intrinsics.cx + 0.5) * d - 0.5,
            cy: (camera.intrinsics.cy + 0.5) * d - 0.5,
        };
        let (width, height) = (camera.width * density, camera.height * density);
        let mut samples = vec![Sample::default(); width as usize * height as usize];
        let window = Window { min: [0, 0], max: [width as i32, height as i32] };
        for (object, placed) in objects.iter().enumerate() {
            let t_camera_object = camera.t_camera_world * placed.t_world_object;
            let projected = raster::project(&placed.mesh.vertices, &t_camera_object, &intrinsics);
            for (face, corners) in placed.mesh.faces.iter().enumerate() {
                raster::triangle(corners.map(|i| projected[i as usize]), &window, |f| {
                    let sample = &mut samples[f.row as usize * width as usize + f.col as usize];
                    if f.inv_z > sample.inv_z {
                        *sample = Sample {
                            inv_z: f.inv_z,
                            object: object as u32,
                            face: face as u32,
                            weights: f.weights(),
                        };
                    }
                });
            }
        }
        Self { width, intrinsics, samples }
    }
}
