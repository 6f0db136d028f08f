//! Synthetic data: objects, scenes, cameras, sensor.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A generated data set. Every file is a function of this alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SynthConfig {
    /// Seed of objects, scenes, cameras and noise.
    pub seed: u64,
    /// Images in the whole set.
    pub images: usize,
    /// Images per shard. A multiple of `views_per_scene` wastes nothing.
    pub images_per_shard: usize,
    /// Distinct objects in the set.
    pub objects: usize,
    /// Objects that the scenes of one shard draw from. Few objects per shard show each of them in many images.
    pub objects_per_shard: usize,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Colour samples per pixel in each direction.
    pub supersampling: u32,
    /// Rays per pixel that gather light from other surfaces: better shading at several times the cost. 0: the
    /// sky's light with soft shadows.
    pub indirect_rays: u32,
    /// Images of one scene from different viewpoints.
    pub views_per_scene: usize,
    /// Fewest and most annotated objects dropped in a scene. From 0 on some scenes are empty.
    pub objects_per_scene: [usize; 2],
    /// Fewest and most further objects in a scene, which are not annotated. 0 and 0: none.
    pub distractors: [usize; 2],
    /// Share of scenes in an open bin. Scenes neither in a bin nor on a shelf are on a table.
    pub bins: f32,
    /// Share of scenes on a shelf.
    pub shelves: f32,
    /// Folder with pictures (jpg, png; searched recursively) for walls, floors and tables. Empty: procedural pictures.
    pub background_folder: PathBuf,
    /// Smallest and largest diameter of procedural objects, metres. Drawn log-uniformly.
    pub diameter: [f32; 2],
    /// Side of an object's texture map, pixels.
    pub texture_size: u32,
    /// Share of procedural objects of plain colour.
    pub textureless: f32,
    /// Share of procedural objects that are packages: cans, bottles, cartons, books, plates, cushions, covered by prints
    /// that repeat nowhere, so that only the print tells how they are turned.
    pub printed: f32,
    /// Folder with photographs (jpg, png; searched recursively) for the prints of such objects. Empty: procedural pictures.
    pub texture_folder: PathBuf,
    /// Share of scenes that are frozen while the objects still tumble.
    pub tumbling: f32,
    /// Folder with meshes (ply, obj, stl, glb; searched recursively) to use besides the procedural objects. Empty: none.
    pub mesh_folder: PathBuf,
    /// Which files of `mesh_folder` are objects.
    pub mesh_layout: MeshLayout,
    /// Unit of the meshes in `mesh_folder`, metres: 0.001 for millimetres.
    pub mesh_scale: f32,
    /// How large the objects from `mesh_folder` are.
    pub mesh_size: MeshSize,
    /// Share of objects taken from `mesh_folder` where one is given.
    pub mesh_share: f32,
    /// Write the object meshes and `models_info.json` beside the shards.
    pub write_models: bool,
    /// Where the cameras are.
    pub camera: SynthCameraConfig,
    /// Errors of the depth and colour cameras. Lengths in pixels refer to an image 640 pixels wide.
    pub sensor: SensorConfig,
}

/// Layout of a folder of meshes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MeshSize {
    /// As in the file. Objects outside 2 cm to 60 cm are scaled to a diameter drawn from `diameter`.
    #[default]
    Own,
    /// As in MegaPose's data: the sphere around the centred object has a radius of 10 cm. ShapeNet's normalised coordinates
    /// are multiplied by 0.1 m.
    #[serde(rename = "megapose")]
    MegaPose,
}

/// Where the cameras are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SynthCameraConfig {
    /// Smallest and largest distance to the pile of objects, metres. Drawn log-uniformly.
    pub distance: [f32; 2],
    /// Lowest and highest elevation above the table, degrees. Bins are seen from steeper angles, shelves from
    /// flatter ones.
    pub elevation_deg: [f32; 2],
    /// Standard deviation of the roll, degrees. A tenth of the views have any roll.
    pub roll_deg: f32,
    /// Smallest and largest share of the image's shorter side that the pile of objects fills. Above 1: it is cut off.
    pub fill: [f32; 2],
    /// Shortest and longest focal length, image widths.
    pub focal: [f32; 2],
}

/// Depth and colour camera errors. Lengths in pixels refer to an image 640 pixels wide.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// Simulate the cameras' errors. Without them depth and colour are free of noise.
    pub enabled: bool,
    /// Share of scenes seen by a stereo depth camera. Scenes seen neither by stereo nor by time of flight are seen by
    /// a structured-light camera.
    pub stereo: f32,
    /// Share of scenes seen by a time-of-flight depth camera.
    pub time_of_flight: f32,
    /// Smallest and largest baseline of the depth camera, metres. Depth noise is disparity noise times depth squared over
    /// focal length and baseline.
    pub baseline: [f32; 2],
    /// Standard deviations of the disparity noise at correlation lengths of 2, 5 and 30 pixels, pixels.
    pub disparity_noise: [f32; 3],
    /// Smallest and largest factor on the depth noise. Drawn log-uniformly per scene.
    pub noise_gain: [f32; 2],
    /// Disparity steps per pixel. 0: disparity is not quantised.
    pub disparity_steps: f32,
    /// Time of flight: standard deviation of depth at 30 % reflectance, metres, and its increase per squared metre of
    /// distance, metres.
    pub tof_noise: [f32; 2],
    /// Time of flight: largest systematic error, metres, of wiggling with the distance and of dark against bright surfaces.
    pub tof_offset: f32,
    /// Standard deviation of the displacement of depth edges, pixels.
    pub edge_jitter: f32,
    /// Share of pixels lost beside depth edges.
    pub edge_loss: f32,
    /// Cosine between normal and viewing ray below which pixels are lost, increasingly towards grazing angles.
    pub grazing_cos: f32,
    /// Share of pixels lost on very dark surfaces.
    pub dark_loss: f32,
    /// Share of pixels lost in highlights.
    pub shiny_loss: f32,
    /// Share of pixels lost anywhere.
    pub speckle_loss: f32,
    /// Share of edge pixels with a depth between foreground and background.
    pub flying: f32,
    /// Nearest and farthest depth, metres.
    pub range: [f32; 2],
    /// Largest shift between colour and depth per axis, pixels.
    pub misalignment: f32,
    /// Standard deviation of the colour noise at mid grey, levels of 255.
    pub color_noise: f32,
    /// Largest standard deviation of the colour blur, pixels.
    pub blur: f32,
    /// Lowest and highest mean brightness of an image after exposure, sRGB values from 0 to 1.
    pub brightness: [f32; 2],
    /// Largest relative change of the red and blue gains.
    pub white_balance: f32,
    /// Largest relative change of gamma, contrast and saturation. In 30 % of the images contrast
    /// and saturation exceed it.
    pub tone: f32,
    /// Lowest and highest JPEG quality.
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
            printed: 0.0,
            texture_folder: PathBuf::new(),
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
