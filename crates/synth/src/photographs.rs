//! A folder of photographs.

use std::path::{Path, PathBuf};

use image::RgbImage;
use rand_chacha::ChaCha8Rng;

use super::{SynthError, random::Draw};

/// Longest side of a photograph in use, pixels.
const LONGEST: u32 = 640;

/// The photographs (jpg, png) below a folder; none for an empty path.
#[derive(Clone, Debug, Default)]
pub(super) struct Photographs {
    files: Vec<PathBuf>,
}

impl Photographs {
    /// Lists them; an error for a folder without any.
    pub fn open(folder: &Path) -> Result<Self, SynthError> {
        let mut files = Vec::new();
        if !folder.as_os_str().is_empty() {
            collect(folder, &mut files)?;
            if files.is_empty() {
                return Err(SynthError::NoPictures { folder: folder.to_owned() });
            }
            files.sort();
        }
        Ok(Self { files })
    }

    /// One of them in `share` of the draws; `None` otherwise, without any, and in place of one that cannot be read.
    pub fn draw(&self, share: f32, rng: &mut ChaCha8Rng) -> Option<RgbImage> {
        if self.files.is_empty() || !rng.chance(share) {
            return None;
        }
        let file = rng.pick(&self.files);
        match image::open(file) {
            Ok(picture) => Some(picture.thumbnail(LONGEST, LONGEST).into_rgb8()),
            Err(error) => {
                tracing::warn!("{}: {error}; a procedural picture takes its place", file.display());
                None
            }
        }
    }
}

fn collect(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), SynthError> {
    let error = |source| SynthError::Io { path: folder.to_owned(), source };
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        if path.is_dir() {
            collect(&path, found)?;
        } else if ["jpg", "jpeg", "png"].contains(&extension.as_str()) {
            found.push(path);
        }
    }
    Ok(())
}
