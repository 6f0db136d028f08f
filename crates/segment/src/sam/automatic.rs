//! Masks of everything in an image: point prompts on a grid, of whose masks the good, stable and distinct ones stay. Where
//! depth shows a background plane, nothing is asked for.

use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use unopose_core::frame::{BoundingBox, RgbdFrame};
use unopose_dataset::formats::rle::Rle;
use unopose_infer::InferError;

use super::{
    mask_pixels::{Upscaling, resized_mask, stability, thresholded},
    network::{ImageEmbedding, Sam},
    pillow::resized,
    resize::ResizeLongestSide,
};
use crate::{
    MAX_PROPOSALS, Proposal, SegmentError, assignment::non_maximum_suppression, region_merging::ObjectCells,
};

/// Width to which images are resized first.
const WIDTH: u32 = 640;
/// Height that very tall images get instead.
const MAX_HEIGHT: u32 = 4 * WIDTH;
/// Point prompts decoded together: as many as keep the memory below half a gigabyte; the masks do not depend on it.
const POINTS_PER_BATCH: usize = 16;
/// Masks are kept with a predicted overlap above this, ...
const MIN_IOU: f32 = 0.88;
/// ... a stability of at least this, ...
const MIN_STABILITY: f64 = 0.85;
/// ... and boxes that overlap no better one by more than this.
const BOX_OVERLAP: f64 = 0.7;
/// Share of the image that the box must exceed.
const MIN_BOX_SHARE: f64 = 0.0025;
/// Share of the image that the mask must exceed.
const MIN_MASK_SHARE: f64 = 3e-4;

/// A mask that is good and stable.
struct Candidate {
    iou: f32,
    mask: Rle,
    /// Pixels.
    area: usize,
    bounds: BoundingBox,
}

/// Proposals of an image by descending predicted overlap, from the [`prompts`] among `side x side` points.
pub fn proposals(
    network: &Sam,
    frame: &RgbdFrame,
    side: usize,
    device: &Device,
) -> Result<Vec<Proposal>, SegmentError> {
    let prompts = prompts(frame, side);
    if prompts.is_empty() {
        return Ok(Vec::new());
    }
    let rgb = &frame.rgb;
    let own = [rgb.width(), rgb.height()];
    let working = working_size(own);
    let image = resized(rgb, working[0], working[1]);
    let resize = ResizeLongestSide::new(working[0], working[1], network.image_size() as u32);
    let embedding = network.encode(resize.tensor(&image, device));
    let mut candidates = Vec::new();
    for batch in prompts.chunks(POINTS_PER_BATCH) {
        let points: Vec<[f64; 2]> = batch
            .iter()
            .map(|&[x, y]| resize.point([x * f64::from(working[0]), y * f64::from(working[1])]))
            .collect();
        candidates.extend(candidates_at(network, &embedding, &points, &resize)?);
    }
    let mut proposals = Vec::new();
    for candidate in distinct(candidates, working) {
        let mask = candidate.mask.decode()?;
        let mask = if working == own { mask } else { resized_mask(&mask, own) };
        proposals.extend(Proposal::new(mask, candidate.iou.clamp(0.0, 1.0)));
    }
    Ok(proposals)
}

/// Width and height at which an image is segmented.
fn working_size([width, height]: [u32; 2]) -> [u32; 2] {
    let scaled = |length: u32, by: u32, of: u32| {
        (u64::from(length) * u64::from(by) / u64::from(of.max(1))).clamp(1, u64::from(u32::MAX)) as u32
    };
    match scaled(height, WIDTH, width) {
        tall if tall > MAX_HEIGHT => [scaled(width, MAX_HEIGHT, height), MAX_HEIGHT],
        height => [WIDTH, height],
    }
}

