//! Writing shards.

use std::path::{Path, PathBuf};

use image::RgbImage;
use unopose_core::{files::write_atomic, frame::DepthMap};

use super::{
    super::{
        FormatError,
        camera::BOP_DEPTH_SCALE,
        image_io::{encode_depth, encode_jpeg},
    },
    records::{ImageRecords, MemberKind, masks_to_json},
};

/// `shard-NNNNNN.tar`.
pub fn shard_file_name(number: u32) -> String {
    format!("shard-{number:06}.tar")
}

/// The members of one image as bytes.
#[derive(Clone, Debug)]
pub struct EncodedImage {
    key: String,
    members: Vec<(MemberKind, Vec<u8>)>,
}

impl EncodedImage {
    /// Encodes an image; depth is stored in the camera record's `depth_scale`, BOP's where it has none.
    pub fn new(
        key: &str,
        rgb: &RgbImage,
        jpeg_quality: u8,
        depth: &DepthMap,
        records: &ImageRecords,
    ) -> Result<Self, FormatError> {
        let picture = |source| FormatError::Image { path: PathBuf::from(key), source };
        let json = |source| FormatError::Json { path: PathBuf::from(key), source };
        let member = |kind| -> Result<(MemberKind, Vec<u8>), FormatError> {
            let bytes = match kind {
                MemberKind::Camera => serde_json::to_vec(&records.camera).map_err(json)?,
                MemberKind::Depth => {
                    encode_depth(depth, records.camera.depth_scale.unwrap_or(BOP_DEPTH_SCALE))
                        .map_err(picture)?
                }
                MemberKind::Gt => serde_json::to_vec(&records.gt).map_err(json)?,
                MemberKind::GtInfo => serde_json::to_vec(&records.gt_info).map_err(json)?,
                MemberKind::Mask => masks_to_json(&records.mask).map_err(json)?,
                MemberKind::MaskVisib => masks_to_json(&records.mask_visib).map_err(json)?,
                MemberKind::Rgb => encode_jpeg(rgb, jpeg_quality).map_err(picture)?,
            };
            Ok((kind, bytes))
        };
        let members = MemberKind::ALL.into_iter().map(member).collect::<Result<_, _>>()?;
        Ok(Self { key: key.to_owned(), members })
    }
}

/// Collects the images of one shard and writes them in one go.
#[derive(Debug, Default)]
pub struct ShardWriter {
    images: Vec<EncodedImage>,
}

impl ShardWriter {
    /// Adds an image; the order stays.
    pub fn push(&mut self, image: EncodedImage) {
        self.images.push(image);
    }

    /// Writes the tar through a temporary file. The same images give the same bytes: no times, users or groups.
    pub fn write(self, path: &Path) -> Result<(), FormatError> {
        let written = write_atomic(path, |file| {
            let mut tar = tar::Builder::new(file);
            for image in &self.images {
                for (kind, bytes) in &image.members {
                    let mut header = tar::Header::new_ustar();
                    header.set_size(bytes.len() as u64);
                    header.set_mode(0o444);
                    header.set_mtime(0);
                    let name = format!("{}.{}", image.key, kind.extension());
                    tar.append_data(&mut header, name, bytes.as_slice())?;
                }
            }
            tar.finish()
        });
        Ok(written?)
    }
}
