//! Elementwise ends of linear maps, in place where nobody else holds the tensor.

use burn::{
    backend::{Flex, flex::FlexTensor},
    nn::Linear,
    tensor::{DType, Shape, Tensor, module::linear},
};
use rayon::prelude::*;
use unopose_core::simd::{self, sum, vectorised};

use super::tape::Values;

/// Values per parallel task.
const RUN: usize = 1 << 14;

/// `gelu(x W + b)`.
pub fn linear_gelu(x: &Tensor<3>, map: &Linear) -> Option<Tensor<3>> {
    let (bias, _) = (bias(map)?, Values::of(x)?);
    let mut y = linear(x.clone(), map.weight.val(), None);
    let done = update(&mut y, rows_of(bias.len()), |_, run| {
        vectorised!({
            for row in run.chunks_exact_mut(bias.len()) {
                row.iter_mut().zip(&*bias).for_each(|(y, b)| *y = simd::gelu(*y + b));
            }
        });
    });
    done.then_some(y)
}

/// `residual + gamma (x W + b)`.
pub fn linear_onto(
    residual: &Tensor<3>,
    x: &Tensor<3>,
    map: &Linear,
    gamma: &Tensor<1>,
) -> Option<Tensor<3>> {
    let (bias, gamma) = (bias(map)?, Values::of(gamma)?);
    let (residual, _) = (Values::of(residual)?, Values::of(x)?);
    let width = bias.len();
    let mut y = linear(x.clone(), map.weight.val(), None);
    let run = rows_of(width);
    let done = update(&mut y, run, |index, values| {
        vectorised!({
            let residual = residual[index * run..].chunks_exact(width);
            for (row, residual) in values.chunks_exact_mut(width).zip(residual) {
                for (((y, r), b), g) in row.iter_mut().zip(residual).zip(&*bias).zip(&*gamma) {
                    *y = r + (*y + b) * g;
                }
            }
        });
    });
    done.then_some(y)
}

/// `gelu(x)` in the place of `x`; `None` leaves `x` as it is.
pub fn gelu<const D: usize>(x: &mut Tensor<D>) -> Option<()> {
    update(x, RUN, |_, run| vectorised!(run.iter_mut().for_each(|y| *y = simd::gelu(*y)))).then_some(())
}

/// `gelu(layer_norm(x))` over the last axis in the place of `x`; `None` leaves `x` as it is.
pub fn layer_norm_gelu(x: &mut Tensor<3>, gamma: &Tensor<1>, beta: &Tensor<1>, epsilon: f64) -> Option<()> {
    let (gamma, beta) = (Values::of(gamma)?, Values::of(beta)?);
    let width = gamma.len();
    let done = update(x, rows_of(width), |_, run| {
        vectorised!({
            for row in run.chunks_exact_mut(width) {
                let mean = sum(row, |y| y) / width as f32;
                row.iter_mut().for_each(|y| *y -= mean);
                let scale = 1.0 / (sum(row, |y| y * y) / width as f32 + epsilon as f32).sqrt();
                let channels = row.iter_mut().zip(&*gamma).zip(&*beta);
                channels.for_each(|((y, g), b)| *y = simd::gelu(*y * scale * g + b));
            }
        });
    });
    done.then_some(())
}

fn bias(map: &Linear) -> Option<Values> {
    Values::of(&map.bias.as_ref()?.val())
}

/// Whole rows of `width` in about [`RUN`] values.
fn rows_of(width: usize) -> usize {
    (RUN / width.max(1)).max(1) * width
}

/// Runs `work` over the values of `x` in runs of `run`, each with its number; false leaves `x` as it is: on the tape, on
/// another backend or of another number type.
fn update<const D: usize>(x: &mut Tensor<D>, run: usize, work: impl Fn(usize, &mut [f32]) + Sync) -> bool {
    let count = x.shape().num_elements();
    let Ok(mut values) = x.clone().try_into_primitive::<Flex>() else { return false };
    if values.dtype() != DType::F32 {
        return false;
    }
    // Only the last holder of the values may write to them: `x` lets go.
    *x = Tensor::from_primitive::<Flex>(FlexTensor::empty(Shape::from([0; D]), DType::F32));
    if !values.is_contiguous() || values.bytes().len() != 4 * count {
        values = values.to_contiguous();
    }
    values
        .storage_mut::<f32>()
        .par_chunks_mut(run.max(1))
        .enumerate()
        .for_each(|(index, values)| work(index, values));
    *x = Tensor::from_primitive::<Flex>(values);
    true
}