/// Centres of `side x side` cells of the unit square, row by row.
fn grid(side: usize) -> Vec<[f64; 2]> {
    let at = |index: usize| (index as f64 + 0.5) / side as f64;
    (0..side).flat_map(|row| (0..side).map(move |column| [at(column), at(row)])).collect()
}

/// Those of the [`grid`] that are not on a background plane of the depth image; all of them without depth.
fn prompts(frame: &RgbdFrame, side: usize) -> Vec<[f64; 2]> {
    let mut points = grid(side);
    if let Some(objects) = ObjectCells::new(frame) {
        let pixel = |share: f64, pixels: u32| (share * f64::from(pixels)) as u32;
        points.retain(|&[x, y]| objects.contains(pixel(x, frame.width()), pixel(y, frame.height())));
    }
    points
}

/// The good and stable ones of the three masks of each point.
fn candidates_at(
    network: &Sam,
    image: &ImageEmbedding,
    points: &[[f64; 2]],
    resize: &ResizeLongestSide,
) -> Result<Vec<Candidate>, InferError> {
    let decoded = network.decode(image, network.prompt_encoder.embed_points(points));
    let count = decoded.iou.dims()[1];
    let overlaps = numbers(decoded.iou.clone())?;
    let mut good: Vec<(f32, Vec<f32>)> = Vec::new();
    for (prompt, overlaps) in overlaps.chunks_exact(count).enumerate() {
        // The first mask is for prompts that mean one thing only.
        let overlaps = &overlaps[1..];
        if overlaps.iter().all(|&iou| iou <= MIN_IOU) {
            continue;
        }
        let logits = numbers(network.masks(image, &decoded, prompt, 1..count))?;
        let masks = overlaps.iter().zip(logits.chunks_exact((logits.len() / overlaps.len()).max(1)));
        good.extend(masks.filter(|(iou, _)| **iou > MIN_IOU).map(|(&iou, logits)| (iou, logits.to_vec())));
    }
    let Some(low) = good.first().map(|(_, logits)| logits.len().isqrt()) else { return Ok(Vec::new()) };
    let upscaling = Upscaling::new(low, resize);
    let candidate = |(iou, logits): &(f32, Vec<f32>)| {
        let logits = upscaling.apply(logits);
        stability(&logits).filter(|&stability| stability >= MIN_STABILITY)?;
        let mask = thresholded(&logits, resize.image);
        let bounds = mask.bounding_box()?;
        Some(Candidate { iou: *iou, area: mask.count(), bounds, mask: Rle::encode(&mask) })
    };
    Ok(good.par_iter().filter_map(candidate).collect())
}

/// Best first, without duplicates and specks.
fn distinct(mut candidates: Vec<Candidate>, [width, height]: [u32; 2]) -> Vec<Candidate> {
    candidates.sort_by(|a, b| b.iou.total_cmp(&a.iou));
    // As in the original, a box reaches from the centre of its first pixel to that of its last.
    let boxes: Vec<BoundingBox> = candidates
        .iter()
        .map(|c| BoundingBox { col_max: c.bounds.col_max - 1, row_max: c.bounds.row_max - 1, ..c.bounds })
        .collect();
    let mut kept = non_maximum_suppression(&boxes, BOX_OVERLAP).into_iter().peekable();
    let image = f64::from(width) * f64::from(height);
    let of_box = |b: &BoundingBox| f64::from(b.col_max - b.col_min) * f64::from(b.row_max - b.row_min);
    let candidates = candidates.into_iter().enumerate();
    let distinct = candidates.filter(|(index, _)| kept.next_if_eq(index).is_some()).map(|(_, c)| c);
    distinct
        .filter(|c| of_box(&c.bounds) / image > MIN_BOX_SHARE && c.area as f64 / image > MIN_MASK_SHARE)
        .take(MAX_PROPOSALS)
        .collect()
}

/// Values of a tensor on the host.
pub(super) fn numbers<const D: usize>(x: Tensor<D>) -> Result<Vec<f32>, InferError> {
    x.try_into_vec_as::<f32>().map_err(InferError::readback("masks"))
}

