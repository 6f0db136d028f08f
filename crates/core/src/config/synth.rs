//! Synthetic data: objects, scenes, cameras, sensor.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// A generated data set. Every file is a function of this alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SynthConfig {
    /// Seed of objects, scenes, cameras and noise.
    pub seed: u64,
    /// Images in the whole set.
    pub images: usize,
    /// Images per shard (a multiple of `views_per_scene` wastes nothing).
    pub images_per_shard: usize,
    /// Distinct objects.
    pub objects: usize,
    /// Objects that the scenes of one shard draw from; keeps every object in many images.
    pub objects_per_shard: usize,
    /// Image size in pixels.
    pub width: u32,
    pub height: u32,
    /// Colour samples per pixel in each direction.
    pub supersampling: u32,
    /// Rays per pixel that gather light from other surfaces: better shading at several times the cost. 0: the sky's
    /// light with soft shadows.
    pub indirect_rays: u32,
    pub views_per_scene: usize,
    /// Fewest and most objects dropped in a scene.
    pub objects_per_scene: [usize; 2],
    /// Fewest and most further objects that are not annotated.
    pub distractors: [usize; 2],
    /// Shares of scenes in an open bin and on a shelf; the others are on a table.
    pub bins: f32,
    pub shelves: f32,
    /// Folder with pictures (jpg, png; searched recursively) for walls, floors and tables; empty: procedural ones.
    pub background_folder: PathBuf,
    /// Smallest and largest object diameter, metres, log-uniform.
    pub diameter: [f32; 2],
    /// Side of an object's texture map, pixels.
    pub texture_size: u32,
    /// Share of objects of plain colour.
    pub textureless: f32,
    /// Share of scenes frozen while the objects still tumble.
    pub tumbling: f32,
    /// Folder with meshes (ply, obj, stl, glb; searched recursively) used besides the procedural objects; empty: none.
    pub mesh_folder: PathBuf,
    /// Which files of `mesh_folder` are objects.
    pub mesh_layout: MeshLayout,
    /// Unit of the meshes in `mesh_folder`, metres.
    pub mesh_scale: f32,
    /// How large these objects are.
    pub mesh_size: MeshSize,
    /// Share of objects taken from `mesh_folder` when there is one.
    pub mesh_share: f32,
    /// Write the object meshes and `models_info.json` beside the shards.
    pub write_models: bool,
    pub camera: SynthCameraConfig,
    pub sensor: SensorConfig,
}

/// Layout of a folder of meshes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MeshLayout {
    /// One of the two known layouts if any of their files is there, else every mesh file.
    #[default]
    Detect,
    /// Every mesh file is an object.
    Plain,
    /// Google Scanned Objects: `NAME/meshes/model.obj` with `NAME/materials/textures/`.
    Gso,
    /// ShapeNetCore.v2: `SYNSET/NAME/models/model_normalized.obj`.
    ShapeNet,
}

/// Size of objects from files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MeshSize {
    /// As in the file; objects outside 2 cm .. 60 cm are brought to `diameter`.
    #[default]
    Own,
    /// As MegaPose has them: the sphere around the centred object has a radius of 10 cm; ShapeNet's normalised
    /// coordinates are multiplied by 0.1 m.
    #[serde(rename = "megapose")]
    MegaPose,
}

/// Where the cameras are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SynthCameraConfig {
    /// Distance to the pile, metres, log-uniform.
    pub distance: [f32; 2],
    /// Elevation above the table, degrees.
    pub elevation_deg: [f32; 2],
    /// Standard deviation of the roll, degrees; a tenth of the views have any roll.
    pub roll_deg: f32,
    /// Share of the image's shorter side that the pile fills.
    pub fill: [f32; 2],
    /// Shortest and longest focal length in image widths.
    pub focal: [f32; 2],
}

