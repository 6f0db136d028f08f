//! `doctor.png`: what the program sees, for a person to compare with what is there.

use std::path::Path;

use image::{Rgb, RgbImage, imageops};
use nalgebra::{Rotation3, Vector3};
use unopose_core::frame::{BoundingBox, Mask, MaskedView};
use unopose_eval::report::{
    ReportError,
    overlay::{contact_sheet, write_png},
};

use super::{
    MaskedObject,
    jumps::{Lines, measured},
};

/// Size of a tile.
const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
/// Border of the mask.
const EDGE: Rgb<u8> = Rgb([255, 60, 200]);
/// Borders of surfaces in the depth image.
const JUMP: Rgb<u8> = Rgb([0, 230, 255]);
/// Part of a tile that the object's points fill.
const FILLED: f64 = 0.85;
/// Depth shown, radii of the object before and behind its middle.
const SHOWN: [f64; 2] = [2.0, 4.0];

/// Writes a row of tiles per view: the colour image and the depth image (near red, far blue, black without depth) with the
/// mask's border; the object with the mask's border (pink) and the borders of surfaces in the depth image (cyan); the
/// object's points from its left and from above, with a bar of [`bar_length`].
pub fn write_picture(path: &Path, views: &[MaskedView<'_>]) -> Result<(), ReportError> {
    let tiles: Vec<RgbImage> = views.iter().flat_map(|view| tiles(*view)).collect();
    write_png(path, &contact_sheet(&tiles, 5))
}

/// Length of the bar beside an object's points, metres.
pub fn bar_length(object: &MaskedObject) -> f64 {
    let tenth = 10f64.powf((object.extent[0]).max(1e-6).log10().floor());
    [0.5, 0.2]
        .iter()
        .map(|part| part * tenth)
        .find(|bar| *bar <= 0.4 * object.extent[0])
        .unwrap_or(0.1 * tenth)
}

fn tiles(view: MaskedView<'_>) -> [RgbImage; 5] {
    let (frame, mask) = (view.frame, view.mask);
    let object = MaskedObject::measure(&view.points());
    let mut color = frame.rgb.clone();
    let mut depth = depth_image(view, object.as_ref());
    let thick = (frame.width() / 320).max(1);
    for at in border(mask) {
        dot(&mut color, at, thick, EDGE);
        dot(&mut depth, at, thick, EDGE);
    }
    let whole = BoundingBox { col_min: 0, row_min: 0, col_max: frame.width(), row_max: frame.height() };
    let near = mask.bounding_box().unwrap_or(whole);
    let [left, above] = match &object {
        Some(object) => [
            Rotation3::from_axis_angle(&Vector3::y_axis(), -60f64.to_radians()),
            Rotation3::from_axis_angle(&Vector3::x_axis(), 60f64.to_radians()),
        ]
        .map(|turn| points_image(view, object, &turn)),
        None => [RgbImage::new(WIDTH, HEIGHT), RgbImage::new(WIDTH, HEIGHT)],
    };
    [fitted(&color, &whole), fitted(&depth, &whole), edges(view, &near), left, above]
}

/// The mask's outermost pixels.
fn border(mask: &Mask) -> impl Iterator<Item = (u32, u32)> + '_ {
    let set = |col: u32, row: u32| col < mask.width && row < mask.height && mask.get(col, row);
    mask.pixels().filter(move |&(col, row)| {
        !(set(col.wrapping_sub(1), row)
            && set(col + 1, row)
            && set(col, row.wrapping_sub(1))
            && set(col, row + 1))
    })
}

fn dot(image: &mut RgbImage, (col, row): (u32, u32), side: u32, color: Rgb<u8>) {
    for (c, r) in (0..side).flat_map(|c| (0..side).map(move |r| (col + c, row + r))) {
        if let Some(pixel) = image.get_pixel_mut_checked(c, r) {
            *pixel = color;
        }
    }
}

/// Near red, far blue, around the object.
fn depth_image(view: MaskedView<'_>, object: Option<&MaskedObject>) -> RgbImage {
    let depth = &view.frame.depth;
    let range = object.map(|o| [o.distance - SHOWN[0] * o.radius, o.distance + SHOWN[1] * o.radius]);
    let [near, far] = range.unwrap_or([0.0, 5.0]);
    RgbImage::from_fn(view.frame.width(), view.frame.height(), |col, row| {
        if col >= depth.width || row >= depth.height || !measured(depth.get(col, row)) {
            return Rgb([0; 3]);
        }
        let t = ((f64::from(depth.get(col, row)) - near) / (far - near)).clamp(0.0, 1.0);
        let peak = |center: f64| (255.0 * (1.5 - (4.0 * t - center).abs()).clamp(0.0, 1.0)) as u8;
        Rgb([peak(1.0), peak(2.0), peak(3.0)])
    })
}

