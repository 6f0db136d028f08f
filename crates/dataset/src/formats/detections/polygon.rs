//! Polygons filled as COCO does.

/// Steps per pixel to which COCO rounds corners.
const SCALE: f64 = 5.0;

/// The pixels of a polygon with corners `x, y, x, y, ...` in pixels from the left and upper border of an image of `size` (height,
/// width), as ranges of column-major positions. A pixel belongs to it when a line upwards from its centre crosses the polygon's
/// border an odd number of times. The rounding is that of `pycocotools`, so the pixels are the same.
pub(super) fn ranges(corners: &[f64], [height, width]: [u32; 2]) -> Vec<[u64; 2]> {
    let scaled: Vec<[i64; 2]> =
        corners.chunks_exact(2).map(|c| [0, 1].map(|axis| (SCALE * c[axis] + 0.5) as i64)).collect();
    // Where the border crosses the centres of columns.
    let mut crossings: Vec<u64> = Vec::new();
    let mut cross = |a: [i64; 2], b: [i64; 2]| {
        if a[0] == b[0] {
            return;
        }
        let column = (a[0].min(b[0]) as f64 + 0.5) / SCALE - 0.5;
        if column.fract() == 0.0 && column >= 0.0 && column <= f64::from(width) - 1.0 {
            let row = (a[1].min(b[1]) as f64 + 0.5) / SCALE - 0.5;
            let row = row.clamp(0.0, f64::from(height)).ceil();
            crossings.push(column as u64 * u64::from(height) + row as u64);
        }
    };
    for (index, &start) in scaled.iter().enumerate() {
        let end = scaled[(index + 1) % scaled.len()];
        let mut last = start;
        for step in 1..=steps(start, end) {
            let point = along(start, end, step);
            cross(last, point);
            last = point;
        }
    }
    crossings.sort_unstable();
    let end = u64::from(height) * u64::from(width);
    crossings.chunks(2).map(|pair| [pair[0], pair.get(1).copied().unwrap_or(end)]).collect()
}

/// Steps from corner to corner along the longer axis.
fn steps(a: [i64; 2], b: [i64; 2]) -> i64 {
    (a[0] - b[0]).abs().max((a[1] - b[1]).abs())
}

/// The point after `step` steps from `a` to `b`. COCO goes the other way where the longer axis descends, which decides how
/// halves are rounded.
fn along(a: [i64; 2], b: [i64; 2], step: i64) -> [i64; 2] {
    let [dx, dy] = [(a[0] - b[0]).abs(), (a[1] - b[1]).abs()];
    let long = usize::from(dx < dy);
    let total = dx.max(dy);
    let (from, to, step) = if a[long] > b[long] { (b, a, total - step) } else { (a, b, step) };
    let slope = (to[1 - long] - from[1 - long]) as f64 / total as f64;
    let mut point = [from[long] + step; 2];
    point[1 - long] = (from[1 - long] as f64 + slope * step as f64 + 0.5) as i64;
    point
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::rle::{Counts, Rle};

    fn filled(width: u32, height: u32, polygons: &[&[f64]]) -> Vec<(u32, u32)> {
        let size = [height, width];
        let all = polygons.iter().flat_map(|corners| ranges(corners, size)).collect();
        Rle::of_ranges(size, all).decode().unwrap().pixels().collect()
    }

    #[test]
    fn pixels_whose_centres_are_inside_by_hand() {
        // Columns 1 to 3, rows 1 and 2.
        let rectangle = [1.0, 1.0, 4.0, 1.0, 4.0, 3.0, 1.0, 3.0];
        let expected = [(1, 1), (2, 1), (3, 1), (1, 2), (2, 2), (3, 2)];
        assert_eq!(filled(6, 5, &[&rectangle]), expected);
        let reversed = [1.0, 3.0, 4.0, 3.0, 4.0, 1.0, 1.0, 1.0];
        assert_eq!(filled(6, 5, &[&reversed]), expected);
        // Below x + y = 4: centres (c + 0.5, r + 0.5) with c + r < 3 in a triangle that is a little smaller.
        let triangle = [0.0, 0.0, 3.8, 0.0, 0.0, 3.8];
        assert_eq!(filled(5, 5, &[&triangle]), [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)]);
        // A part outside the image.
        let outside = [-3.0, -2.0, 2.0, -2.0, 2.0, 1.0, -3.0, 1.0];
        assert_eq!(filled(5, 5, &[&outside]), [(0, 0), (1, 0)]);
        assert_eq!(filled(2, 2, &[&[-5.0, -5.0, 9.0, -5.0, 9.0, 9.0, -5.0, 9.0]]).len(), 4);
    }

    #[test]
    fn the_pixels_are_those_of_pycocotools() {
        // Counts of `frPyObjects(polygons, 10, 12)` and `merge` of pycocotools 2.0.
        let irregular = [1.3, 0.7, 9.6, 2.2, 7.1, 8.9, 4.4, 5.05, 0.2, 7.7].as_slice();
        let thin = [0.0, 3.1, 11.9, 4.2, 11.9, 4.9, 0.0, 3.6].as_slice();
        let outside = [-4.5, 2.5, 6.25, -3.75, 15.5, 6.5, 5.0, 14.0].as_slice();
        let star =
            [0.0, 0.0, 6.0, 0.0, 6.0, 3.0, 2.0, 3.0, 2.0, 1.0, 4.0, 1.0, 4.0, 2.0, 0.0, 2.0].as_slice();
        for (polygons, expected) in [
            (vec![irregular], "62341O100O1101N00Mo0"),
            (vec![thin], "31900000Y10gN00000L"),
            (vec![outside], "082b2O_M1NO"),
            (vec![star], "02800OI060J06200l1"),
            (vec![irregular, thin], "3121141O100O1101N00M5N0000L"),
        ] {
            let all = polygons.iter().flat_map(|corners| ranges(corners, [10, 12])).collect();
            assert_eq!(Rle::of_ranges([10, 12], all).counts, Counts::Compressed(expected.into()));
        }
    }

    #[test]
    fn several_polygons_are_united_and_a_line_is_nothing() {
        let (a, b) = ([0.0, 0.0, 2.0, 0.0, 2.0, 1.0, 0.0, 1.0], [1.0, 0.0, 4.0, 0.0, 4.0, 1.0, 1.0, 1.0]);
        assert_eq!(filled(5, 2, &[&a, &b]), [(0, 0), (1, 0), (2, 0), (3, 0)]);
        assert!(filled(5, 5, &[&[0.0, 0.0, 4.0, 4.0], &[1.0, 1.0], &[]]).is_empty());
    }
}
