//! Between tensors and slices: values in host memory, and steps of the autodiff tape with gradients of their own.

use std::{fmt::Debug, marker::PhantomData, ops::Deref};

use burn::{
    backend::{
        Autodiff, Flex,
        autodiff::{
            checkpoint::{base::Checkpointer, strategy::NoCheckpointing},
            grads::Gradients,
            ops::{Backward, NodeGuard, Ops, OpsKind},
        },
        flex::FlexTensor,
    },
    tensor::{DType, Tensor, TensorData},
};

/// The values of an `f32` tensor in row-major order.
#[derive(Clone, Debug)]
pub(super) struct Values(FlexTensor);

impl Values {
    fn of_primitive(tensor: FlexTensor) -> Option<Self> {
        if tensor.dtype() != DType::F32 {
            return None;
        }
        let dense = tensor.as_slice::<f32>().is_some();
        Some(Self(if dense { tensor } else { tensor.to_contiguous() }))
    }

    /// Of a tensor off the tape; `None` on other backends and for other number types.
    pub fn of<const D: usize>(tensor: &Tensor<D>) -> Option<Self> {
        Self::of_primitive(tensor.clone().try_into_primitive::<Flex>().ok()?)
    }
}

impl Deref for Values {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.0.as_slice().unwrap_or_default()
    }
}

fn primitive(values: Vec<f32>, shape: impl Into<Vec<usize>>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape.into()))
}

/// A tensor of its own, off the tape.
pub(super) fn plain<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> Tensor<D> {
    Tensor::from_primitive::<Flex>(primitive(values, shape))
}

/// An input of a step.
pub(super) struct Input {
    pub values: Values,
    node: NodeGuard,
}

impl Input {
    /// Of a tensor on or off the tape; `None` on other backends, number types and checkpointing strategies.
    pub fn of<const D: usize>(tensor: &Tensor<D>) -> Option<Self> {
        let tensor = tensor.clone().autodiff().try_into_primitive::<Autodiff<Flex>>().ok()?;
        let (primitive, node) = tensor.into_parts();
        Some(Self { values: Values::of_primitive(primitive)?, node })
    }
}

/// What a step keeps for its backward pass.
pub(super) trait Gradient<const N: usize>: Clone + Debug + Send + 'static {
    /// Gradients of the inputs with their shapes from the output's gradient; only the wanted ones are used.
    fn gradients(&self, output: &[f32], wanted: [bool; N]) -> [(Vec<f32>, Vec<usize>); N];
}

#[derive(Debug)]
struct Step<G>(PhantomData<fn() -> G>);

impl<G: Gradient<N>, const N: usize> Backward<Flex, N> for Step<G> {
    type State = G;

    fn backward(self, ops: Ops<G, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let output = grads.consume::<Flex>(&ops.node);
        let wanted = ops.parents.each_ref().map(Option::is_some);
        // The tape holds what the forward pass put there: f32.
        let Some(output) = Values::of_primitive(output) else { return };
        let gradients = ops.state.gradients(&output, wanted);
        for (parent, (values, shape)) in ops.parents.into_iter().zip(gradients) {
            if let Some(parent) = parent {
                grads.register::<Flex>(parent.id, primitive(values, shape));
            }
        }
    }
}

/// Puts the result of `inputs` on the tape (when one of them is tracked).
pub(super) fn record<G: Gradient<N>, const N: usize, const D: usize>(
    inputs: [Input; N],
    values: Vec<f32>,
    shape: [usize; D],
    state: impl FnOnce([Values; N], &Values) -> G,
) -> Option<Tensor<D>> {
    let output = Values(primitive(values, shape));
    let (kept, nodes): (Vec<Values>, Vec<NodeGuard>) = inputs.into_iter().map(|i| (i.values, i.node)).unzip();
    let (kept, nodes) = (kept.try_into().ok()?, nodes.try_into().ok()?);
    let step = Step::<G>(PhantomData).prepare::<NoCheckpointing>(nodes).compute_bound().stateful();
    let output = match step {
        OpsKind::Tracked(step) => {
            let state = state(kept, &output);
            step.finish(state, output.0)
        }
        OpsKind::UnTracked(step) => step.finish(output.0),
    };
    Some(Tensor::from_primitive::<Autodiff<Flex>>(output))
}
