//! Tokens of a grid: as an image, and cut into windows.

use burn::tensor::Tensor;

/// `[B, C, h, w]` to `[B, h w, C]`.
pub fn tokens_of(image: Tensor<4>) -> Tensor<3> {
    let [batch, channels, h, w] = image.dims();
    image.reshape([batch, channels, h * w]).swap_dims(1, 2)
}

/// `[B, h w, C]` to `[B, C, h, w]`.
pub fn image_of(tokens: Tensor<3>, [h, w]: [usize; 2]) -> Tensor<4> {
    let [batch, _, channels] = tokens.dims();
    tokens.swap_dims(1, 2).reshape([batch, channels, h, w])
}

/// `[1, h w, C]` to windows of `side x side` tokens, `[windows, side^2, C]`, row by row; zeros beyond the right and lower edge.
pub fn windows_of(tokens: Tensor<3>, [h, w]: [usize; 2], side: usize) -> Tensor<3> {
    let channels = tokens.dims()[2];
    let (rows, columns) = (h.div_ceil(side), w.div_ceil(side));
    let mut grid: Tensor<3> = tokens.reshape([h, w, channels]);
    if [rows * side, columns * side] != [h, w] {
        let padded = Tensor::zeros([rows * side, columns * side, channels], &grid.device());
        grid = padded.slice_assign([0..h, 0..w, 0..channels], grid);
    }
    let grid: Tensor<5> = grid.reshape([rows, side, columns, side, channels]);
    grid.swap_dims(1, 2).reshape([rows * columns, side * side, channels])
}

/// Back from [`windows_of`].
pub fn from_windows(windows: Tensor<3>, [h, w]: [usize; 2], side: usize) -> Tensor<3> {
    let channels = windows.dims()[2];
    let (rows, columns) = (h.div_ceil(side), w.div_ceil(side));
    let grid: Tensor<5> = windows.reshape([rows, columns, side, side, channels]);
    let grid: Tensor<3> = grid.swap_dims(1, 2).reshape([rows * side, columns * side, channels]);
    grid.slice([0..h, 0..w, 0..channels]).reshape([1, h * w, channels])
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, Int, TensorData};

    use super::*;

    #[test]
    fn windows_are_padded_at_the_right_and_below_and_come_back() {
        let device = Device::default();
        // Rows 0 1 2 / 3 4 5 / 6 7 8 of tokens 1..=9 in windows of 2 x 2.
        let tokens = Tensor::<1, Int>::arange(1..10, &device).float().reshape([1, 9, 1]);
        let windows = windows_of(tokens.clone(), [3, 3], 2);
        let expected: [f32; 16] = [1., 2., 4., 5., 3., 0., 6., 0., 7., 8., 0., 0., 9., 0., 0., 0.];
        windows.to_data().assert_eq(&TensorData::new(expected.to_vec(), [4, 4, 1]), true);
        from_windows(windows, [3, 3], 2).to_data().assert_eq(&tokens.to_data(), true);
        let image = image_of(tokens.clone(), [3, 3]);
        tokens_of(image).to_data().assert_eq(&tokens.to_data(), true);
    }
}
