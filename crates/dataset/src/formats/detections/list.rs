//! Lists of masks in the forms of BOP, COCO and Segment Anything.

use std::{
    collections::BTreeMap,
    fmt,
    path::{Path, PathBuf},
};

use serde::{
    Deserialize, Deserializer,
    de::{MapAccess, SeqAccess, Visitor, value::MapAccessDeserializer},
};

use super::{
    super::{FormatError, files::read_json, rle::Rle},
    Detection,
    segmentation::Segmentation,
};

/// A list of masks before it is known which images and objects they are of.
#[derive(Clone, Debug)]
pub struct MaskList {
    path: PathBuf,
    form: &'static str,
    entries: Vec<Entry>,
}

/// A mask of a list.
#[derive(Clone, Copy, Debug)]
pub struct ListedMask<'a> {
    list: &'a MaskList,
    index: usize,
    entry: &'a Entry,
}

#[derive(Clone, Debug, Deserialize)]
struct Entry {
    scene_id: Option<u32>,
    image_id: Option<i64>,
    category_id: Option<u32>,
    bbox: Option<[f64; 4]>,
    score: Option<f64>,
    /// Segment Anything's estimate of the mask's quality.
    predicted_iou: Option<f64>,
    time: Option<f64>,
    segmentation: Option<Segmentation>,
    /// Width and height, where the list of images has them.
    #[serde(skip)]
    size: Option<(u32, u32)>,
}

/// An entry of COCO's `images`.
#[derive(Deserialize)]
struct Image {
    id: i64,
    file_name: Option<PathBuf>,
    width: Option<u32>,
    height: Option<u32>,
    scene_id: Option<u32>,
    im_id: Option<u32>,
}

#[derive(Deserialize)]
struct CocoFile {
    images: Vec<Image>,
    annotations: Vec<Entry>,
}

enum Document {
    List(Vec<Entry>),
    Coco(CocoFile),
}

const BOP: &str = "BOP detections";
const RESULTS: &str = "COCO results";
const COCO: &str = "COCO annotations";
const SAM: &str = "masks of Segment Anything";

impl MaskList {
    /// Reads a list in the order of the file; the form is told by its fields.
    pub fn read(path: &Path) -> Result<Self, FormatError> {
        let (form, entries) = match read_json(path)? {
            Document::Coco(file) => (COCO, coco_entries(file, path)?),
            Document::List(entries) => {
                let form = match entries.first() {
                    Some(entry) if entry.scene_id.is_some() => BOP,
                    Some(entry) if entry.predicted_iou.is_some() && entry.image_id.is_none() => SAM,
                    Some(_) => RESULTS,
                    None => BOP,
                };
                (form, entries)
            }
        };
        let list = Self { path: path.to_owned(), form, entries };
        list.masks().try_for_each(|mask| mask.check())?;
        Ok(list)
    }

    /// In the order of the file.
    pub fn masks(&self) -> impl Iterator<Item = ListedMask<'_>> {
        self.entries.iter().enumerate().map(|(index, entry)| ListedMask { list: self, index, entry })
    }
}

