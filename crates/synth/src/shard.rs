//! One shard: scenes are made in parallel, images keep their order.

use image::RgbImage;
use rayon::prelude::*;
use unopose_core::{config::SynthConfig, frame::DepthMap};
use unopose_dataset::{
    formats::{
        bop::{GtInfoRecord, GtRecord},
        camera::CameraRecord,
        megapose::{EncodedImage, ImageRecords},
        rle::Rle,
    },
    render::{Camera, InstanceView, SceneRenderer, instance_views},
};

use super::{
    SynthError, color_camera,
    progress::Reporter,
    random::{Domain, Draw, stream},
    scene::{self, Arrangement, SceneAssets},
    sensor::DepthSensor,
};

/// Millimetres per unit of the depth images.
const DEPTH_SCALE: f64 = 0.1;

/// Everything of one generated image before encoding.
pub(super) struct Image {
    /// `SSSSSS_IIIIII`.
    pub key: String,
    pub rgb: RgbImage,
    pub depth: DepthMap,
    pub records: ImageRecords,
    pub jpeg_quality: u8,
}

/// Scenes that a shard with `images` images has.
pub(super) fn scene_count(config: &SynthConfig, images: usize) -> usize {
    images.div_ceil(config.views_per_scene.max(1))
}

/// Encoded images of a shard; `done` is called after every finished scene with its number of images. No scene begins once
/// `reporter` was told to stop.
pub(super) fn encode_shard(
    config: &SynthConfig,
    assets: &SceneAssets,
    shard: u32,
    images: usize,
    reporter: &Reporter,
    done: &(dyn Fn(usize) + Sync),
) -> Result<Vec<EncodedImage>, SynthError> {
    let scenes: Vec<Result<Vec<EncodedImage>, SynthError>> = (0..scene_count(config, images))
        .into_par_iter()
        .map(|k| {
            reporter.go_on()?;
            let made = images_of_scene(config, assets, shard, k, images);
            let encoded = made
                .iter()
                .map(|i| Ok(EncodedImage::new(&i.key, &i.rgb, i.jpeg_quality, &i.depth, &i.records)?))
                .collect();
            done(made.len());
            encoded
        })
        .collect();
    let mut all = Vec::with_capacity(images);
    for scene in scenes {
        all.extend(scene?);
    }
    Ok(all)
}

/// The images of scene `k` of a shard.
pub(super) fn images_of_scene(
    config: &SynthConfig,
    assets: &SceneAssets,
    shard: u32,
    k: usize,
    images: usize,
) -> Vec<Image> {
    let views = config.views_per_scene.max(1);
    let full_shard = scene_count(config, config.images_per_shard) as u64;
    let number = u64::from(shard) * full_shard + k as u64;
    let mut rng = stream(config.seed, Domain::Scene, number);
    let arrangement = scene::arrange(config, assets, &mut rng);
    let sensor = DepthSensor::draw(&config.sensor, &mut stream(config.seed, Domain::Sensor, number));
    let renderer = SceneRenderer::new(&arrangement.scene).with_indirect_rays(config.indirect_rays);
    let first = k * views;
    (first..images.min(first + views))
        .map(|image| {
            let view = (image - first) as u64;
            let mut rng = stream(config.seed, Domain::View, number * views as u64 + view);
            let camera = arrangement.camera(config, view as usize, views, &mut rng);
            let rendering = renderer.render(&camera, config.supersampling.max(1));
            let (rgb, brightness) = color_camera::capture(&rendering, &config.sensor, &mut rng);
            let depth = match config.sensor.enabled {
                true => sensor.measure(
                    &rendering,
                    camera.intrinsics.fx as f32,
                    &brightness,
                    &config.sensor,
                    &mut rng,
                ),
                false => rendering.depth.clone(),
            };
            let instances = instance_views(
                &arrangement.scene.objects[..arrangement.obj_ids.len()],
                &camera,
                &rendering.ids,
            );
            let records = records(&arrangement, &camera, &instances, &depth);
            let [low, high] = config.sensor.jpeg_quality.map(usize::from);
            let jpeg_quality = rng.count(low, high).clamp(1, 100) as u8;
            Image { key: format!("{number:06}_{view:06}"), rgb, depth, records, jpeg_quality }
        })
        .collect()
}

fn records(
    arrangement: &Arrangement,
    camera: &Camera,
    instances: &[InstanceView],
    depth: &DepthMap,
) -> ImageRecords {
    let objects = arrangement.scene.objects.iter().zip(&arrangement.obj_ids);
    let gt = objects.map(|(o, &id)| GtRecord::new(id, &(camera.t_camera_world * o.t_world_object))).collect();
    let valid = |view: &InstanceView| {
        view.mask.data.iter().zip(&depth.data).filter(|(m, z)| **m && **z > 0.0).count() as u32
    };
    let info = |view: &InstanceView| GtInfoRecord {
        bbox_obj: view.bbox_obj,
        bbox_visib: view.bbox_visib,
        px_count_all: view.px_count_all,
        px_count_valid: valid(view),
        px_count_visib: view.px_count_visib,
        visib_fract: view.visib_fract,
    };
    let t = camera.t_camera_world;
    let camera = CameraRecord {
        cam_r_w2c: Some(t.rotation_row_major()),
        cam_t_w2c: Some((t.translation * 1000.0).into()),
        ..CameraRecord::new(&camera.intrinsics, DEPTH_SCALE)
    };
    ImageRecords {
        camera,
        gt,
        gt_info: instances.iter().map(info).collect(),
        mask: instances.iter().map(|v| Rle::encode(&v.mask)).collect(),
        mask_visib: instances.iter().map(|v| Rle::encode(&v.mask_visib)).collect(),
    }
}
