//! Dilation of a mask with a 3 x 3 cross.

use unopose_core::frame::Mask;

/// The mask grown by `iterations` steps to its four neighbours.
pub fn dilated(mask: &Mask, iterations: usize) -> Mask {
    let mut grown = mask.clone();
    let (width, height) = (mask.width as usize, mask.height as usize);
    let mut border: Vec<usize> = (0..mask.data.len()).filter(|&i| mask.data[i]).collect();
    for _ in 0..iterations {
        let mut next = Vec::new();
        for i in border {
            let (col, row) = (i % width, i / width);
            let neighbors = [
                (col > 0).then(|| i - 1),
                (col + 1 < width).then_some(i + 1),
                (row > 0).then(|| i - width),
                (row + 1 < height).then_some(i + width),
            ];
            for j in neighbors.into_iter().flatten() {
                if !std::mem::replace(&mut grown.data[j], true) {
                    next.push(j);
                }
            }
        }
        border = next;
    }
    grown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grows_to_a_diamond() {
        let mut mask = Mask::empty(11, 9);
        mask.data[4 * 11 + 5] = true;
        let grown = dilated(&mask, 3);
        for (i, &set) in grown.data.iter().enumerate() {
            let distance = (i % 11).abs_diff(5) + (i / 11).abs_diff(4);
            assert_eq!(set, distance <= 3, "pixel {i}");
        }
        assert_eq!(dilated(&mask, 0), mask);
    }
}
