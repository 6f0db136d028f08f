//! One image of a shard, whole.

use std::collections::BTreeMap;

use image::RgbImage;
use unopose_core::frame::{Mask, RgbdFrame};

use super::{
    super::{
        AnnotatedFrame, FormatError, Instance, ModelInfo,
        bop::{GtInfoRecord, GtRecord},
        camera::CameraRecord,
        image_io::{decode_depth, decode_rgb},
        rle::Rle,
    },
    archive::Archive,
    instance_fault::{InstanceFault, mend},
    records::{ImageRecords, MemberKind, from_json, masks_from_json},
};

/// Units of depth images, millimetres: micrometres to metres.
const DEPTH_SCALE: std::ops::RangeInclusive<f64> = 1e-3..=1e3;

/// The members of an image, decoded but not compared with each other.
#[derive(Debug)]
pub(super) struct ShardImage {
    pub records: ImageRecords,
    pub rgb: RgbImage,
    depth_png: Vec<u8>,
    /// Shard and key, for messages.
    pub name: String,
}

impl ShardImage {
    pub fn read(archive: &Archive, key: &str) -> Result<Self, FormatError> {
        let mut reader = archive.reader()?;
        let mut member = |kind| reader.read(key, kind);
        let (bytes, place) = member(MemberKind::Camera)?;
        let camera: CameraRecord = from_json(&bytes, &place)?;
        check_camera(&camera, &place)?;
        let (bytes, place) = member(MemberKind::Gt)?;
        let gt: Vec<GtRecord> = from_json(&bytes, &place)?;
        let (bytes, place) = member(MemberKind::GtInfo)?;
        let gt_info: Vec<GtInfoRecord> = from_json(&bytes, &place)?;
        check_instances(&gt, &gt_info, &place)?;
        let (bytes, place) = member(MemberKind::MaskVisib)?;
        let mask_visib = masks_from_json(&bytes, gt.len(), &place)?;
        // The whole silhouettes are not needed for training; sets without them are read, too.
        let mask = match member(MemberKind::Mask) {
            Ok((bytes, place)) => masks_from_json(&bytes, gt.len(), &place)?,
            Err(_) => Vec::new(),
        };
        let (bytes, place) = member(MemberKind::Rgb)?;
        let rgb = decode_rgb(&bytes, &place)?;
        let (depth_png, _) = member(MemberKind::Depth)?;
        let records = ImageRecords { camera, gt, gt_info, mask, mask_visib };
        Ok(Self { records, rgb, depth_png, name: format!("{}: {key}", archive.path.display()) })
    }

    /// Colour, depth and all instances; images and masks have to agree in size. What is wrong with single instances
    /// comes with their numbers; `models` are the objects whose size is known.
    pub fn annotated(
        self,
        models: &BTreeMap<u32, ModelInfo>,
    ) -> Result<(AnnotatedFrame, Vec<(usize, InstanceFault)>), FormatError> {
        let Self { records, rgb, depth_png, name } = self;
        let camera = records.camera.check(&name)?;
        let scale = camera
            .depth_scale
            .ok_or_else(|| FormatError::missing(format!("{name}.camera.json"), "depth_scale", ""))?;
        let depth = decode_depth(&depth_png, &format!("{name}.depth.png"), scale)?;
        camera.check_size(&format!("{name}.camera.json"), rgb.dimensions())?;
        if (depth.width, depth.height) != (rgb.width(), rgb.height()) {
            let value = format!("{} x {}", depth.width, depth.height);
            let expected = format!("{} x {} as rgb.jpg", rgb.width(), rgb.height());
            return Err(FormatError::field(format!("{name}.depth.png"), "image size", value, expected));
        }
        let frame = RgbdFrame { rgb, depth, intrinsics: camera.intrinsics };
        let instance = |i: usize| -> Result<Instance, FormatError> {
            let (gt, info) = (&records.gt[i], &records.gt_info[i]);
            let place = format!("{name}.mask_visib.json: instance {i}");
            let mask_visib = decode_mask(&records.mask_visib[i], &frame, &place)?;
            Ok(Instance {
                obj_id: gt.obj_id,
                t_camera_object: gt.pose(&format!("{name}.gt.json: instance {i}"))?,
                visib_fract: info.visib_fract,
                px_count_visib: info.px_count_visib,
                mask_visib,
            })
        };
        let mut instances = (0..records.gt.len()).map(instance).collect::<Result<Vec<_>, _>>()?;
        let faults = instances.iter_mut().enumerate();
        let faults = faults.filter_map(|(i, instance)| {
            let model = models.get(&instance.obj_id);
            Some((i, mend(instance, &frame, model)?))
        });
        let faults = faults.collect();
        Ok((AnnotatedFrame { frame, instances }, faults))
    }
}

/// A mask of the frame's size; one of another size is not decoded.
pub(super) fn decode_mask(rle: &Rle, frame: &RgbdFrame, place: &str) -> Result<Mask, FormatError> {
    let [height, width] = rle.size;
    if (width, height) == (frame.width(), frame.height()) {
        return rle.decode().map_err(|e| e.within(place));
    }
    let (value, expected) =
        (format!("{width} x {height}"), format!("{} x {} as the image", frame.width(), frame.height()));
    Err(FormatError::field(place, "mask size", value, expected))
}

/// Refuses a camera that no depth camera has.
pub(super) fn check_camera(camera: &CameraRecord, place: &str) -> Result<(), FormatError> {
    let camera = camera.check(place)?;
    let scale = camera.depth_scale.ok_or_else(|| FormatError::missing(place, "depth_scale", ""))?;
    if DEPTH_SCALE.contains(&scale) {
        return Ok(());
    }
    let expected = format!("{} to {} mm per unit", DEPTH_SCALE.start(), DEPTH_SCALE.end());
    Err(FormatError::field(place, "depth_scale", scale, expected))
}

/// Refuses lists of different lengths and rotations that are none.
pub(super) fn check_instances(
    gt: &[GtRecord],
    gt_info: &[GtInfoRecord],
    place: &str,
) -> Result<(), FormatError> {
    if gt.len() != gt_info.len() {
        let expected = format!("{} as in gt.json", gt.len());
        return Err(FormatError::field(place, "number of instances", gt_info.len(), expected));
    }
    for (i, gt) in gt.iter().enumerate() {
        gt.pose(&format!("{place}: instance {i}"))?;
    }
    Ok(())
}
