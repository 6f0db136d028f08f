//! GELU in place where nobody else holds the tensor.

use burn::{
    backend::{Flex, flex::FlexTensor},
    tensor::{DType, Shape, Tensor},
};
use rayon::prelude::*;

use crate::simd;

/// Values per parallel task.
const RUN: usize = 1 << 14;

/// Replaces `x`; false leaves it as it is: on the tape, on another backend or of another number type.
pub fn gelu<const D: usize>(x: &mut Tensor<D>) -> bool {
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
        .par_chunks_mut(RUN)
        .for_each(|run| simd::vectorised(|| run.iter_mut().for_each(|x| *x = simd::gelu(*x))));
    *x = Tensor::from_primitive::<Flex>(values);
    true
}
