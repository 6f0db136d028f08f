//! From a view and a mask to sampled points with their colour crop.

use image::RgbImage;
use rand::{Rng, seq::index};
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    config::ModelConfig,
    frame::{Mask, RgbdFrame},
    geometry::radius_about_mean,
};

use super::{
    DataError,
    color::augment_color,
    crop::{CropBox, normalised_resize},
    plausible::{RADIUS, unit_hint},
};

/// An object needs more masked pixels than this.
const MIN_PIXELS: usize = 8;
/// Query points farther from their mean than this many reference radii are dropped.
const MAX_QUERY_RADII: f64 = 1.2;

/// Points sampled from a masked view, metres, camera frame.
#[derive(Clone, Debug)]
pub struct SampledView {
    pub points: Vec<[f32; 3]>,
    /// Index of every point in the `size x size` crop.
    pub choose: Vec<u32>,
    /// `[3, size, size]`.
    pub rgb: Vec<f32>,
}

/// A masked and cropped view before sampling.
struct CroppedView {
    points: Vec<[f32; 3]>,
    choose: Vec<u32>,
    rgb: Vec<f32>,
}

/// How pixels are selected.
pub struct SelectionOptions {
    /// Masked pixels without depth become the point (0, 0, 0) (quirk).
    pub keep_zero_depth: bool,
    /// Fewest points that may remain.
    pub min_points: usize,
    /// Stream of the colour changes before masking; `None` leaves the colours.
    pub color_augmentation: Option<ChaCha8Rng>,
}

/// Samples `config.reference_points` points of a reference view; also returns their radius.
pub fn select_reference(
    frame: &RgbdFrame,
    mask: &Mask,
    config: &ModelConfig,
    options: SelectionOptions,
    rng: &mut impl Rng,
) -> Result<(SampledView, f32), DataError> {
    let view = masked_view(frame, mask, config.image_size, options)?;
    let kept = near_the_median(&view.points, config.reference_reach as f64);
    let selection = sample(view, &kept, config.reference_points, rng);
    check_size(&selection.points)?;
    let (_, radius) = radius_about_mean(&selection.points);
    Ok((selection, radius))
}

/// Samples `config.fine_points` points of a query view near their mean; `radius` is the reference's.
pub fn select_query(
    frame: &RgbdFrame,
    mask: &Mask,
    radius: f32,
    config: &ModelConfig,
    options: SelectionOptions,
    rng: &mut impl Rng,
) -> Result<SampledView, DataError> {
    if !(radius.is_finite() && radius > 0.0) {
        return Err(DataError::QueryRadius { radius });
    }
    let minimum = options.min_points;
    let view = masked_view(frame, mask, config.image_size, options)?;
    let limit = MAX_QUERY_RADII * radius as f64;
    let (mean, _) = radius_about_mean(&view.points);
    let kept: Vec<u32> = view
        .points
        .iter()
        .zip(0u32..)
        .filter(|(p, _)| (0..3).map(|i| ((p[i] - mean[i]) as f64).powi(2)).sum::<f64>().sqrt() < limit)
        .map(|(_, i)| i)
        .collect();
    if kept.len() < minimum {
        return Err(DataError::TooFewPoints { count: kept.len(), total: view.points.len(), limit, minimum });
    }
    Ok(sample(view, &kept, config.fine_points, rng))
}

