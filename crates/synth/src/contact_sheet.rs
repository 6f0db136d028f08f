//! A picture of samples to look at: colour with visible outlines and axes, and depth.

use std::path::Path;

use image::{Rgb, RgbImage};
use nalgebra::Point3;
use unopose_core::frame::Mask;
use unopose_dataset::formats::{AnnotatedFrame, FormatError, image_io::write_rgb};

use super::SynthError;

/// Outline colours by instance.
const COLORS: [[u8; 3]; 8] = [
    [255, 64, 64],
    [64, 255, 64],
    [80, 128, 255],
    [255, 220, 0],
    [255, 0, 255],
    [0, 255, 255],
    [255, 140, 0],
    [190, 130, 255],
];

/// Writes `columns` x `rows` of a set's `count` images, spread over the set.
pub fn contact_sheet(
    count: usize,
    load: &dyn Fn(usize) -> Result<AnnotatedFrame, FormatError>,
    file: &Path,
    [columns, rows]: [u32; 2],
) -> Result<(), SynthError> {
    let shown = (columns * rows).min(count as u32);
    let mut sheet = RgbImage::new(1, 1);
    for k in 0..shown {
        let tile = tile(&load(k as usize * count / shown as usize)?);
        if k == 0 {
            sheet = RgbImage::new(tile.width() * columns, tile.height() * rows);
        }
        let (x, y) = ((k % columns) * tile.width(), (k / columns) * tile.height());
        image::imageops::replace(&mut sheet, &tile, x.into(), y.into());
    }
    Ok(write_rgb(file, &sheet)?)
}

/// Colour beside depth.
fn tile(annotated: &AnnotatedFrame) -> RgbImage {
    let frame = &annotated.frame;
    let mut rgb = frame.rgb.clone();
    for (i, instance) in annotated.instances.iter().enumerate() {
        outline(&mut rgb, &instance.mask_visib, COLORS[i % COLORS.len()]);
    }
    for instance in annotated.instances.iter().filter(|i| i.visib_fract > 0.1) {
        for axis in 0..3 {
            for step in 0..60 {
                let mut p = Point3::origin();
                p[axis] = 0.04 * f64::from(step) / 60.0;
                let mut color = [0; 3];
                color[axis] = 255;
                if let Some(uv) = frame.intrinsics.project(&instance.t_camera_object.transform(&p)) {
                    put(&mut rgb, uv.x.round() as i64, uv.y.round() as i64, color);
                }
            }
        }
    }
    let (w, h) = (rgb.width(), rgb.height());
    let mut tile = RgbImage::new(2 * w, h);
    image::imageops::replace(&mut tile, &rgb, 0, 0);
    let measured: Vec<f32> = frame.depth.data.iter().copied().filter(|&z| z > 0.0).collect();
    let (near, far) = measured.iter().fold((f32::MAX, 0f32), |(a, b), &z| (a.min(z), b.max(z.min(2.0))));
    for row in 0..h {
        for col in 0..w {
            let z = frame.depth.get(col, row);
            if z > 0.0 {
                let t = 1.0 - ((z - near) / (far - near).max(1e-6)).clamp(0.0, 1.0);
                // Fine bands make millimetres visible.
                let band = ((z * 100.0).fract() * 40.0) as u8;
                let v = (30.0 + 180.0 * t) as u8;
                tile.put_pixel(w + col, row, Rgb([v + band, v, 255 - v]));
            }
        }
    }
    tile
}

fn put(picture: &mut RgbImage, x: i64, y: i64, color: [u8; 3]) {
    if (0..i64::from(picture.width())).contains(&x) && (0..i64::from(picture.height())).contains(&y) {
        picture.put_pixel(x as u32, y as u32, Rgb(color));
    }
}

fn outline(picture: &mut RgbImage, mask: &Mask, color: [u8; 3]) {
    for (col, row) in mask.pixels() {
        let border = [(0i64, 1i64), (1, 0), (0, -1), (-1, 0)].into_iter().any(|(dx, dy)| {
            let (x, y) = (i64::from(col) + dx, i64::from(row) + dy);
            let inside = (0..i64::from(mask.width)).contains(&x) && (0..i64::from(mask.height)).contains(&y);
            inside && !mask.get(x as u32, y as u32)
        });
        if border {
            put(picture, col.into(), row.into(), color);
        }
    }
}
