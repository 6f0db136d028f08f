//! Scenes: which objects lie where, under which light, in which room, seen from where.

use std::f32::consts::{PI, TAU};

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    config::{SynthCameraConfig, SynthConfig},
    geometry::{Intrinsics, Pose},
};
use unopose_dataset::render::{Camera, Light, PosedMesh, Scene};

use super::{background::Backgrounds, object::SynthObject, physics, place::Place, random::Draw};

/// What the scenes of a shard are made of.
pub(super) struct SceneAssets {
    /// Objects of the set.
    pub objects: Vec<SynthObject>,
    /// Objects that are not annotated.
    pub distractors: Vec<SynthObject>,
    pub backgrounds: Backgrounds,
}

/// A scene and the ids of its objects.
pub(super) struct Arrangement {
    /// Annotated objects first.
    pub scene: Scene,
    /// One per annotated object.
    pub obj_ids: Vec<u32>,
    pub place: Place,
    /// Centre and radius of the pile.
    center: Vector3<f32>,
    radius: f32,
}

/// Draws a scene.
pub(super) fn arrange(config: &SynthConfig, assets: &SceneAssets, rng: &mut ChaCha8Rng) -> Arrangement {
    let [fewest, most] = config.objects_per_scene;
    let count = rng.count(fewest, most).min(assets.objects.len());
    let mut objects = draw_alike(&assets.objects, count, rng);
    let others = rng.count(config.distractors[0], config.distractors[1]).min(assets.distractors.len());
    objects.extend(draw(&assets.distractors, others, rng));
    let tumbling = rng.chance(config.tumbling);
    let sizes: Vec<f32> = objects.iter().map(|o| Vector3::from(o.mesh.bounds().size()).norm()).collect();
    let mean = sizes.iter().sum::<f32>() / sizes.len().max(1) as f32;
    let largest = sizes.iter().copied().fold(0.0, f32::max);
    let mut place = Place::draw(config, objects.len(), mean, largest, rng);
    let mut poses = physics::drop_objects(&objects, &place, tumbling, rng);
    if poses.iter().take(count).flatten().count() < fewest.min(count) {
        tracing::debug!("a drop failed; objects are laid out side by side");
        place = Place::Table;
        poses = physics::lay_out(&objects, rng);
    }
    let mut placed = Vec::new();
    let mut obj_ids = Vec::new();
    for (i, (object, pose)) in objects.iter().zip(poses).enumerate() {
        if let Some(t_world_object) = pose {
            placed.push(PosedMesh { mesh: object.mesh.clone(), finish: object.finish, t_world_object });
            if i < count {
                obj_ids.push(object.obj_id);
            }
        }
    }
    let spots: Vec<(Vector3<f32>, f32)> = placed
        .iter()
        .map(|p| (p.t_world_object.translation.cast(), 0.5 * Vector3::from(p.mesh.bounds().size()).norm()))
        .collect();
    let center = spots.iter().map(|s| s.0).sum::<Vector3<f32>>() / spots.len().max(1) as f32;
    let radius = spots.iter().map(|s| (s.0 - center).norm() + 0.7 * s.1).fold(0.05, f32::max);
    let top = spots.iter().map(|s| s.0.z + s.1).fold(0.0, f32::max);
    let reach = spots.iter().map(|s| s.0.xy().norm() + s.1).fold(0.0, f32::max);
    let farthest = config.camera.distance[1].max(radius + 0.2);
    let lights = lights(&center, &place, rng);
    let tint = tint(rng, 0.12);
    let sky = rng.log_between(0.08, 0.6);
    let ground = sky * rng.between(0.25, 0.7);
    let scene = Scene {
        objects: placed,
        room: place.room([reach, top, farthest], &assets.backgrounds, rng),
        lights,
        sky: tint.map(|t| t * sky),
        ground: tint.map(|t| t * ground),
    };
    Arrangement { scene, obj_ids, place, center, radius }
}

/// Three quarters of the scenes have objects of similar size, so that none is lost beside the largest.
fn draw_alike<'a>(from: &'a [SynthObject], count: usize, rng: &mut ChaCha8Rng) -> Vec<&'a SynthObject> {
    let mut objects = draw(from, from.len(), rng);
    if rng.chance(0.75) && count > 0 {
        let size = |o: &SynthObject| Vector3::from(o.mesh.bounds().size()).norm();
        let first = size(objects[0]);
        let alike = |o: &SynthObject| (0.4..2.5).contains(&(size(o) / first));
        // Stable: what is alike comes first, in the order drawn.
        objects.sort_by_key(|o| !alike(o));
    }
    objects.truncate(count);
    objects
}

