//! An RGB-D view from its files, checked so that a message names the file that is wrong.

use std::path::{Path, PathBuf};

use unopose_core::frame::{Mask, RgbdFrame, Undistortion};
use unopose_dataset::formats::{
    FormatError,
    camera::read_camera_scaled,
    image_io::{read_depth, read_mask, read_rgb},
};

const COLOR_EXTENSIONS: [&str; 5] = ["png", "jpg", "jpeg", "tif", "tiff"];
const DEPTH_EXTENSIONS: [&str; 3] = ["png", "tif", "tiff"];

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

/// A view in memory, with the masks in the order of the files.
#[derive(Clone, Debug)]
pub struct View {
    /// Colour, depth and intrinsics.
    pub frame: RgbdFrame,
    /// As large as the frame.
    pub masks: Vec<Mask>,
}

impl ViewFiles {
    /// Reads everything; depth and masks must be as large as the colour image, masks not empty.
    pub fn read(&self) -> Result<View, FormatError> {
        let camera = read_camera_scaled(&self.camera, self.depth_scale)?;
        let rgb = read_rgb(&self.rgb)?;
        let depth = read_depth(&self.depth, camera.require_depth_scale(&self.camera)?)?;
        camera.check_size(&self.camera.display().to_string(), rgb.dimensions())?;
        let check = |path: &Path, field, width, height| {
            let size = |(w, h)| format!("{w} x {h}");
            if (width, height) == rgb.dimensions() {
                return Ok(());
            }
            let expected = format!("{} like {}", size(rgb.dimensions()), self.rgb.display());
            Err(FormatError::field(path.display(), field, size((width, height)), expected))
        };
        check(&self.depth, "depth image size", depth.width, depth.height)?;
        let read = |path: &PathBuf| {
            let mask = read_mask(path)?;
            check(path, "mask size", mask.width, mask.height)?;
            if mask.count() == 0 {
                let expected = "at least one pixel of the object above 0";
                return Err(FormatError::field(path.display(), "mask", "empty", expected));
            }
            Ok(mask)
        };
        let masks = self.masks.iter().map(read).collect::<Result<_, _>>()?;
        let lens = camera.undistortion(&self.camera.display().to_string(), rgb.dimensions())?;
        let view = View { frame: RgbdFrame { rgb, depth, intrinsics: camera.intrinsics }, masks };
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
        Ok(View { frame: view.frame.undistorted(lens), masks })
    }
}

/// The views of a folder `{rgb,depth,mask}/` by name, sorted: `rgb/NAME.png|jpg`, `depth/NAME.png|tif`, masks
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
    let mask_files = if masked { files_of(&masks, &COLOR_EXTENSIONS)? } else { Vec::new() };
    if colors.is_empty() {
        let hint = "expected rgb/NAME.png, depth/NAME.png, mask/NAME.png or mask/NAME_*.png";
        return Err(FormatError::missing(folder.display(), "colour image", hint));
    }
    let names: Vec<&String> = colors.iter().map(|(name, _)| name).collect();
    let view = |(name, rgb): &(String, PathBuf)| {
        let depth = depth_files.iter().find(|(other, _)| other == name).map(|(_, path)| path.clone());
        let depth = depth.ok_or_else(|| {
            FormatError::missing(depths.display(), format!("{name}.{}", DEPTH_EXTENSIONS.join("|")), "")
        })?;
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
    let mut files: Vec<(String, PathBuf)> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let extension = path.extension()?.to_str()?.to_ascii_lowercase();
            let name = path.file_stem()?.to_str()?.to_owned();
            (extensions.contains(&extension.as_str()) && path.is_file()).then_some((name, path))
        })
        .collect();
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use unopose_core::frame::DepthMap;
    use unopose_dataset::formats::image_io::{write_depth, write_mask, write_rgb};

    use super::*;

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
        std::fs::write(at("camera.json"), b"{}").unwrap();
        std::fs::remove_file(at("depth/a_2.png")).unwrap();
        let message = query_folder(folder.path(), Path::new("k.json"), None).unwrap_err().to_string();
        assert!(message.contains("depth") && message.contains("a_2.png"), "{message}");
    }
}
