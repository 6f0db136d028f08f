//! Pictures of textures.

use std::{io::Cursor, path::Path, sync::Arc};

use image::{ImageReader, Limits, RgbImage};

use super::file::read_regular;

/// What the pictures of one mesh may take together, bytes of RGB; scans have four of 8192 x 8192.
const MOST_BYTES: u64 = 1 << 30;

/// Reads the pictures of one mesh. One that cannot be read is reported in the log and left out.
pub(super) struct Pictures<'a> {
    mesh: &'a Path,
    /// Bytes that may still be used.
    left: u64,
}

impl<'a> Pictures<'a> {
    pub fn of(mesh: &'a Path) -> Self {
        Self { mesh, left: MOST_BYTES }
    }

    pub fn open(&mut self, path: &Path) -> Option<Arc<RgbImage>> {
        self.decode(read_regular(path), &path.display().to_string())
    }

    /// Decodes the bytes of a file, or reports why there are none.
    pub fn decode<B: AsRef<[u8]>>(&mut self, bytes: Result<B, String>, name: &str) -> Option<Arc<RgbImage>> {
        match bytes.and_then(|bytes| self.rgb(bytes.as_ref())) {
            Ok(picture) => {
                self.left = self.left.saturating_sub(picture.as_raw().len() as u64);
                Some(Arc::new(picture))
            }
            Err(reason) => {
                tracing::warn!("{}: texture {name}: {reason}; loaded without it", self.mesh.display());
                None
            }
        }
    }

    fn rgb(&self, bytes: &[u8]) -> Result<RgbImage, String> {
        let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
        let mut reader = reader.map_err(|e| e.to_string())?;
        if reader.format().is_none() {
            return Err("not a picture, expected PNG, JPEG, WebP, TIFF or BMP".to_owned());
        }
        let mut limits = Limits::default();
        limits.max_alloc = Some(self.left);
        reader.limits(limits);
        Ok(reader.decode().map_err(|e| e.to_string())?.to_rgb8())
    }
}
