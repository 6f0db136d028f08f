//! Rows of a matrix by their indices.

use burn::tensor::{Int, Tensor};

use crate::device::is_host;

/// `x` `[R, C]` at `rows` `[n]`: `[n, C]`.
///
/// On a GPU the gradient of burn's `select` has one thread per channel, which walks the rows one after the other; that of
/// `gather` adds them in parallel. In host memory `select` copies whole rows.
pub fn select_rows(x: Tensor<2>, rows: Tensor<1, Int>) -> Tensor<2> {
    if is_host(&x.device()) { x.select(0, rows) } else { gathered(x, rows) }
}

fn gathered(x: Tensor<2>, rows: Tensor<1, Int>) -> Tensor<2> {
    let (count, width) = (rows.dims()[0], x.dims()[1]);
    x.gather(0, rows.unsqueeze_dim::<2>(1).expand([count, width]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn both_forms_agree_in_value_and_gradient() {
        let device = Device::flex().autodiff();
        let rows = Tensor::<1, Int>::from_ints([2, 0, 2, 1, 2], &device.clone().inner());
        let weights = Tensor::<2>::from_data(
            TensorData::new((0..10).map(|i| i as f32).collect::<Vec<_>>(), [5, 2]),
            &device.clone().inner(),
        );
        let results = [|x, rows| select_rows(x, rows), gathered].map(|form| {
            let x = Tensor::<2>::from_floats([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], &device).require_grad();
            let selected = form(x.clone(), rows.clone());
            let gradients = (selected.clone() * weights.clone().autodiff()).sum().backward();
            let values = |x: Tensor<2>| x.into_data().try_into_vec::<f32>().unwrap();
            (values(selected.inner()), values(x.grad(&gradients).unwrap()))
        });
        assert_eq!(results[0], results[1]);
        assert_eq!(results[0].0, [5.0, 6.0, 1.0, 2.0, 5.0, 6.0, 3.0, 4.0, 5.0, 6.0]);
        // Row 2 is read by 0, 2 and 4: weights 0 + 4 + 8 and 1 + 5 + 9.
        assert_eq!(results[0].1, [2.0, 3.0, 6.0, 7.0, 12.0, 15.0]);
    }
}
