//! Depth images in metres.

use std::path::Path;

use unopose_core::frame::DepthMap;

use super::{
    FormatError, MM_PER_METRE,
    decode::read_bytes,
    samples::{Samples, Values, samples},
};

/// Metres from which floats are no measurement: the largest 16-bit float, and what renderers write where nothing is.
const FAR: f32 = 65504.0;
/// Median depth in metres above which floats are millimetres. No depth camera reaches so far.
const MAX_MEDIAN: f32 = 50.0;

/// Depth in metres. Integers of 16 bits and more (png, tiff, pgm, npy) are `depth_scale_to_mm` millimetres each, floats (tiff,
/// OpenEXR, npy, pfm) are metres. No measurement: 0 and 65535, negative, NaN and infinite values.
pub fn read_depth(path: &Path, depth_scale_to_mm: f64) -> Result<DepthMap, FormatError> {
    read_depth_by(path, || Ok(depth_scale_to_mm))
}

/// [`read_depth`] with a scale that is asked for only where the file has integers.
pub fn read_depth_by(
    path: &Path,
    depth_scale_to_mm: impl FnOnce() -> Result<f64, FormatError>,
) -> Result<DepthMap, FormatError> {
    depth_from(&read_bytes(path)?, path, depth_scale_to_mm)
}

/// [`read_depth`] of bytes in memory; `name` stands for the file in messages.
pub(in super::super) fn decode_depth(
    bytes: &[u8],
    name: &str,
    depth_scale_to_mm: f64,
) -> Result<DepthMap, FormatError> {
    depth_from(bytes, Path::new(name), || Ok(depth_scale_to_mm))
}

fn depth_from(
    bytes: &[u8],
    path: &Path,
    depth_scale_to_mm: impl FnOnce() -> Result<f64, FormatError>,
) -> Result<DepthMap, FormatError> {
    let wrong_type = |value: String| {
        let expected = "16-bit gray or floats; an image of 8 bits is a preview, whose distances are lost";
        FormatError::field(path.display(), "depth pixel type", value, expected)
    };
    let Samples { width, height, values } =
        samples(bytes, path)?.map_err(|image| wrong_type(format!("{:?}", image.color())))?;
    let data = match values {
        Values::Integers(_, bits @ ..=8) => return Err(wrong_type(format!("integers of {bits} bits"))),
        Values::Integers(values, _) => {
            let scale = depth_scale_to_mm()?;
            if !(scale.is_finite() && scale > 0.0) {
                return Err(FormatError::field(
                    path.display(),
                    "depth_scale",
                    scale,
                    "a finite number above 0",
                ));
            }
            // Cameras write the largest number where nothing was measured.
            let metres = |value: u32| match value {
                0xffff | u32::MAX => 0.0,
                value => (f64::from(value) * scale / MM_PER_METRE) as f32,
            };
            values.into_iter().map(metres).collect()
        }
        Values::Floats(mut values) => {
            for z in values.iter_mut().filter(|z| !(**z > 0.0 && **z < FAR)) {
                *z = 0.0;
            }
            check_metres(&values, path)?;
            values
        }
    };
    Ok(DepthMap { width, height, data })
}

fn check_metres(values: &[f32], path: &Path) -> Result<(), FormatError> {
    let mut measured: Vec<f32> = values.iter().copied().filter(|&z| z > 0.0).collect();
    if measured.is_empty() {
        return Ok(());
    }
    let middle = measured.len() / 2;
    let median = *measured.select_nth_unstable_by(middle, f32::total_cmp).1;
    if median <= MAX_MEDIAN {
        return Ok(());
    }
    let expected = format!(
        "at most {MAX_MEDIAN} m: floats are metres whatever depth_scale says, these look like millimetres; divide them by \
         1000, or store them as 16-bit integers"
    );
    Err(FormatError::field(path.display(), "median depth", median, expected))
}