#[cfg(test)]
mod tests {
    use image::RgbImage;
    use unopose_core::{
        frame::{DepthMap, Mask},
        geometry::Intrinsics,
    };

    use super::*;

    fn candidate(iou: f32, cols: [u32; 2], rows: [u32; 2]) -> Candidate {
        let mut mask = Mask::empty(100, 100);
        for row in rows[0]..rows[1] {
            (cols[0]..cols[1]).for_each(|col| mask.data[(row * 100 + col) as usize] = true);
        }
        let bounds = mask.bounding_box().unwrap();
        Candidate { iou, area: mask.count(), bounds, mask: Rle::encode(&mask) }
    }

    #[test]
    fn the_best_of_overlapping_boxes_stays_and_specks_go() {
        // Sides between pixel centres: 20 x 20 against 15 x 20 inside it is 0.75, against 14 x 20 it is 0.7.
        let list = vec![
            candidate(0.90, [10, 31], [10, 31]),
            candidate(0.95, [10, 26], [10, 31]),
            candidate(0.89, [10, 25], [10, 31]),
            candidate(0.91, [50, 55], [50, 55]),
            candidate(0.92, [60, 66], [50, 55]),
            candidate(0.93, [80, 82], [80, 82]),
        ];
        let kept: Vec<f32> = distinct(list, [100, 100]).iter().map(|c| c.iou).collect();
        // 0.90 and 0.89 overlap 0.95 by 0.75 and 14/15; 5 x 5 pixels are 0.0025 of the image, not more; 6 x 5 are more.
        assert_eq!(kept, [0.95, 0.92]);
        let pair = vec![candidate(0.90, [10, 31], [10, 31]), candidate(0.95, [10, 25], [10, 31])];
        assert_eq!(distinct(pair, [100, 100]).len(), 2);
    }

    /// A table with a box of 40 x 40 pixels and a card of 20 x 20 pixels that lies flat on it.
    #[test]
    fn prompts_are_what_is_not_the_table() {
        let (width, height) = (160, 120);
        let inside = |x: u32, y: u32, left: u32, side: u32| {
            (left..left + side).contains(&x) && (20..20 + side).contains(&y)
        };
        let rgb = RgbImage::from_fn(width, height, |x, y| match inside(x, y, 100, 20) {
            true => image::Rgb([200, 30, 30]),
            false => image::Rgb([120, 120, 120]),
        });
        let depth = (0..width * height).map(|i| match inside(i % width, i / width, 20, 40) {
            true => 0.8,
            false => 1.0,
        });
        let depth = DepthMap { width, height, data: depth.collect() };
        let intrinsics = Intrinsics { fx: 150.0, fy: 150.0, cx: 79.5, cy: 59.5 };
        let mut frame = RgbdFrame { rgb, depth, intrinsics };
        // Points are 10 x 7.5 pixels apart: 4 x 5 on the box, 2 x 2 on the card.
        let found = prompts(&frame, 16);
        let pixels = found.iter().map(|[x, y]| [x * 160.0, y * 120.0]);
        let on = |low: f64, high: f64| pixels.clone().filter(|[x, _]| (low..high).contains(x)).count();
        assert_eq!((on(20.0, 60.0), on(100.0, 120.0), found.len()), (20, 4, 24));
        frame.depth = DepthMap::zeros(width, height);
        assert_eq!(prompts(&frame, 16).len(), 256);
    }

    #[test]
    fn images_get_their_working_size() {
        assert_eq!(working_size([640, 480]), [640, 480]);
        assert_eq!(working_size([72, 50]), [640, 444]);
        assert_eq!(working_size([10_000, 1]), [640, 1]);
        assert_eq!(working_size([1, 10_000]), [1, 2560]);
        let points = grid(2);
        assert_eq!(points, [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]]);
    }
}
