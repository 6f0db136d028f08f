//! A dataset in memory: views of two coloured ellipsoids, intersected analytically.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::{Intrinsics, Pose},
};
use unopose_dataset::formats::{
    AnnotatedFrame, FormatError, Instance, ObjectSymmetries, megapose::InstanceRef,
};
use unopose_pairs::data::FrameSource;

/// Half axes of objects 1 and 2, metres.
pub const HALF_AXES: [[f64; 3]; 2] = [[0.10, 0.07, 0.05], [0.06, 0.09, 0.04]];

/// `images` views of 320 x 240 pixels with one instance of both objects each.
pub struct EllipsoidViews {
    pub frames: Vec<AnnotatedFrame>,
    pub instances: Vec<InstanceRef>,
    references: [Vec<usize>; 2],
    pub symmetries: ObjectSymmetries,
    /// Images that cannot be read.
    pub broken: Vec<u32>,
}

// Each test crate uses its share of these.
#[allow(dead_code)]
impl EllipsoidViews {
    pub fn new(images: u32, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let frames: Vec<AnnotatedFrame> = (0..images).map(|_| view(&mut rng)).collect();
        let mut instances = Vec::new();
        for (image, frame) in (0..).zip(&frames) {
            for (number, instance) in (0..).zip(&frame.instances) {
                instances.push(InstanceRef {
                    image,
                    instance: number,
                    obj_id: instance.obj_id,
                    visib_fract: instance.visib_fract as f32,
                    px_count_visib: instance.px_count_visib,
                });
            }
        }
        let of = |id: u32| (0..instances.len()).filter(|&i| instances[i].obj_id == id).collect();
        let references = [of(1), of(2)];
        Self { frames, instances, references, symmetries: ObjectSymmetries::default(), broken: vec![] }
    }

    pub fn pose(&self, image: u32, instance: u32) -> Pose {
        self.frames[image as usize].instances[instance as usize].t_camera_object
    }
}

impl FrameSource for EllipsoidViews {
    fn instances(&self) -> &[InstanceRef] {
        &self.instances
    }

    fn references(&self, obj_id: u32) -> &[usize] {
        &self.references[obj_id as usize - 1]
    }

    fn load(&self, image: u32) -> Result<AnnotatedFrame, FormatError> {
        if self.broken.contains(&image) {
            return Err(FormatError::missing(format!("image {image}"), "rgb", ""));
        }
        Ok(self.frames[image as usize].clone())
    }

    fn symmetries(&self, _obj_id: u32) -> &ObjectSymmetries {
        &self.symmetries
    }
}

/// Pose of the [`spheroid`] that is turned by `degrees`, its own frame to the camera's.
pub fn spheroid_pose(degrees: f64) -> Pose {
    // Its z axis upright, after a turn about it.
    let upright = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), degrees.to_radians());
    Pose::new(*(upright * turn).to_rotation_matrix().matrix(), Vector3::new(0.0, 0.0, 0.6))
}

/// A view of a spheroid (half axes 5, 5 and 9 cm) that stands upright 0.6 m away and is turned about its axis by `degrees`; only
/// its print, which repeats nowhere, tells by how much.
pub fn spheroid(degrees: f64, printed: bool) -> (RgbdFrame, Mask) {
    let intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 79.5, cy: 79.5 };
    let (width, height) = (160, 160);
    let depth = DepthMap { width, height, data: vec![0.9; (width * height) as usize] };
    let mut frame = RgbdFrame { rgb: image::RgbImage::new(width, height), depth, intrinsics };
    let mut mask = Mask::empty(width, height);
    let pose = spheroid_pose(degrees);
    for row in 0..height {
        for col in 0..width {
            let ray = intrinsics.back_project(col.into(), row.into(), 1.0).coords;
            let Some((depth, point)) = hit(&ray, &pose, &[0.05, 0.05, 0.09]) else { continue };
            let index = (row * width + col) as usize;
            mask.data[index] = true;
            frame.depth.data[index] = depth as f32;
            let angle = point.y.atan2(point.x);
            let print = |phase: f64, times: f64| 0.5 + 0.4 * (times * angle + phase + 40.0 * point.z).sin();
            let color = [print(0.0, 3.0), print(1.0, 5.0), print(2.0, 2.0)];
            let color = if printed { color } else { [0.8; 3] };
            frame.rgb.put_pixel(col, row, image::Rgb(color.map(|v| (255.0 * v) as u8)));
        }
    }
    (frame, mask)
}

fn view(rng: &mut ChaCha8Rng) -> AnnotatedFrame {
    let intrinsics = Intrinsics { fx: 300.0, fy: 300.0, cx: 159.5, cy: 119.5 };
    let (width, height) = (320, 240);
    let mut frame = RgbdFrame {
        rgb: image::RgbImage::new(width, height),
        depth: DepthMap::zeros(width, height),
        intrinsics,
    };
    let mut instances = Vec::new();
    for (object, half_axes) in HALF_AXES.iter().enumerate() {
        let mut unit = || rng.random_range(-1.0..1.0f64);
        let q = UnitQuaternion::from_quaternion(Quaternion::new(unit(), unit(), unit(), unit()));
        let side = if object == 0 { -0.13 } else { 0.13 };
        let center = Vector3::new(side + 0.01 * unit(), 0.03 * unit(), 0.6 + 0.05 * unit());
        let pose = Pose::new(*q.to_rotation_matrix().matrix(), center);
        let mut mask = Mask::empty(width, height);
        for row in 0..height {
            for col in 0..width {
                let ray = intrinsics.back_project(col as f64, row as f64, 1.0).coords;
                let Some((depth, point)) = hit(&ray, &pose, half_axes) else { continue };
                let i = (row * width + col) as usize;
                mask.data[i] = true;
                // One pixel in 50 has no depth.
                frame.depth.data[i] = if i % 50 == 7 { 0.0 } else { depth as f32 };
                let stripe = |v: f64| (127.0 + 120.0 * (v * 200.0).sin()) as u8;
                frame.rgb.put_pixel(
                    col,
                    row,
                    image::Rgb([stripe(point.x), stripe(point.y), stripe(point.z)]),
                );
            }
        }
        instances.push(Instance {
            obj_id: object as u32 + 1,
            t_camera_object: pose,
            visib_fract: 1.0,
            px_count_visib: mask.count() as u32,
            mask_visib: mask,
        });
    }
    AnnotatedFrame { frame, instances }
}

/// Depth of the first intersection along `ray` (z = 1) and the point in the object's frame.
fn hit(ray: &Vector3<f64>, pose: &Pose, half_axes: &[f64; 3]) -> Option<(f64, Vector3<f64>)> {
    let scale = Vector3::from(*half_axes);
    let origin = -pose.rotation.tr_mul(&pose.translation);
    let (o, d) = (origin.component_div(&scale), pose.rotation.tr_mul(ray).component_div(&scale));
    let (a, b, c) = (d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0);
    let discriminant = b * b - a * c;
    (discriminant > 0.0).then(|| {
        let depth = (-b - discriminant.sqrt()) / a;
        (depth, origin + pose.rotation.tr_mul(ray) * depth)
    })
}
