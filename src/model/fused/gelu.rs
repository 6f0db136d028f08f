//! GELU in place where nobody else holds the tensor.

use burn::{
    backend::Flex,
    tensor::{DType, Tensor},
};
use rayon::prelude::*;

use crate::simd;

/// Values per parallel task.
const RUN: usize = 1 << 14;

/// `Err` gives the tensor back: it is on the tape, on another backend or of another number type.
pub fn gelu<const D: usize>(x: Tensor<D>) -> Result<Tensor<D>, Tensor<D>> {
    let count = x.shape().num_elements();
    let Ok(mut values) = x.clone().try_into_primitive::<Flex>() else { return Err(x) };
    if values.dtype() != DType::F32 {
        return Err(x);
    }
    drop(x);
    if !values.is_contiguous() || values.bytes().len() != 4 * count {
        values = values.to_contiguous();
    }
    values
        .storage_mut::<f32>()
        .par_chunks_mut(RUN)
        .for_each(|run| simd::vectorised(|| run.iter_mut().for_each(|x| *x = simd::gelu(*x))));
    Ok(Tensor::from_primitive::<Flex>(values))
}