impl ListedMask<'_> {
    /// Scene and image as far as the list names them: masks of one image have the same.
    pub fn image(&self) -> (Option<u32>, Option<i64>) {
        (self.entry.scene_id, self.entry.image_id)
    }

    /// Scene and image of a dataset; an error that says what the list's form lacks.
    pub fn dataset_image(&self) -> Result<(u32, u32), FormatError> {
        let Some(image_id) = self.entry.image_id else {
            let hint = "these are masks of one image of no dataset: --proposals of estimate and of segment --rgb takes them";
            return Err(FormatError::missing(self.place(), "image_id", hint));
        };
        let Some(scene_id) = self.entry.scene_id else {
            let hint = "expected scene_id in every entry, or images with file_name SSSSSS/rgb/IIIIII.png or with scene_id \
                        and im_id";
            return Err(FormatError::missing(self.place(), "scene_id", hint));
        };
        let id = u32::try_from(image_id)
            .map_err(|_| FormatError::field(self.place(), "image_id", image_id, "0 to 4294967295"))?;
        Ok((scene_id, id))
    }

    /// How sure the list is of it; 1 where annotations have no score.
    pub fn score(&self) -> f64 {
        self.entry.score.or(self.entry.predicted_iou).unwrap_or(1.0)
    }

    /// The mask, encoded; polygons are filled in an image of `size` (width, height) where the list has none of its own.
    pub fn rle(&self, size: Option<(u32, u32)>) -> Result<Rle, FormatError> {
        let given = self.entry.segmentation.as_ref().filter(|segmentation| !segmentation.is_absent());
        let segmentation = given.map(|segmentation| segmentation.rle(self.entry.size.or(size)));
        match segmentation.transpose().map_err(|e| e.within(self.place()))? {
            Some(Some(rle)) => Ok(rle),
            Some(None) => Err(FormatError::missing(
                self.place(),
                "size of the image",
                "polygons of an image that is not in the dataset: expected images with width and height",
            )),
            None => Err(FormatError::missing(
                self.place(),
                "segmentation",
                "masks are needed, boxes are not enough",
            )),
        }
    }

    /// As a detection of a dataset; `size` as in [`Self::rle`].
    pub(super) fn detection(
        &self,
        size: impl Fn(u32, u32) -> Option<(u32, u32)>,
    ) -> Result<Detection, FormatError> {
        let (scene_id, image_id) = self.dataset_image()?;
        let missing = |field: &str| {
            let hint = "expected scene_id, image_id, category_id (the object), bbox, score and segmentation";
            FormatError::missing(self.place(), field, hint)
        };
        let filled = match &self.entry.segmentation {
            Some(Segmentation::Polygons(_)) => size(scene_id, image_id),
            _ => None,
        };
        if self.list.form != COCO && self.entry.score.is_none() {
            return Err(missing("score"));
        }
        Ok(Detection {
            scene_id,
            image_id,
            category_id: self.entry.category_id.ok_or_else(|| missing("category_id"))?,
            bbox: self.entry.bbox.ok_or_else(|| missing("bbox"))?,
            score: self.score(),
            time: self.entry.time.unwrap_or(-1.0),
            segmentation: self.rle(filled)?,
        })
    }

    fn check(&self) -> Result<(), FormatError> {
        if !self.score().is_finite() {
            return Err(FormatError::field(self.place(), "score", self.score(), "a finite number"));
        }
        match self.entry.bbox {
            Some(bbox) if !bbox.iter().all(|x| x.is_finite()) || bbox[2] < 0.0 || bbox[3] < 0.0 => {
                let expected = "x, y, width >= 0, height >= 0";
                Err(FormatError::field(self.place(), "bbox", format!("{bbox:?}"), expected))
            }
            _ => Ok(()),
        }
    }

    /// File, entry and form, for messages.
    pub fn place(&self) -> String {
        format!("{}: entry {} of a list of {}", self.list.path.display(), self.index, self.list.form)
    }
}

/// The annotations with the scenes, numbers and sizes of their images.
fn coco_entries(file: CocoFile, path: &Path) -> Result<Vec<Entry>, FormatError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let images: BTreeMap<i64, &Image> = file.images.iter().map(|image| (image.id, image)).collect();
    let resolve = |(index, mut entry): (usize, Entry)| {
        let place = || format!("{}: annotation {index}", path.display());
        let Some(id) = entry.image_id else {
            return Err(FormatError::missing(place(), "image_id", "expected an id of the list of images"));
        };
        let Some(image) = images.get(&id) else {
            let expected = format!("one of the {} ids in images", images.len());
            return Err(FormatError::field(place(), "image_id", id, expected));
        };
        entry.size = image.width.zip(image.height);
        let named = image.file_name.as_ref().and_then(|name| scene_and_image(&folder.join(name)));
        if let Some((scene_id, im_id)) = image.scene_id.zip(image.im_id).or(named) {
            (entry.scene_id, entry.image_id) = (Some(scene_id), Some(im_id.into()));
        }
        Ok(entry)
    };
    file.annotations.into_iter().enumerate().map(resolve).collect()
}

/// Of `.../SSSSSS/FOLDER/IIIIII.png`.
fn scene_and_image(path: &Path) -> Option<(u32, u32)> {
    let number = |text: Option<&std::ffi::OsStr>| text?.to_str()?.parse().ok();
    let scene = path.parent()?.parent()?;
    Some((number(scene.file_name())?, number(path.file_stem())?))
}

impl<'de> Deserialize<'de> for Document {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;
        impl<'de> Visitor<'de> for Forms {
            type Value = Document;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of masks, or an object with images and annotations as of COCO")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Document, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = list.next_element()? {
                    entries.push(entry);
                }
                Ok(Document::List(entries))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Document, A::Error> {
                CocoFile::deserialize(MapAccessDeserializer::new(map)).map(Document::Coco)
            }
        }
        deserializer.deserialize_any(Forms)
    }
}
