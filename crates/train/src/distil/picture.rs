//! What teacher and student see in the validation pairs, as colours.

use std::path::Path;

use burn::tensor::Tensor;
use image::{Rgb, RgbImage};
use nalgebra::{DMatrix, DVector};
use unopose_eval::report::overlay;
use unopose_nn::model::{Student, ViewTensors};
use unopose_pairs::data::imagenet_restored;

use super::views::PairViews;
use crate::TrainError;

/// Side of a tile, pixels.
const TILE: u32 = 168;
/// Pairs on the sheet.
const PAIRS: usize = 8;
/// Half of the side of a point, pixels.
const HALF_POINT: i64 = 3;
/// Standard deviations from the mean that the colours reach.
const REACH: f64 = 2.0;

/// One row of six tiles per pair: the two crops, and the points of both views coloured by the three strongest principal
/// components of the teacher's and of the student's features; the components are those of both views of the pair together.
pub fn write(path: &Path, student: &Student, views: &PairViews) -> Result<(), TrainError> {
    let shown = views.part(0, views.len().min(PAIRS));
    let features = shown.features(student);
    let mut tiles = Vec::new();
    for pair in 0..shown.len() {
        let crops = shown.views.each_ref().map(|view| crop(view, pair));
        let pixels = shown.views.each_ref().map(|view| view.choose.items(pair, 1).pixels().to_vec());
        tiles.extend(crops.iter().map(|crop| overlay::cutout(crop, middle(crop), middle(crop).0, TILE)));
        for of_network in [&shown.teacher, &features] {
            let rows = of_network.each_ref().map(|features| rows(features, pair));
            let colors = principal_colors(&rows);
            let side = crops[0].width();
            tiles.extend(pixels.iter().zip(&colors).map(|(pixels, colors)| dots(pixels, colors, side)));
        }
    }
    Ok(overlay::write_png(path, &overlay::contact_sheet(&tiles, 6))?)
}

fn middle(image: &RgbImage) -> (f64, f64) {
    (f64::from(image.width()) / 2.0, f64::from(image.height()) / 2.0)
}

/// The crop of a pair as an image.
fn crop(view: &ViewTensors, pair: usize) -> RgbImage {
    let [_, _, side, _] = view.images.dims();
    let values: Vec<f32> = view.images.clone().narrow(0, pair, 1).into_data().iter::<f32>().collect();
    let plane = side * side;
    RgbImage::from_fn(side as u32, side as u32, |x, y| {
        let at = y as usize * side + x as usize;
        Rgb(imagenet_restored([0, 1, 2].map(|c| values[c * plane + at])))
    })
}

/// A pair's features, a row per point.
fn rows(features: &Tensor<3>, pair: usize) -> DMatrix<f64> {
    let [_, points, channels] = features.dims();
    let values = features.clone().narrow(0, pair, 1).into_data();
    DMatrix::from_row_iterator(points, channels, values.iter::<f32>().map(f64::from))
}

/// Colours of the rows of both views.
fn principal_colors(views: &[DMatrix<f64>; 2]) -> [Vec<Rgb<u8>>; 2] {
    let count = (views[0].nrows() + views[1].nrows()) as f64;
    let mean = (views[0].row_sum() + views[1].row_sum()) / count;
    let centred = views.each_ref().map(|view| {
        let mut view = (*view).clone();
        view.row_iter_mut().for_each(|mut row| row -= &mean);
        view
    });
    let covariance =
        centred.iter().map(|view| view.tr_mul(view)).reduce(|a, b| a + b).unwrap_or_default() / count;
    let eigen = covariance.symmetric_eigen();
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let axes: Vec<(DVector<f64>, f64)> = order
        .iter()
        .take(3)
        .map(|&i| (eigen.eigenvectors.column(i).into_owned(), eigen.eigenvalues[i].max(1e-12).sqrt()))
        .collect();
    centred.map(|view| {
        let color = |row: usize| {
            let value = |c: usize| {
                let (axis, deviation) = &axes[c.min(axes.len() - 1)];
                let along = view.row(row).transpose().dot(axis) / (REACH * deviation);
                (127.5 * (1.0 + along.clamp(-1.0, 1.0))).round() as u8
            };
            Rgb([value(0), value(1), value(2)])
        };
        (0..view.nrows()).map(color).collect()
    })
}

/// Squares of these colours at pixels of a crop of `side` pixels.
fn dots(pixels: &[u32], colors: &[Rgb<u8>], side: u32) -> RgbImage {
    let mut tile = RgbImage::from_pixel(TILE, TILE, Rgb([24, 24, 24]));
    let scale = f64::from(TILE) / f64::from(side);
    for (&pixel, &color) in pixels.iter().zip(colors) {
        let place = |index: u32| ((f64::from(index) + 0.5) * scale) as i64;
        let (x, y) = (place(pixel % side), place(pixel / side));
        for (dx, dy) in
            (-HALF_POINT..=HALF_POINT).flat_map(|dx| (-HALF_POINT..=HALF_POINT).map(move |dy| (dx, dy)))
        {
            if let (Ok(x), Ok(y)) = (u32::try_from(x + dx), u32::try_from(y + dy))
                && let Some(at) = tile.get_pixel_mut_checked(x, y)
            {
                *at = color;
            }
        }
    }
    tile
}
