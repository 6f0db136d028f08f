//! The members of one image.

use std::collections::BTreeMap;

use super::super::{
    FormatError,
    bop::{GtInfoRecord, GtRecord},
    camera::CameraRecord,
    rle::Rle,
};

/// What a member `KEY.<extension>` holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) enum MemberKind {
    Camera,
    Depth,
    Gt,
    GtInfo,
    Mask,
    MaskVisib,
    Rgb,
}

impl MemberKind {
    /// In the order in which an image's members are written.
    pub const ALL: [MemberKind; 7] = [
        MemberKind::Camera,
        MemberKind::Depth,
        MemberKind::Gt,
        MemberKind::GtInfo,
        MemberKind::Mask,
        MemberKind::MaskVisib,
        MemberKind::Rgb,
    ];

    /// What follows the key and a dot.
    pub fn extension(self) -> &'static str {
        match self {
            MemberKind::Camera => "camera.json",
            MemberKind::Depth => "depth.png",
            MemberKind::Gt => "gt.json",
            MemberKind::GtInfo => "gt_info.json",
            MemberKind::Mask => "mask.json",
            MemberKind::MaskVisib => "mask_visib.json",
            MemberKind::Rgb => "rgb.jpg",
        }
    }

    /// Splits a member's file name into key and kind. Other encodings of the colour image are taken, too.
    pub(super) fn split(name: &str) -> Option<(&str, MemberKind)> {
        let (key, extension) = name.split_once('.')?;
        let kind = MemberKind::ALL.into_iter().find(|k| k.extension() == extension);
        let kind = kind.or_else(|| ["rgb.png", "rgb.jpeg"].contains(&extension).then_some(MemberKind::Rgb));
        Some((key, kind?))
    }
}

/// The JSON members of one image.
#[derive(Clone, Debug)]
pub struct ImageRecords {
    /// `camera.json`.
    pub camera: CameraRecord,
    /// `gt.json`: one pose per instance.
    pub gt: Vec<GtRecord>,
    /// `gt_info.json`: the visibility of each instance.
    pub gt_info: Vec<GtInfoRecord>,
    /// `mask.json`: the whole silhouette of each instance inside the image; empty when the shard has none.
    pub mask: Vec<Rle>,
    /// `mask_visib.json`: the visible part of each instance.
    pub mask_visib: Vec<Rle>,
}

/// Masks as the file has them: instance index (a string) to RLE.
pub(super) fn masks_to_json(masks: &[Rle]) -> Result<Vec<u8>, serde_json::Error> {
    struct ByIndex<'a>(&'a [Rle]);
    impl serde::Serialize for ByIndex<'_> {
        fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            serializer.collect_map(self.0.iter().enumerate().map(|(i, mask)| (i.to_string(), mask)))
        }
    }
    serde_json::to_vec(&ByIndex(masks))
}

/// The masks of instances `0..count`; `place` names the member.
pub(super) fn masks_from_json(bytes: &[u8], count: usize, place: &str) -> Result<Vec<Rle>, FormatError> {
    let mut by_index: BTreeMap<String, Rle> = from_json(bytes, place)?;
    (0..count)
        .map(|i| {
            let hint = format!("{count} instances in gt.json");
            by_index
                .remove(&i.to_string())
                .ok_or_else(|| FormatError::missing(place, format!("mask {i}"), hint))
        })
        .collect()
}

pub(super) fn from_json<T: serde::de::DeserializeOwned>(bytes: &[u8], place: &str) -> Result<T, FormatError> {
    serde_json::from_slice(bytes).map_err(|source| FormatError::Json { path: place.into(), source })
}