/// A part of an image as large as a tile allows, on black.
fn fitted(image: &RgbImage, part: &BoundingBox) -> RgbImage {
    let (width, height) = ((part.col_max - part.col_min).max(1), (part.row_max - part.row_min).max(1));
    let scale = (f64::from(WIDTH) / f64::from(width)).min(f64::from(HEIGHT) / f64::from(height));
    let size = |side: u32, limit: u32| ((f64::from(side) * scale).round() as u32).clamp(1, limit);
    let (w, h) = (size(width, WIDTH), size(height, HEIGHT));
    let cut = imageops::crop_imm(image, part.col_min, part.row_min, width, height).to_image();
    let filter = if scale > 1.0 { imageops::FilterType::Nearest } else { imageops::FilterType::Triangle };
    let mut tile = RgbImage::new(WIDTH, HEIGHT);
    let resized = imageops::resize(&cut, w, h, filter);
    imageops::replace(&mut tile, &resized, i64::from((WIDTH - w) / 2), i64::from((HEIGHT - h) / 2));
    tile
}

/// The object in grey, its mask's border and the borders of surfaces.
fn edges(view: MaskedView<'_>, near: &BoundingBox) -> RgbImage {
    let mut image = RgbImage::from_fn(view.frame.width(), view.frame.height(), |col, row| {
        let [r, g, b] = view.frame.rgb.get_pixel(col, row).0.map(u32::from);
        Rgb([((2 * r + 5 * g + b) / 10) as u8; 3])
    });
    let lines = Lines::of(view.frame);
    for (row, jumps) in (0..).zip(&lines.rows) {
        jumps.iter().for_each(|jump| dot(&mut image, (jump.near as u32, row), 1, JUMP));
    }
    for (col, jumps) in (0..).zip(&lines.columns) {
        jumps.iter().for_each(|jump| dot(&mut image, (col, jump.near as u32), 1, JUMP));
    }
    border(view.mask).for_each(|at| dot(&mut image, at, 1, EDGE));
    let margin = ((near.col_max - near.col_min).max(near.row_max - near.row_min) / 4).max(10);
    let part = BoundingBox {
        col_min: near.col_min.saturating_sub(margin),
        row_min: near.row_min.saturating_sub(margin),
        col_max: (near.col_max + margin).min(image.width()),
        row_max: (near.row_max + margin).min(image.height()),
    };
    fitted(&image, &part)
}

/// The points turned about their middle, in their colours, along the optical axis without perspective.
fn points_image(view: MaskedView<'_>, object: &MaskedObject, turn: &Rotation3<f64>) -> RgbImage {
    let mut tile = RgbImage::from_pixel(WIDTH, HEIGHT, Rgb([24; 3]));
    let k = &view.frame.intrinsics;
    let points: Vec<(Vector3<f64>, Rgb<u8>)> = view
        .frame
        .measured_pixels(view.mask)
        .map(|(col, row, z)| {
            (k.back_project(col.into(), row.into(), z.into()).coords, *view.frame.rgb.get_pixel(col, row))
        })
        .collect();
    let axis = |i: usize| super::object::quantile(points.iter().map(|(p, _)| p[i]).collect(), 0.5);
    let middle = Vector3::new(axis(0), axis(1), axis(2));
    let scale = FILLED * f64::from(HEIGHT) / (2.0 * object.radius).max(1e-9);
    let mut nearest = vec![f64::INFINITY; (WIDTH * HEIGHT) as usize];
    for (point, color) in points {
        let p = turn * (point - middle);
        let at = [p.x * scale + f64::from(WIDTH) / 2.0, p.y * scale + f64::from(HEIGHT) / 2.0];
        for (dc, dr) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (col, row) = (at[0] + dc, at[1] + dr);
            if col < 0.0 || row < 0.0 || col >= f64::from(WIDTH) || row >= f64::from(HEIGHT) {
                continue;
            }
            let slot = &mut nearest[(row as u32 * WIDTH + col as u32) as usize];
            if p.z < *slot {
                *slot = p.z;
                tile.put_pixel(col as u32, row as u32, color);
            }
        }
    }
    let bar = (bar_length(object) * scale) as u32;
    (0..bar).for_each(|col| dot(&mut tile, (10 + col, HEIGHT - 14), 3, Rgb([255; 3])));
    tile
}
