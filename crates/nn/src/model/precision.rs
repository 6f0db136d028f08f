//! The network in another number type.

use burn::{
    module::{Module, ModuleMapper, Param},
    tensor::{FloatDType, Tensor},
};
use unopose_core::config::Precision;

use super::UnoPose;

impl UnoPose {
    /// The network with the parameters of the colour network and the matching blocks in this number type. On the autodiff
    /// tape the conversion is recorded: gradients arrive at the parameters of `self`.
    pub fn in_precision(self, precision: Precision) -> Self {
        if precision == Precision::F32 {
            return self;
        }
        let convert = &mut Convert(FloatDType::BF16);
        let fine = self.fine_point_matching.map(|stage| {
            let position = stage.PE.clone();
            let mut stage = stage.map(convert);
            stage.PE = position;
            stage
        });
        Self {
            feature_extraction: self.feature_extraction.map(convert),
            geo_embedding: self.geo_embedding,
            coarse_point_matching: self.coarse_point_matching.map(convert),
            fine_point_matching: fine,
        }
    }
}

struct Convert(FloatDType);

impl ModuleMapper for Convert {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|value| value.cast(self.0))
    }
}

/// `x` in the number type of a parameter.
pub(super) fn like<const D: usize, const E: usize>(x: Tensor<D>, parameter: &Param<Tensor<E>>) -> Tensor<D> {
    x.cast(FloatDType::from(parameter.val().dtype()))
}

/// `x` in single precision.
pub(super) fn single<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    x.cast(FloatDType::F32)
}
