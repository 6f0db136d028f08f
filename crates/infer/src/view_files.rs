//! An RGB-D view from its files, checked so that a message names the file that is wrong.

use std::path::{Path, PathBuf};

use unopose_core::frame::{Mask, RgbdFrame, Undistortion};
use unopose_dataset::formats::{
    FormatError,
    camera::read_camera_scaled,
    image_io::{MaskValue, read_depth_by, read_mask_value, read_rgb, size_before_orientation},
};

const COLOR_EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "webp"];
const DEPTH_EXTENSIONS: [&str; 7] = ["png", "tif", "tiff", "npy", "exr", "pfm", "pgm"];
const MASK_EXTENSIONS: [&str; 9] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "webp", "npy", "pgm"];

/// Files of one view.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewFiles {
    /// Colour image.
    pub rgb: PathBuf,
    /// Depth image, registered to the colour image.
    pub depth: PathBuf,
    /// One mask per instance.
    pub masks: Vec<PathBuf>,
    /// A camera file of any form ([`unopose_dataset::formats::camera`]). What a lens's distortion did to the images is undone.
    pub camera: PathBuf,
    /// Millimetres per unit of the depth image, for camera files that do not say.
    pub depth_scale: Option<f64>,
}

/// What a view is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewRole {
    /// The object is learnt from it: a mask without background says nothing about the object and is an error.
    Reference,
    /// The object is looked for in it: a mask without background is warned about.
    Query,
}

/// A view in memory, with the masks in the order of the files.
#[derive(Clone, Debug)]
pub struct View {
    /// Colour, depth and intrinsics.
    pub frame: RgbdFrame,
    /// As large as the frame.
    pub masks: Vec<Mask>,
    /// Millimetres per unit of the depth image's file, where it has a unit of its own.
    pub depth_scale: Option<f64>,
}

impl ViewFiles {
    /// Those of a folder with one view: `rgb.EXT`, `depth.EXT`, `camera.json` and the masks of the given names, `mask_NAME.EXT`,
    /// each with one of the extensions that are read.
    pub fn in_folder(folder: &Path, masks: &[&str]) -> Result<Self, FormatError> {
        let one = |name: &str, extensions: &[&str]| {
            let files = files_of(folder, extensions)?;
            let found = files.into_iter().find(|(stem, _)| stem == name).map(|(_, path)| path);
            found.ok_or_else(|| {
                FormatError::missing(folder.display(), format!("{name}.{}", extensions.join("|")), "")
            })
        };
        Ok(Self {
            rgb: one("rgb", &COLOR_EXTENSIONS)?,
            depth: one("depth", &DEPTH_EXTENSIONS)?,
            masks: masks
                .iter()
                .map(|name| one(&format!("mask_{name}"), &MASK_EXTENSIONS))
                .collect::<Result<_, _>>()?,
            camera: folder.join("camera.json"),
            depth_scale: None,
        })
    }

    /// Reads everything as a query; depth and masks must be as large as the colour image, masks not empty.
    pub fn read(&self) -> Result<View, FormatError> {
        self.read_as(ViewRole::Query, None)
    }

    /// [`Self::read`] for a role; with a value, masks are label maps, and the pixels with this value the object.
    pub fn read_as(&self, role: ViewRole, mask_value: Option<MaskValue>) -> Result<View, FormatError> {
        let camera = read_camera_scaled(&self.camera, self.depth_scale)?;
        let rgb = read_rgb(&self.rgb)?;
        let mut depth_scale = None;
        let depth = read_depth_by(&self.depth, || {
            camera.require_depth_scale(&self.camera).inspect(|&scale| depth_scale = Some(scale))
        })?;
        let size = |(w, h)| format!("{w} x {h}");
        let check = |path: &Path, field, other| {
            if other == rgb.dimensions() {
                return Ok(());
            }
            let turned = size_before_orientation(&self.rgb).map(|stored| {
                format!(
                    ", whose EXIF orientation turns it from {}: turn the other images and the camera as well, or remove \
                     the orientation",
                    size(stored)
                )
            });
            let like = format!("{} like {}", size(rgb.dimensions()), self.rgb.display());
            Err(FormatError::field(path.display(), field, size(other), like + &turned.unwrap_or_default()))
        };
        check(&self.depth, "depth image size", (depth.width, depth.height))?;
        camera.check_size(&self.camera.display().to_string(), rgb.dimensions())?;
        let read = |path: &PathBuf| {
            let mask = read_mask_value(path, mask_value)?;
            check(path, "mask size", (mask.width, mask.height))?;
            if mask.count() == 0 {
                let expected = "at least one pixel of the object above 0";
                return Err(FormatError::field(path.display(), "mask", "empty", expected));
            }
            match role {
                ViewRole::Reference if mask.is_full() => {
                    let expected = "the object's pixels alone, with background around them";
                    return Err(FormatError::field(path.display(), "mask", "the whole image", expected));
                }
                ViewRole::Query if mask.is_full() => {
                    tracing::warn!(
                        "{}: the mask covers the whole image, expected the object's pixels",
                        path.display()
                    );
                }
                _ => {}
            }
            Ok(mask)
        };
        let masks = self.masks.iter().map(read).collect::<Result<_, _>>()?;
        let lens = camera.undistortion(&self.camera.display().to_string(), rgb.dimensions())?;
        let frame = RgbdFrame { rgb, depth, intrinsics: camera.intrinsics };
        let view = View { frame, masks, depth_scale };
        match lens {
            None => Ok(view),
            Some(lens) => self.undistorted(&view, &lens),
        }
    }

