//! Poses drawn onto images: reference points moved into the query's camera, and the axes.

use std::{io::Write, path::Path};

use image::{Rgb, RgbImage};
use nalgebra::{Point3, Vector2, Vector3};
use unopose_core::{
    files::write_atomic,
    frame::Mask,
    geometry::{Intrinsics, Pose},
};

use super::ReportError;

const AXIS_COLORS: [Rgb<u8>; 3] = [Rgb([230, 40, 40]), Rgb([40, 200, 40]), Rgb([60, 90, 255])];

const MASK_COLORS: [Rgb<u8>; 8] = [
    Rgb([255, 170, 0]),
    Rgb([0, 200, 255]),
    Rgb([255, 80, 200]),
    Rgb([140, 255, 60]),
    Rgb([160, 120, 255]),
    Rgb([255, 255, 120]),
    Rgb([255, 90, 80]),
    Rgb([0, 230, 170]),
];

/// Draws `points` (metres, reference camera) moved by `t_query_reference`, each mixed half with what is below it.
fn draw_points(
    image: &mut RgbImage,
    camera: &Intrinsics,
    t_query_reference: &Pose,
    points: &[[f32; 3]],
    color: Rgb<u8>,
) {
    for point in points {
        let [x, y, z] = t_query_reference.transform_f32(point).map(f64::from);
        let Some(pixel) = camera.project(&Point3::new(x, y, z)) else { continue };
        if let Some(below) = pixel_at(image, pixel) {
            for (below, color) in below.0.iter_mut().zip(color.0) {
                *below = ((u16::from(*below) + u16::from(color)) / 2) as u8;
            }
        }
    }
}

/// Draws the reference camera's axes (red x, green y, blue z; `length` metres) at the mean of `points`, moved by
/// `t_query_reference`.
fn draw_axes(
    image: &mut RgbImage,
    camera: &Intrinsics,
    t_query_reference: &Pose,
    points: &[[f32; 3]],
    length: f64,
) {
    let count = points.len().max(1) as f64;
    let sum = points.iter().fold(Vector3::zeros(), |sum, p| sum + Vector3::from(p.map(f64::from)));
    let origin = Point3::from(sum / count);
    for (axis, color) in AXIS_COLORS.into_iter().enumerate() {
        let mut end = origin;
        end[axis] += length;
        let ends = [origin, end].map(|p| camera.project(&t_query_reference.transform(&p)));
        if let [Some(from), Some(to)] = ends {
            draw_line(image, from, to, color);
        }
    }
}

/// The query image with points and axes of one pose; axes are as long as the points' largest distance to their mean.
pub fn pose_overlay(
    rgb: &RgbImage,
    camera: &Intrinsics,
    t_query_reference: &Pose,
    reference_points: &[[f32; 3]],
    color: Rgb<u8>,
) -> RgbImage {
    let mut image = rgb.clone();
    draw_points(&mut image, camera, t_query_reference, reference_points, color);
    draw_axes(&mut image, camera, t_query_reference, reference_points, radius(reference_points));
    image
}

/// The query image in which the reference's surface covers what it hides: every point in its own colour, the nearest on top.
/// Beside the image it shows whether the prints agree.
pub fn painted_overlay(
    rgb: &RgbImage,
    camera: &Intrinsics,
    t_query_reference: &Pose,
    reference_points: &[[f32; 3]],
    colors: &[[u8; 3]],
) -> RgbImage {
    let mut image = rgb.clone();
    let mut nearest = vec![f64::INFINITY; (rgb.width() * rgb.height()) as usize];
    for (point, &color) in reference_points.iter().zip(colors) {
        let [x, y, z] = t_query_reference.transform_f32(point).map(f64::from);
        let Some(pixel) = camera.project(&Point3::new(x, y, z)) else { continue };
        // Two pixels wide: a reference seen from farther away has gaps.
        for offset in [Vector2::zeros(), Vector2::x(), Vector2::y(), Vector2::new(1.0, 1.0)] {
            let at = pixel + offset;
            let index =
                at.y.round().max(0.0) as usize * rgb.width() as usize + at.x.round().max(0.0) as usize;
            if let Some(below) = pixel_at(&mut image, at)
                && z < nearest[index]
            {
                nearest[index] = z;
                *below = Rgb(color);
            }
        }
    }
    image
}

