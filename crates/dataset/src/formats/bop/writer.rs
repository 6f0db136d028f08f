//! Writes scenes in the layout [`super::BopSplit`] reads.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use unopose_core::frame::{Mask, RgbdFrame};
use unopose_core::geometry::Pose;

use super::{
    super::{
        FormatError,
        camera::CameraRecord,
        files::write_json,
        image_io::{write_depth, write_mask, write_rgb},
    },
    GtInfoRecord, GtRecord,
    visibility::{Silhouette, gt_info},
};

/// An instance as the writer needs it: the visible part and the whole silhouette.
#[derive(Clone, Debug)]
pub struct SceneInstance {
    /// Object id, that of the model's file.
    pub obj_id: u32,
    /// Object to camera, metres.
    pub t_camera_object: Pose,
    /// The whole silhouette inside the image.
    pub mask: Mask,
    /// The visible part of the silhouette.
    pub mask_visib: Mask,
    /// Pixels of the silhouette, also outside the image.
    pub px_count_all: u32,
}

/// An image to be written.
#[derive(Clone, Debug)]
pub struct SceneImage {
    /// Number of the image in its scene.
    pub im_id: u32,
    /// Colour, depth (metres) and intrinsics.
    pub frame: RgbdFrame,
    /// In the order in which they are annotated.
    pub instances: Vec<SceneInstance>,
}

/// Writes the images of one scene; the JSON files appear with [`Self::finish`].
#[derive(Debug)]
pub struct BopSceneWriter {
    folder: PathBuf,
    depth_scale: f64,
    rgb_extension: &'static str,
    cameras: BTreeMap<u32, CameraRecord>,
    gt: BTreeMap<u32, Vec<GtRecord>>,
    gt_info: BTreeMap<u32, Vec<GtInfoRecord>>,
}

impl BopSceneWriter {
    /// A scene `split/SSSSSS`; depth is stored in steps of `depth_scale` mm, colour as jpeg or png.
    pub fn new(split: &Path, scene_id: u32, depth_scale: f64, jpeg: bool) -> Self {
        Self {
            folder: split.join(format!("{scene_id:06}")),
            depth_scale,
            rgb_extension: if jpeg { "jpg" } else { "png" },
            cameras: BTreeMap::new(),
            gt: BTreeMap::new(),
            gt_info: BTreeMap::new(),
        }
    }

    /// Writes the files of one image and keeps its annotation.
    pub fn add(&mut self, image: &SceneImage) -> Result<(), FormatError> {
        let SceneImage { im_id, frame, instances } = image;
        write_rgb(&self.folder.join(format!("rgb/{im_id:06}.{}", self.rgb_extension)), &frame.rgb)?;
        write_depth(&self.folder.join(format!("depth/{im_id:06}.png")), &frame.depth, self.depth_scale)?;
        for (index, instance) in instances.iter().enumerate() {
            let name = format!("{im_id:06}_{index:06}.png");
            write_mask(&self.folder.join("mask").join(&name), &instance.mask)?;
            write_mask(&self.folder.join("mask_visib").join(&name), &instance.mask_visib)?;
        }
        self.cameras.insert(*im_id, CameraRecord::new(&frame.intrinsics, self.depth_scale));
        let gt = instances.iter().map(|i| GtRecord::new(i.obj_id, &i.t_camera_object)).collect();
        self.gt.insert(*im_id, gt);
        let info = |instance: &SceneInstance| {
            let silhouette =
                Silhouette { mask: Cow::Borrowed(&instance.mask), px_count_all: instance.px_count_all };
            gt_info(&silhouette, &instance.mask_visib, Some(&frame.depth))
        };
        self.gt_info.insert(*im_id, instances.iter().map(info).collect());
        Ok(())
    }

    /// Writes `scene_camera.json`, `scene_gt.json` and `scene_gt_info.json`.
    pub fn finish(self) -> Result<(), FormatError> {
        write_json(&self.folder.join("scene_gt_info.json"), &self.gt_info, false)?;
        write_json(&self.folder.join("scene_gt.json"), &self.gt, false)?;
        // Last: a scene without it is not taken for one.
        write_json(&self.folder.join("scene_camera.json"), &self.cameras, false)
    }
}