fn draw<'a>(from: &'a [SynthObject], count: usize, rng: &mut ChaCha8Rng) -> Vec<&'a SynthObject> {
    rand::seq::index::sample(rng, from.len(), count).iter().map(|i| &from[i]).collect()
}

/// Gains around 1 per channel.
fn tint(rng: &mut ChaCha8Rng, amount: f32) -> [f32; 3] {
    let warm = rng.between(-amount, amount);
    [1.0 + warm, 1.0 + 0.2 * rng.between(-amount, amount), 1.0 - warm]
}

fn lights(center: &Vector3<f32>, place: &Place, rng: &mut ChaCha8Rng) -> Vec<Light> {
    let count = *rng.pick(&[1, 2, 2, 3, 3, 4]);
    (0..count)
        .map(|i| {
            let (azimuth, height) = match place {
                // From the open side, below the upper board.
                Place::Shelf { .. } => (rng.between(-0.8 * PI, -0.2 * PI), rng.between(0.1, 0.6)),
                _ => (rng.between(0.0, TAU), rng.between(0.35, 0.98)),
            };
            let flat = (1.0 - height * height).sqrt();
            let direction = Vector3::new(flat * azimuth.cos(), flat * azimuth.sin(), height);
            let strength = if i == 0 { rng.between(1.2, 3.0) } else { rng.between(0.2, 1.5) };
            Light {
                position: center + direction * rng.log_between(0.9, 3.0),
                radius: rng.log_between(0.01, 0.25),
                color: tint(rng, 0.2).map(|t| t * strength),
            }
        })
        .collect()
}

impl Arrangement {
    /// View `index` of `views`: azimuths are spread evenly with jitter.
    pub fn camera(&self, config: &SynthConfig, index: usize, views: usize, rng: &mut ChaCha8Rng) -> Camera {
        let camera = &config.camera;
        let [near, far] = camera.distance;
        let distance = rng.log_between(near, far).max(self.radius + 0.2);
        let zone = self.place.views(camera.elevation_deg);
        // Evenly spread over the sphere's zone, not over the angle.
        let [low, high] = zone.elevation_deg.map(|d| d.to_radians().sin());
        let up = rng.between(low, high);
        let turn = 2.0 * (index as f32 + rng.between(0.0, 1.0)) / views.max(1) as f32 - 1.0;
        let azimuth = zone.azimuth[0] + zone.azimuth[1] * turn;
        let flat = (1.0 - up * up).sqrt();
        let offset = Vector3::new(flat * azimuth.cos(), flat * azimuth.sin(), up);
        // A third of the views look at one object instead of the whole pile.
        let (mut target, mut radius) = (self.center, self.radius);
        if rng.chance(0.35) && !self.obj_ids.is_empty() {
            let object = rng.pick(&self.scene.objects[..self.obj_ids.len()]);
            let spot: Vector3<f32> = object.t_world_object.translation.cast();
            target = spot.lerp(&self.center, 0.3);
            radius = (0.6 * radius).max(0.08);
        }
        target += rng.unit_vector() * (0.2 * radius);
        let mut position = target + offset * distance;
        position.z = position.z.max(zone.lowest);
        position.y = zone.front.map_or(position.y, |y| position.y.min(y));
        let roll = if rng.chance(0.1) { rng.between(0.0, 360.0) } else { camera.roll_deg * rng.normal() };
        let t_camera_world = Pose::looking_at(&position.cast(), &target.cast(), f64::from(roll.to_radians()));
        let intrinsics = intrinsics(config, camera, radius, (position - target).norm(), rng);
        Camera { t_camera_world, intrinsics, width: config.width, height: config.height }
    }
}

fn intrinsics(
    config: &SynthConfig,
    camera: &SynthCameraConfig,
    radius: f32,
    distance: f32,
    rng: &mut ChaCha8Rng,
) -> Intrinsics {
    let (width, height) = (config.width as f32, config.height as f32);
    let fill = rng.between(camera.fill[0], camera.fill[1]);
    let [shortest, longest] = camera.focal.map(|f| f * width);
    let fx = (fill * 0.5 * width.min(height) * distance / radius).clamp(shortest, longest);
    let fy = fx * (1.0 + 0.004 * rng.normal().clamp(-2.0, 2.0));
    let cx = 0.5 * (width - 1.0) + 0.01 * width * rng.normal().clamp(-2.0, 2.0);
    let cy = 0.5 * (height - 1.0) + 0.01 * height * rng.normal().clamp(-2.0, 2.0);
    Intrinsics { fx: fx.into(), fy: fy.into(), cx: cx.into(), cy: cy.into() }
}
