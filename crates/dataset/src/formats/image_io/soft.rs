//! Masks whose values rise from background to object: smoothed edges, probabilities, jpeg.

use super::labels::Labels;

/// Values this close to the least or the largest one (as a share of the largest) may be the flat tails of a soft edge.
const TAIL: u32 = 16;
/// Distinct values between the tails that a soft edge with flat tails has at least.
const SHADES: usize = 8;
/// Pixels from an edge within which jpeg smears it: its blocks are 8 wide, with half the colour resolution 16.
const SMEAR: i64 = 8;

/// The least value that counts as object.
pub(super) fn half(full: u32) -> u32 {
    full / 2 + 1
}

/// Whether no value between background and `full` fills an area, as the labels of a label map do: no 3 x 3 pixels have the
/// same one. The tails of a soft edge are flat, too, where there are many shades between them.
pub(super) fn has_no_plateaus(image: &Labels, full: u32) -> bool {
    let tail = full / TAIL;
    if image.values.iter().max().is_none_or(|&largest| largest < full - tail) {
        return false;
    }
    let is_between = |v: u32| v > tail && v < full - tail;
    let (mut shades, mut flat_tails) = (std::collections::BTreeSet::new(), false);
    let (width, height) = (image.width as usize, image.height as usize);
    for (at, &value) in image.values.iter().enumerate().filter(|(_, v)| **v != 0 && **v != full) {
        if is_between(value) {
            shades.insert(value);
        }
        let (column, row) = (at % width, at / width);
        let inside = (1..width.max(1) - 1).contains(&column) && (1..height.max(1) - 1).contains(&row);
        let flat = inside
            && [at - width, at, at + width]
                .iter()
                .all(|&middle| image.values[middle - 1..=middle + 1].iter().all(|&v| v == value));
        match (flat, is_between(value)) {
            (true, true) => return false,
            (true, false) => flat_tails = true,
            _ => {}
        }
    }
    !flat_tails || shades.len() >= SHADES
}

/// Whether gray of an image with losses (0 to 255) lies at edges between black and white alone, but for a twentieth of the
/// white area.
pub(super) fn is_bimodal(image: &Labels) -> bool {
    let (dark, bright) = (|v: u32| v < 64, |v: u32| v >= 192);
    let white = image.values.iter().filter(|&&v| bright(v)).count();
    let near = |at: usize, wanted: &dyn Fn(u32) -> bool| {
        let (column, row) = ((at % image.width as usize) as i64, (at / image.width as usize) as i64);
        let columns = (column - SMEAR).max(0)..(column + SMEAR + 1).min(image.width.into());
        let mut rows = (row - SMEAR).max(0)..(row + SMEAR + 1).min(image.height.into());
        rows.any(|y| {
            let start = (y * i64::from(image.width)) as usize;
            let pixels = &image.values[start + columns.start as usize..start + columns.end as usize];
            pixels.iter().any(|&v| wanted(v))
        })
    };
    let gray = image.values.iter().enumerate().filter(|(_, v)| !dark(**v) && !bright(**v));
    let stray = gray.filter(|&(at, _)| !(near(at, &dark) && near(at, &bright)));
    let allowed = white / 20;
    stray.take(allowed + 1).count() <= allowed
}