/// The image with masks in colours, the first on top; borders are stronger than insides.
pub fn mask_overlay(rgb: &RgbImage, masks: &[&Mask]) -> RgbImage {
    let mut image = rgb.clone();
    for (index, mask) in masks.iter().enumerate().rev() {
        let color = MASK_COLORS[index % MASK_COLORS.len()];
        let inside = |col: i64, row: i64| {
            col >= 0
                && row >= 0
                && col < i64::from(mask.width)
                && row < i64::from(mask.height)
                && mask.get(col as u32, row as u32)
        };
        for (col, row) in mask.pixels().filter(|&(col, row)| col < rgb.width() && row < rgb.height()) {
            let (c, r) = (i64::from(col), i64::from(row));
            let border = ![(1, 0), (-1, 0), (0, 1), (0, -1)].iter().all(|(dc, dr)| inside(c + dc, r + dr));
            let share = if border { 4 } else { 2 };
            for (below, color) in image.get_pixel_mut(col, row).0.iter_mut().zip(color.0) {
                *below = ((u16::from(*below) * (5 - share) + u16::from(color) * share) / 5) as u8;
            }
        }
    }
    image
}

/// The square part of `image` of side `2 * half` around `center` (column, row), scaled to `side` pixels; black
/// outside.
pub fn cutout(image: &RgbImage, center: (f64, f64), half: f64, side: u32) -> RgbImage {
    RgbImage::from_fn(side, side, |col, row| {
        let offset = |i: u32| ((f64::from(i) + 0.5) / f64::from(side) * 2.0 - 1.0) * half;
        let (x, y) = ((center.0 + offset(col)).round(), (center.1 + offset(row)).round());
        let inside = x >= 0.0 && y >= 0.0 && x < f64::from(image.width()) && y < f64::from(image.height());
        if inside { *image.get_pixel(x as u32, y as u32) } else { Rgb([0, 0, 0]) }
    })
}

/// Tiles of equal size in rows of `columns`, 2 pixels apart.
pub fn contact_sheet(tiles: &[RgbImage], columns: usize) -> RgbImage {
    const GAP: u32 = 2;
    let columns = columns.max(1);
    let (width, height) = tiles.first().map_or((1, 1), |t| t.dimensions());
    let rows = tiles.len().div_ceil(columns).max(1) as u32;
    let mut sheet =
        RgbImage::from_pixel((width + GAP) * columns as u32, (height + GAP) * rows, Rgb([255, 255, 255]));
    for (index, tile) in tiles.iter().enumerate() {
        let (col, row) = ((index % columns) as i64, (index / columns) as i64);
        image::imageops::replace(
            &mut sheet,
            tile,
            col * i64::from(width + GAP),
            row * i64::from(height + GAP),
        );
    }
    sheet
}

/// Writes a PNG, atomically.
pub fn write_png(path: &Path, image: &RgbImage) -> Result<(), ReportError> {
    let mut png = std::io::Cursor::new(Vec::new());
    image
        .write_to(&mut png, image::ImageFormat::Png)
        .map_err(|e| ReportError::Draw { path: path.to_owned(), message: e.to_string() })?;
    Ok(write_atomic(path, |writer| writer.write_all(png.get_ref()))?)
}

fn radius(points: &[[f32; 3]]) -> f64 {
    let count = points.len().max(1) as f64;
    let vectors = || points.iter().map(|p| Vector3::from(p.map(f64::from)));
    let mean = vectors().sum::<Vector3<f64>>() / count;
    vectors().map(|p| (p - mean).norm()).fold(0.0, f64::max)
}

fn pixel_at(image: &mut RgbImage, at: Vector2<f64>) -> Option<&mut Rgb<u8>> {
    let (x, y) = (at.x.round(), at.y.round());
    let inside = x >= 0.0 && y >= 0.0 && x < f64::from(image.width()) && y < f64::from(image.height());
    inside.then(|| image.get_pixel_mut(x as u32, y as u32))
}

/// Two pixels wide; clipped to the image before it is walked, so that far-away ends cost nothing.
fn draw_line(image: &mut RgbImage, from: Vector2<f64>, to: Vector2<f64>, color: Rgb<u8>) {
    let Some((from, to)) = clip(from, to, f64::from(image.width()), f64::from(image.height())) else {
        return;
    };
    let steps = (to - from).abs().max().ceil().max(1.0);
    for i in 0..=steps as u32 {
        let at = from + (to - from) * (f64::from(i) / steps);
        for offset in [Vector2::zeros(), Vector2::x(), Vector2::y()] {
            if let Some(pixel) = pixel_at(image, at + offset) {
                *pixel = color;
            }
        }
    }
}

