//! The mask's border against the borders of the object's surface.

use unopose_core::frame::{Mask, MaskedView};

use super::{
    Check, Finding, Level,
    jumps::{Jump, Lines, is_smooth, measured, next_measured},
    object::quantile,
};

/// How far from the mask's border a surface's border is looked for, pixels.
const REACH: f64 = 20.0;
/// Borders that the median is taken of, and their share of the mask's border.
const FEWEST: usize = 20;
const SHARE: f64 = 0.15;
/// Median distance of the borders, pixels, and as a share of the mask's size: both have to be exceeded. Depth cameras shift
/// borders by up to 3 pixels.
const OFFSET: [f64; 2] = [4.0, 10.0];
const OFFSET_SHARE: [f64; 2] = [0.02, 0.06];
/// Share of the measured mask that lies on surfaces behind the object.
const LEAK: [f64; 2] = [0.06, 0.25];
/// Share of the image that the mask covers.
const COVERS: [f64; 2] = [0.6, 0.98];
/// Smaller parts are noise, pixels.
const SMALLEST_PART: usize = 25;

/// How a mask lies on the surfaces of a depth image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MaskFit {
    /// Median distance along rows and columns from the mask's border outwards to the surface's border, pixels: positive for a mask that is too tight,
    /// negative for one that is too wide. `None` where too few borders are near.
    pub offset: Option<f64>,
    /// Share of the measured mask on surfaces that are behind the object and go on outside the mask.
    pub leak: f64,
}

pub(crate) fn mask_fit(view: MaskedView<'_>, lines: &Lines) -> MaskFit {
    MaskFit { offset: offset(view.mask, lines), leak: leak(view) }
}

fn offset(mask: &Mask, lines: &Lines) -> Option<f64> {
    let (width, height) = (mask.width as usize, mask.height as usize);
    let mut offsets = Vec::new();
    let mut borders = 0;
    let mut line = |jumps: &[Jump], set: &dyn Fn(usize) -> bool, length: usize| {
        for at in 1..length {
            if set(at - 1) != set(at) {
                borders += 1;
                let outward = if set(at - 1) { 1 } else { -1 };
                offsets.extend(nearest_border(jumps, at as f64 - 0.5, outward));
            }
        }
    };
    for (row, jumps) in lines.rows.iter().enumerate().take(height) {
        line(jumps, &|col| mask.data[row * width + col], width);
    }
    for (col, jumps) in lines.columns.iter().enumerate().take(width) {
        line(jumps, &|row| mask.data[row * width + col], height);
    }
    let enough = offsets.len() >= FEWEST && offsets.len() as f64 >= SHARE * f64::from(borders);
    enough.then(|| quantile(offsets, 0.5))
}

/// Distance outwards from a mask's border to the next border of a surface whose far side is outside.
fn nearest_border(jumps: &[Jump], border: f64, outward: i8) -> Option<f64> {
    let distance = |jump: &Jump| f64::from(outward) * (jump.at() - border);
    let near = |outside: bool| {
        let side =
            jumps.iter().filter(move |j| (distance(j) >= 0.0) == outside && distance(j).abs() <= REACH);
        // A border of another surface in between ends the search.
        side.min_by(|a, b| distance(a).abs().total_cmp(&distance(b).abs())).filter(|j| j.towards == outward)
    };
    let found = [near(true), near(false)].into_iter().flatten().map(distance);
    found.min_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// A smooth part of the surface inside the mask.
#[derive(Default)]
struct Part {
    pixels: usize,
    /// Neighbours in the mask beyond a jump, behind this part and before it.
    behind: usize,
    before: usize,
    /// Neighbours outside the mask on the same surface, and beyond a jump.
    goes_on: usize,
    ends: usize,
}

const NEIGHBORS: [(i32, i32); 4] = [(1, 0), (-1, 0), (0, 1), (0, -1)];

fn leak(view: MaskedView<'_>) -> f64 {
    let (depth, mask, k) = (&view.frame.depth, view.mask, &view.frame.intrinsics);
    let index = |col: u32, row: u32| row as usize * mask.width as usize + col as usize;
    let smooth = |a: (u32, u32), b: (u32, u32), gap: usize, direction: (i32, i32)| {
        let focal = if direction.0 != 0 { k.fx } else { k.fy };
        is_smooth(depth.get(a.0, a.1), depth.get(b.0, b.1), gap, 1.0 / focal)
    };
    let mut seen = vec![false; mask.data.len()];
    let mut parts = Vec::new();
    for start in mask.pixels().filter(|&(col, row)| measured(depth.get(col, row))) {
        if std::mem::replace(&mut seen[index(start.0, start.1)], true) {
            continue;
        }
        let mut part = Part::default();
        let mut open = vec![start];
        while let Some(at) = open.pop() {
            part.pixels += 1;
            for direction in NEIGHBORS {
                let Some((col, row, gap)) = next_measured(depth, at, direction) else { continue };
                let same = smooth(at, (col, row), gap, direction);
                if !mask.get(col, row) {
                    part.goes_on += usize::from(same);
                    part.ends += usize::from(!same);
                } else if same {
                    if !std::mem::replace(&mut seen[index(col, row)], true) {
                        open.push((col, row));
                    }
                } else if depth.get(col, row) < depth.get(at.0, at.1) {
                    part.before += 1;
                } else {
                    part.behind += 1;
                }
            }
        }
        parts.push(part);
    }
    let total: usize = parts.iter().map(|p| p.pixels).sum();
    let leaked = |p: &&Part| {
        p.pixels >= SMALLEST_PART && p.before > 3 * p.behind.max(1) && p.goes_on > p.ends && p.goes_on > 0
    };
    let outside: usize = parts.iter().filter(leaked).map(|p| p.pixels).sum();
    outside as f64 / total.max(1) as f64
}

/// Does the mask end where the object's surface does?
pub(crate) fn mask_finding(view: MaskedView<'_>, lines: &Lines) -> Finding {
    let fit = mask_fit(view, lines);
    let pixels = view.mask.count();
    let covers = pixels as f64 / view.mask.data.len().max(1) as f64;
    let size = (pixels as f64).sqrt();
    let limits = [0, 1].map(|i| OFFSET[i].max(OFFSET_SHARE[i] * size));
    let offset = fit.offset.unwrap_or(0.0);
    let [by_offset, by_leak, by_cover] =
        [Level::of(offset.abs(), limits), Level::of(fit.leak, LEAK), Level::of(covers, COVERS)];
    let text = match fit.offset {
        Some(_) if by_offset == Level::Ok => {
            format!("ends where the surface does ({offset:+.1} pixels), ")
        }
        Some(_) if offset > 0.0 => format!("is {offset:.1} pixels too tight, "),
        Some(_) => format!("is {:.1} pixels too wide, ", -offset),
        None => "has no border of a surface near its own, ".into(),
    };
    let text = format!(
        "{text}{:.0} % of it lies on surfaces behind, it covers {:.1} % of the image",
        100.0 * fit.leak,
        100.0 * covers
    );
    let advice = if by_cover > Level::Ok {
        "is it the mask of one object, and not inverted?"
    } else if by_leak > Level::Ok || offset < 0.0 {
        "the mask leaks onto what is behind the object: draw it again, or erode it"
    } else {
        "the object goes on outside the mask: draw it again, or check that mask and depth are registered"
    };
    Finding::new(Check::Mask, by_offset.max(by_leak).max(by_cover), text)
        .with_values([("outwards_px", offset), ("leak", fit.leak), ("covers", covers)])
        .advise(advice)
}
