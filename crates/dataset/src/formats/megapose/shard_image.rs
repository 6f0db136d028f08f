//! One image of a shard, whole.

use image::RgbImage;
use unopose_core::frame::RgbdFrame;

use super::{
    super::{
        AnnotatedFrame, FormatError, Instance,
        bop::{GtInfoRecord, GtRecord},
        camera::CameraRecord,
        image_io::{decode_depth, decode_rgb},
    },
    archive::Archive,
    records::{ImageRecords, MemberKind, from_json, masks_from_json},
};

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
        let (bytes, place) = member(MemberKind::Gt)?;
        let gt: Vec<GtRecord> = from_json(&bytes, &place)?;
        let (bytes, place) = member(MemberKind::GtInfo)?;
        let gt_info: Vec<GtInfoRecord> = from_json(&bytes, &place)?;
        check_counts(gt.len(), gt_info.len(), &place)?;
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

    /// Colour, depth and all instances; images and masks have to agree in size.
    pub fn annotated(self) -> Result<AnnotatedFrame, FormatError> {
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
            let mask_visib = records.mask_visib[i].decode().map_err(|e| e.within(&place))?;
            if (mask_visib.width, mask_visib.height) != (frame.width(), frame.height()) {
                let value = format!("{} x {}", mask_visib.width, mask_visib.height);
                let expected = format!("{} x {} as rgb.jpg", frame.width(), frame.height());
                return Err(FormatError::field(place, "mask size", value, expected));
            }
            Ok(Instance {
                obj_id: gt.obj_id,
                t_camera_object: gt.pose(&format!("{name}.gt.json: instance {i}"))?,
                visib_fract: info.visib_fract,
                px_count_visib: info.px_count_visib,
                mask_visib,
            })
        };
        let instances = (0..records.gt.len()).map(instance).collect::<Result<_, _>>()?;
        Ok(AnnotatedFrame { frame, instances })
    }
}

pub(super) fn check_counts(gt: usize, gt_info: usize, place: &str) -> Result<(), FormatError> {
    if gt == gt_info {
        return Ok(());
    }
    Err(FormatError::field(place, "number of instances", gt_info, format!("{gt} as in gt.json")))
}