/// The part of a segment inside `[-1, width] x [-1, height]` (Liang-Barsky).
fn clip(
    from: Vector2<f64>,
    to: Vector2<f64>,
    width: f64,
    height: f64,
) -> Option<(Vector2<f64>, Vector2<f64>)> {
    let direction = to - from;
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for (axis, size) in [(0, width), (1, height)] {
        for (slope, distance) in [(-direction[axis], from[axis] + 1.0), (direction[axis], size - from[axis])]
        {
            if slope == 0.0 {
                if distance < 0.0 {
                    return None;
                }
            } else if slope < 0.0 {
                enter = enter.max(distance / slope);
            } else {
                leave = leave.min(distance / slope);
            }
        }
    }
    (enter <= leave).then(|| (from + direction * enter, from + direction * leave))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    const CAMERA: Intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 32.0, cy: 24.0 };

    #[test]
    fn the_nearest_point_covers_with_its_colour() {
        let pose = Pose::new(Matrix3::identity(), Vector3::zeros());
        // Two on one ray, one behind the camera, one outside.
        let points = [[0.0, 0.0, 1.0], [0.0, 0.0, 0.5], [0.0, 0.0, -1.0], [9.0, 0.0, 0.5]];
        let colors = [[1, 2, 3], [200, 100, 50], [9, 9, 9], [9, 9, 9]];
        for order in [[0, 1, 2, 3], [1, 0, 3, 2]] {
            let (points, colors) = (order.map(|i| points[i]), order.map(|i| colors[i]));
            let image = painted_overlay(&RgbImage::new(64, 48), &CAMERA, &pose, &points, &colors);
            let drawn: Vec<_> = image.enumerate_pixels().filter(|(_, _, p)| p.0 != [0, 0, 0]).collect();
            assert_eq!(drawn.len(), 4);
            assert!(
                drawn
                    .iter()
                    .all(|(x, y, p)| (32..34).contains(x) && (24..26).contains(y) && p.0 == [200, 100, 50])
            );
        }
    }

    #[test]
    fn a_point_lands_on_its_projection() {
        let mut image = RgbImage::new(64, 48);
        let pose = Pose::new(Matrix3::identity(), Vector3::new(0.1, -0.05, 0.5));
        let points = [[0.0, 0.0, 0.5], [0.0, 0.0, -2.0], [9.0, 0.0, 0.5]];
        draw_points(&mut image, &CAMERA, &pose, &points, Rgb([200, 100, 0]));
        // (0.1, -0.05, 1) -> (42, 19); the others are behind the camera and outside the image.
        let drawn: Vec<_> = image.enumerate_pixels().filter(|(_, _, p)| p.0 != [0, 0, 0]).collect();
        assert_eq!(drawn, [(42, 19, &Rgb([100, 50, 0]))]);
    }

    #[test]
    fn axes_point_where_the_pose_turns_them() {
        let mut image = RgbImage::new(64, 48);
        // Quarter turn about z: the reference's x axis points down, its y axis left.
        let turn = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let pose = Pose::new(turn, Vector3::new(0.0, 0.0, 1.0));
        draw_axes(&mut image, &CAMERA, &pose, &[[0.0; 3]], 0.15);
        assert_eq!(image.get_pixel(32, 38), &AXIS_COLORS[0]);
        assert_eq!(image.get_pixel(18, 24), &AXIS_COLORS[1]);
        assert_eq!(image.get_pixel(32, 12), &Rgb([0, 0, 0]));
    }

    #[test]
    fn lines_to_infinity_are_clipped() {
        let mut image = RgbImage::new(8, 8);
        draw_line(&mut image, Vector2::new(4.0, 4.0), Vector2::new(1e12, 4.0), Rgb([9, 9, 9]));
        assert_eq!(image.get_pixel(7, 4), &Rgb([9, 9, 9]));
        assert_eq!(image.get_pixel(3, 4), &Rgb([0, 0, 0]));
        draw_line(&mut image, Vector2::new(-50.0, -5.0), Vector2::new(80.0, -5.0), Rgb([7, 7, 7]));
        assert!(image.pixels().all(|p| p.0 != [7, 7, 7]));
    }

    #[test]
    fn cutouts_scale_and_sheets_place() {
        let image = RgbImage::from_fn(10, 10, |c, r| Rgb([c as u8, r as u8, 0]));
        let cut = cutout(&image, (5.0, 4.0), 2.0, 8);
        assert_eq!((cut.get_pixel(0, 0).0, cut.get_pixel(7, 7).0), ([3, 2, 0], [7, 6, 0]));
        assert_eq!(cutout(&image, (0.0, 0.0), 4.0, 4).get_pixel(0, 0).0, [0, 0, 0]);
        let sheet = contact_sheet(&[cut.clone(), cut.clone(), cut], 2);
        assert_eq!(sheet.dimensions(), (20, 20));
        assert_eq!((sheet.get_pixel(10, 0).0, sheet.get_pixel(0, 10).0), ([3, 2, 0], [3, 2, 0]));
        assert_eq!(sheet.get_pixel(15, 15).0, [255, 255, 255]);
    }
}