/// Indices of the points within `reach` median distances of the median point; all when `reach` is 0.
fn near_the_median(points: &[[f32; 3]], reach: f64) -> Vec<u32> {
    let all = 0..points.len() as u32;
    if reach <= 0.0 || points.is_empty() {
        return all.collect();
    }
    let median = |mut values: Vec<f64>| -> f64 {
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let center: [f64; 3] = std::array::from_fn(|i| median(points.iter().map(|p| p[i] as f64).collect()));
    let distance = |p: &[f32; 3]| (0..3).map(|i| (p[i] as f64 - center[i]).powi(2)).sum::<f64>().sqrt();
    let distances: Vec<f64> = points.iter().map(distance).collect();
    let limit = reach * median(distances.clone());
    all.filter(|&i| distances[i as usize] <= limit).collect()
}

/// Refuses points of no object in front of a depth camera. Points without depth, which a quirk puts into the camera, do not
/// count.
fn check_size(points: &[[f32; 3]]) -> Result<(), DataError> {
    let measured: Vec<[f32; 3]> = points.iter().copied().filter(|p| p[2] > 0.0).collect();
    let (mean, radius) = radius_about_mean(&measured);
    let distance = mean.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
    let radius = f64::from(radius);
    if RADIUS.contains(&radius) {
        return Ok(());
    }
    let (minimum, maximum) = RADIUS.into_inner();
    Err(DataError::Radius { radius, distance, minimum, maximum, hint: unit_hint(distance, radius) })
}

fn masked_view(
    frame: &RgbdFrame,
    mask: &Mask,
    size: usize,
    options: SelectionOptions,
) -> Result<CroppedView, DataError> {
    let (width, height) = (frame.width(), frame.height());
    for (what, found_width, found_height) in
        [("the mask", mask.width, mask.height), ("the depth image", frame.depth.width, frame.depth.height)]
    {
        if (found_width, found_height) != (width, height) {
            return Err(DataError::Size { what, found_width, found_height, width, height });
        }
    }
    let measured = |depth: f32| depth.is_finite() && depth > 0.0;
    let usable: Vec<(u32, u32)> = mask
        .pixels()
        .filter(|&(col, row)| options.keep_zero_depth || measured(frame.depth.get(col, row)))
        .collect();
    if usable.is_empty() {
        let masked = mask.count();
        return Err(if masked == 0 { DataError::EmptyMask } else { DataError::NoDepth { masked } });
    }
    let crop = tight_box(&usable).map(|b| CropBox::around(&b, width, height)).ok_or(DataError::EmptyMask)?;
    let inside: Vec<((u32, u32), (u32, u32))> =
        usable.iter().filter_map(|&(col, row)| Some(((col, row), crop.local(row, col)?))).collect();
    if inside.len() <= MIN_PIXELS {
        return Err(DataError::TooFewPixels { count: inside.len(), minimum: MIN_PIXELS });
    }

    let mut image = crop.cut(&frame.rgb);
    if let Some(mut stream) = options.color_augmentation {
        augment_color(&mut image, &mut stream);
    }
    let mut masked = RgbImage::new(crop.side, crop.side);
    let mut points = Vec::with_capacity(inside.len());
    let mut choose = Vec::with_capacity(inside.len());
    for ((col, row), (local_row, local_col)) in inside {
        masked.put_pixel(local_col, local_row, *image.get_pixel(local_col, local_row));
        let depth = Some(frame.depth.get(col, row)).filter(|&d| measured(d)).unwrap_or(0.0);
        let p = frame.intrinsics.back_project(col as f64, row as f64, depth as f64);
        points.push([p.x as f32, p.y as f32, p.z as f32]);
        choose.push(crop.choose(local_row, local_col, size));
    }
    Ok(CroppedView { points, choose, rgb: normalised_resize(&masked, size) })
}

fn tight_box(pixels: &[(u32, u32)]) -> Option<unopose_core::frame::BoundingBox> {
    let cols = || pixels.iter().map(|p| p.0);
    let rows = || pixels.iter().map(|p| p.1);
    Some(unopose_core::frame::BoundingBox {
        col_min: cols().min()?,
        col_max: cols().max()? + 1,
        row_min: rows().min()?,
        row_max: rows().max()? + 1,
    })
}

/// `count` of the `kept` points, with replacement when there are not more than that.
fn sample(view: CroppedView, kept: &[u32], count: usize, rng: &mut impl Rng) -> SampledView {
    let picks: Vec<usize> = if kept.len() <= count {
        (0..count).map(|_| rng.random_range(0..kept.len())).collect()
    } else {
        index::sample(rng, kept.len(), count).into_vec()
    };
    let chosen = || picks.iter().map(|&i| kept[i] as usize);
    SampledView {
        points: chosen().map(|i| view.points[i]).collect(),
        choose: chosen().map(|i| view.choose[i]).collect(),
        rgb: view.rgb,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stray_points_are_dropped_by_their_median_distances() {
        let mut points: Vec<[f32; 3]> =
            (0..100).map(|i| [0.001 * (i % 10) as f32, 0.001 * (i / 10) as f32, 0.7]).collect();
        points.push([0.0, 0.0, 0.9]);
        assert_eq!(near_the_median(&points, 3.0), (0..100).collect::<Vec<_>>());
        assert_eq!(near_the_median(&points, 0.0).len(), 101);
        assert!(near_the_median(&[], 3.0).is_empty());
    }
}