/// Depth and colour camera errors. Lengths in pixels refer to an image 640 pixels wide.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// Without it depth and colour are noise-free.
    pub enabled: bool,
    /// Shares of scenes seen by a stereo and by a time-of-flight depth camera; the others by structured light.
    pub stereo: f32,
    pub time_of_flight: f32,
    /// Baseline of the depth sensor, metres: depth noise is z^2 / (focal x baseline) x disparity noise.
    pub baseline: [f32; 2],
    /// Standard deviation of the disparity noise at three correlation lengths (2, 5 and 30 px).
    pub disparity_noise: [f32; 3],
    /// The disparity noise is multiplied by a factor drawn per scene, log-uniform.
    pub noise_gain: [f32; 2],
    /// Disparity steps per pixel; 0: not quantised.
    pub disparity_steps: f32,
    /// Time of flight: standard deviation at 30 % reflectance, constant and per squared metre of distance, metres.
    pub tof_noise: [f32; 2],
    /// Time of flight: largest systematic error (wiggling, and dark against bright surfaces), metres.
    pub tof_offset: f32,
    /// Standard deviation of the displacement of depth edges.
    pub edge_jitter: f32,
    /// Share of pixels lost beside depth edges.
    pub edge_loss: f32,
    /// Pixels are lost more and more below this cosine between normal and viewing ray.
    pub grazing_cos: f32,
    /// Share of pixels lost on very dark surfaces and in highlights.
    pub dark_loss: f32,
    pub shiny_loss: f32,
    /// Share of pixels lost anywhere.
    pub speckle_loss: f32,
    /// Share of edge pixels with a depth between foreground and background.
    pub flying: f32,
    /// Nearest and farthest depth, metres.
    pub range: [f32; 2],
    /// Largest shift between colour and depth.
    pub misalignment: f32,
    /// Standard deviation of the colour noise at mid grey, 8-bit levels.
    pub color_noise: f32,
    /// Largest standard deviation of the colour blur.
    pub blur: f32,
    /// Mean image brightness after exposure, sRGB 0..1.
    pub brightness: [f32; 2],
    /// Largest relative change of the red and blue gains.
    pub white_balance: f32,
    /// Largest relative change of gamma and saturation.
    pub tone: f32,
    /// JPEG quality range.
    pub jpeg_quality: [u8; 2],
}

impl Default for SynthConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            images: 1000,
            images_per_shard: 100,
            objects: 100,
            objects_per_shard: 120,
            width: 320,
            height: 240,
            supersampling: 2,
            indirect_rays: 0,
            views_per_scene: 5,
            objects_per_scene: [3, 9],
            distractors: [0, 3],
            bins: 0.15,
            shelves: 0.15,
            background_folder: PathBuf::new(),
            diameter: [0.07, 0.28],
            texture_size: 384,
            textureless: 0.2,
            tumbling: 0.25,
            mesh_folder: PathBuf::new(),
            mesh_layout: MeshLayout::Detect,
            mesh_scale: 1.0,
            mesh_size: MeshSize::Own,
            mesh_share: 0.5,
            write_models: true,
            camera: SynthCameraConfig::default(),
            sensor: SensorConfig::default(),
        }
    }
}

impl Default for SynthCameraConfig {
    fn default() -> Self {
        Self {
            distance: [0.4, 1.3],
            elevation_deg: [15.0, 85.0],
            roll_deg: 8.0,
            fill: [0.75, 1.4],
            focal: [0.8, 2.0],
        }
    }
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            stereo: 0.25,
            time_of_flight: 0.25,
            baseline: [0.05, 0.1],
            disparity_noise: [0.12, 0.06, 0.07],
            noise_gain: [0.5, 2.2],
            disparity_steps: 8.0,
            tof_noise: [0.0006, 0.001],
            tof_offset: 0.003,
            edge_jitter: 1.6,
            edge_loss: 0.5,
            grazing_cos: 0.42,
            dark_loss: 0.4,
            shiny_loss: 0.35,
            speckle_loss: 0.003,
            flying: 0.06,
            range: [0.25, 4.0],
            misalignment: 1.5,
            color_noise: 2.5,
            blur: 1.4,
            brightness: [0.32, 0.68],
            white_balance: 0.08,
            tone: 0.15,
            jpeg_quality: [85, 96],
        }
    }
}