    fn undistorted(&self, view: &View, lens: &Undistortion) -> Result<View, FormatError> {
        tracing::info!("{}: the lens's distortion is undone", self.rgb.display());
        let masks: Vec<Mask> = view.masks.iter().map(|mask| lens.mask(mask)).collect();
        if let Some(index) = masks.iter().position(|mask| mask.count() == 0) {
            let expected = format!("pixels inside the undistorted image of {}", self.camera.display());
            return Err(FormatError::field(self.masks[index].display(), "mask", "outside", expected));
        }
        Ok(View { frame: view.frame.undistorted(lens), masks, depth_scale: view.depth_scale })
    }
}

/// The views of a folder `{rgb,depth,mask}/` by name, sorted: `rgb/NAME.png|jpg|webp|...`, `depth/NAME.png|tif|npy|exr|...`, masks
/// `mask/NAME.png` or, for several instances, `mask/NAME_*.png`. In a folder without `mask/` no view has masks. The camera is
/// the folder's own `camera.json`, or else `camera`; `depth_scale` is for camera files that have none, millimetres per unit.
pub fn query_folder(
    folder: &Path,
    camera: &Path,
    depth_scale: Option<f64>,
) -> Result<Vec<(String, ViewFiles)>, FormatError> {
    let own = folder.join("camera.json");
    let camera = if own.is_file() { own } else { camera.to_path_buf() };
    let colors = files_of(&folder.join("rgb"), &COLOR_EXTENSIONS)?;
    let (depths, masks) = (folder.join("depth"), folder.join("mask"));
    let depth_files = files_of(&depths, &DEPTH_EXTENSIONS)?;
    let masked = masks.is_dir();
    let mask_files = if masked { files_of(&masks, &MASK_EXTENSIONS)? } else { Vec::new() };
    if colors.is_empty() {
        let hint = "expected rgb/NAME.png, depth/NAME.png, mask/NAME.png or mask/NAME_*.png";
        return Err(FormatError::missing(folder.display(), "colour image", hint));
    }
    let names: Vec<&String> = colors.iter().map(|(name, _)| name).collect();
    let view = |(name, rgb): &(String, PathBuf)| {
        let depth = match depth_files.iter().filter(|(other, _)| other == name).collect::<Vec<_>>().as_slice()
        {
            [(_, path)] => path.clone(),
            [] => {
                let missing = format!("{name}.{}", DEPTH_EXTENSIONS.join("|"));
                return Err(FormatError::missing(depths.display(), missing, ""));
            }
            // One may be a preview of the other.
            several => {
                let files: Vec<_> = several.iter().map(|(_, path)| path.display().to_string()).collect();
                let field = format!("depth of {name}");
                return Err(FormatError::field(depths.display(), field, files.join(", "), "one file"));
            }
        };
        // `a_1` may be an instance of `a`, or an image of its own.
        let is_of = |mask: &String| {
            mask == name
                || (mask.strip_prefix(name.as_str()).is_some_and(|rest| rest.starts_with('_'))
                    && !names.contains(&mask))
        };
        let masks_of: Vec<PathBuf> =
            mask_files.iter().filter(|(mask, _)| is_of(mask)).map(|(_, path)| path.clone()).collect();
        if masked && masks_of.is_empty() {
            let missing = format!("{name}.png or {name}_*.png");
            return Err(FormatError::missing(masks.display(), missing, ""));
        }
        let camera = camera.clone();
        Ok((name.clone(), ViewFiles { rgb: rgb.clone(), depth, masks: masks_of, camera, depth_scale }))
    };
    colors.iter().map(view).collect()
}

/// Files of a folder by name without extension, sorted.
fn files_of(folder: &Path, extensions: &[&str]) -> Result<Vec<(String, PathBuf)>, FormatError> {
    let entries = std::fs::read_dir(folder).map_err(|e| FormatError::io(folder, e))?;
    let mut files = Vec::new();
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        if !extensions.contains(&extension.as_str()) || !path.is_file() {
            continue;
        }
        // The name becomes that of a folder of results.
        match path.file_stem().and_then(|stem| stem.to_str()) {
            Some(name) => files.push((name.to_owned(), path)),
            None => return Err(FormatError::field(folder.display(), "file name", path.display(), "UTF-8")),
        }
    }
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use unopose_core::frame::DepthMap;
    use unopose_dataset::formats::image_io::{write_depth, write_mask, write_rgb};

    use super::*;

    /// 4 x 3 pixels of a view, 0.75 m away, with a mask of one pixel.
    fn view(folder: &Path) -> ViewFiles {
        let at = |name: &str| folder.join(name);
        write_rgb(&at("rgb.png"), &image::RgbImage::new(4, 3)).unwrap();
        write_depth(&at("depth.png"), &DepthMap { width: 4, height: 3, data: vec![0.75; 12] }, 1.0).unwrap();
        let mut mask = Mask::empty(4, 3);
        mask.data[5] = true;
        write_mask(&at("mask.png"), &mask).unwrap();
        std::fs::write(at("k.json"), r#"{"fx": 9, "fy": 9, "cx": 2, "cy": 1.5, "depth_scale": 1.0}"#)
            .unwrap();
        ViewFiles {
            rgb: at("rgb.png"),
            depth: at("depth.png"),
            masks: vec![at("mask.png")],
            camera: at("k.json"),
            depth_scale: None,
        }
    }

    #[test]
    fn a_mask_of_the_whole_image_is_no_reference() {
        let folder = tempfile::tempdir().unwrap();
        let files = view(folder.path());
        let read = files.read_as(ViewRole::Reference, None).unwrap();
        assert_eq!((read.masks[0].count(), read.frame.depth.data[0]), (1, 0.75));
        write_mask(&files.masks[0], &Mask { width: 4, height: 3, data: vec![true; 12] }).unwrap();
        assert_eq!(files.read().unwrap().masks[0].count(), 12);
        let message = files.read_as(ViewRole::Reference, None).unwrap_err().to_string();
        assert!(message.contains("mask.png: mask is the whole image"), "{message}");
        write_mask(&files.masks[0], &Mask::empty(4, 3)).unwrap();
        assert!(files.read().unwrap_err().to_string().contains("mask is empty"));
    }

    #[test]
    fn a_value_chooses_the_object_of_a_label_map() {
        let folder = tempfile::tempdir().unwrap();
        let files = view(folder.path());
        let labels = image::GrayImage::from_fn(4, 3, |x, _| image::Luma([[0, 2, 9, 9][x as usize]]));
        labels.save(&files.masks[0]).unwrap();
        let message = files.read().unwrap_err().to_string();
        assert!(message.contains("mask values is 2, 9") && message.contains("--mask-value N"), "{message}");
        let read = files.read_as(ViewRole::Query, Some(MaskValue::Number(2))).unwrap();
        assert_eq!(read.masks[0].pixels().collect::<Vec<_>>(), [(1, 0), (1, 1), (1, 2)]);
    }

    #[test]
    fn depth_in_metres_needs_no_scale() {
        let folder = tempfile::tempdir().unwrap();
        let mut files = view(folder.path());
        std::fs::write(&files.camera, r#"{"fx": 9, "fy": 9, "cx": 2, "cy": 1.5}"#).unwrap();
        let message = files.read().unwrap_err().to_string();
        assert!(message.contains("k.json: depth_scale not found"), "{message}");
        files.depth = folder.path().join("depth.pfm");
        let pixels = 0.75f32.to_le_bytes().repeat(12);
        std::fs::write(&files.depth, [b"Pf 4 3 -1\n", pixels.as_slice()].concat()).unwrap();
        assert_eq!(files.read().unwrap().frame.depth.data, [0.75; 12]);
    }

    #[test]
    fn an_orientation_that_contradicts_the_depth_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let files = view(folder.path());
        let mut png = Vec::new();
        let mut encoder = image::codecs::png::PngEncoder::new(&mut png);
        // EXIF with one entry: orientation 6, a quarter turn.
        let exif = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
        image::ImageEncoder::set_exif_metadata(&mut encoder, exif.to_vec()).unwrap();
        let rgb = image::ExtendedColorType::Rgb8;
        image::ImageEncoder::write_image(encoder, &[0; 36], 4, 3, rgb).unwrap();
        std::fs::write(&files.rgb, png).unwrap();
        let message = files.read().unwrap_err().to_string();
        assert!(message.contains("depth.png: depth image size is 4 x 3, expected 3 x 4 like"), "{message}");
        assert!(message.contains("EXIF orientation turns it from 4 x 3"), "{message}");
    }

    #[test]
    fn distorted_views_become_those_of_a_pinhole_camera() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let (mut rgb, mut depth) = (image::RgbImage::new(64, 48), DepthMap::zeros(64, 48));
        let mut mask = Mask::empty(64, 48);
        // 20 pixels right of the principal point, x' = 0.4 = x (1 + 0.5 x^2): x = 0.374, 18.7 pixels in the pinhole image.
        rgb.put_pixel(52, 24, image::Rgb([255; 3]));
        depth.data[24 * 64 + 52] = 0.7;
        mask.data[24 * 64 + 52] = true;
        write_rgb(&at("rgb.png"), &rgb).unwrap();
        write_depth(&at("depth.png"), &depth, 0.1).unwrap();
        write_mask(&at("mask.png"), &mask).unwrap();
        let camera = |name: &str, more: &str| {
            std::fs::write(at(name), format!("K: [50, 0, 32, 0, 50, 24, 0, 0, 1]\n{more}")).unwrap();
        };
        camera("k.yaml", "D: [0.5, 0, 0, 0, 0]\ndistortion_model: plumb_bob\n");
        let mut files = ViewFiles {
            rgb: at("rgb.png"),
            depth: at("depth.png"),
            masks: vec![at("mask.png")],
            camera: at("k.yaml"),
            depth_scale: Some(0.1),
        };
        let view = files.read().unwrap();
        assert_eq!(view.masks[0].pixels().collect::<Vec<_>>(), [(51, 24)]);
        assert_eq!((view.frame.depth.get(51, 24), view.frame.depth.get(52, 24)), (0.7, 0.0));
        assert!(view.frame.rgb.get_pixel(51, 24).0[0] > 100 && view.frame.rgb.get_pixel(52, 24).0[0] < 60);
        camera("fisheye.yaml", "D: [0, 0, 0, 0]\ndistortion_model: equidistant\n");
        camera("size.yaml", "width: 640\nheight: 480\n");
        for (name, part) in [
            ("fisheye.yaml", "fisheye.yaml: distortion_model is \"equidistant\""),
            ("size.yaml", "size.yaml: image size is 640 x 480, expected 64 x 48"),
        ] {
            let message = ViewFiles { camera: at(name), ..files.clone() }.read().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        files.depth_scale = None;
        let message = files.read().unwrap_err().to_string();
        assert!(message.contains("depth_scale not found") && message.contains("--depth-scale"), "{message}");
    }

    #[test]
    fn a_folder_lists_views_with_their_instances() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for file in [
            "rgb/a.png",
            "rgb/a_2.jpg",
            "depth/a.png",
            "depth/a_2.png",
            "mask/a_0.png",
            "mask/a_1.png",
            "mask/a_2.png",
        ] {
            std::fs::create_dir_all(at(file).parent().unwrap()).unwrap();
            std::fs::write(at(file), b"").unwrap();
        }
        let views = query_folder(folder.path(), Path::new("k.json"), None).unwrap();
        let names: Vec<&str> = views.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["a", "a_2"]);
        assert_eq!(views[0].1.masks, [at("mask/a_0.png"), at("mask/a_1.png")]);
        assert_eq!((&views[1].1.masks, &views[1].1.rgb), (&vec![at("mask/a_2.png")], &at("rgb/a_2.jpg")));
        assert_eq!(views[0].1.camera, Path::new("k.json"));
        std::fs::remove_file(at("mask/a_2.png")).unwrap();
        let message = query_folder(folder.path(), Path::new("k.json"), None).unwrap_err().to_string();
        assert!(message.contains("mask") && message.contains("a_2.png or a_2_*.png"), "{message}");
        std::fs::remove_dir_all(at("mask")).unwrap();
        let views = query_folder(folder.path(), Path::new("k.json"), None).unwrap();
        assert!(views.len() == 2 && views.iter().all(|(_, files)| files.masks.is_empty()));
        std::fs::write(at("depth/a.npy"), b"").unwrap();
        let message = query_folder(folder.path(), Path::new("k.json"), None).unwrap_err().to_string();
        assert!(message.contains("a.npy") && message.contains("a.png, expected one file"), "{message}");
        std::fs::remove_file(at("depth/a.npy")).unwrap();
        std::fs::write(at("camera.json"), b"{}").unwrap();
        std::fs::remove_file(at("depth/a_2.png")).unwrap();
        let message = query_folder(folder.path(), Path::new("k.json"), None).unwrap_err().to_string();
        assert!(message.contains("depth") && message.contains("a_2.png"), "{message}");
    }
}
