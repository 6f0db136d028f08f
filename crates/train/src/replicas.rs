//! One forward and backward pass, the batch's pairs shared among the CPU's threads.
//!
//! Most of burn's operations run on one thread. Every thread therefore takes some of the pairs through a copy of the
//! network of its own, and the gradients are summed in a fixed order. The positional encoding, whose batch norm looks
//! at the whole batch and whose kernels use all threads, runs before them; its gradient is taken after them from what
//! reached its output. So the result is that of the undivided batch up to the order of sums.
//!
//! The copies share no node of the autodiff tape: threads that did would wait for each other's locks.

use std::thread;

use burn::{
    module::Module,
    optim::GradientsParams,
    tensor::{Device, Tensor},
};
use unopose_core::config::Config;
use unopose_nn::{
    device::is_host,
    loss::{Losses, pair_losses, structure},
    model::{FeatureExtraction, PairTensors, UnoPose},
};
use unopose_pairs::data::TrainSample;

/// Name of the whole loss among its terms.
pub const TOTAL: &str = "total";

/// Losses and gradients of a batch.
#[non_exhaustive]
pub struct BatchGradients {
    /// The whole loss `[1]` under `total`, then every term per pair `[B]`, on the host.
    pub losses: Vec<(String, Vec<f32>)>,
    /// To be added up: the gradients of the mean loss, divided by the configured number of accumulated passes.
    pub gradients: Vec<GradientsParams>,
}

/// Losses and gradients of `samples`. `model` must be on the autodiff `device`.
pub fn forward_backward(
    model: &UnoPose,
    config: &Config,
    samples: &[TrainSample],
    device: &Device,
) -> BatchGradients {
    forward_backward_keeping(model, config, samples, device, None)
}

/// Points of a cloud whose features are kept like those of the distilled encoder.
const KEPT_POINTS: usize = 256;

/// [`forward_backward`] with the distilled encoder, without autodiff, whose structure the features keep.
pub(super) fn forward_backward_keeping(
    model: &UnoPose,
    config: &Config,
    samples: &[TrainSample],
    device: &Device,
    kept: Option<&FeatureExtraction>,
) -> BatchGradients {
    let size = share_size(samples.len(), device);
    let positions = PairTensors::groups_of(samples, &config.model, device).map(|g| model.position(&g));
    let parts = samples.chunks(size).enumerate().map(|(index, part)| {
        let leaf = |position: &Option<Tensor<3>>| {
            let own = position.as_ref()?.clone().inner().narrow(0, index * size, part.len());
            Some(own.autodiff().require_grad())
        };
        Share {
            model: model.clone().fork(device),
            kept,
            samples: part,
            positions: positions.each_ref().map(leaf),
            share: part.len() as f64 / samples.len() as f64,
        }
    });
    let passed = side_by_side(parts.collect(), |part: Share<'_>| part.forward_backward(config, device));

    let mut losses: Vec<(String, Vec<f32>)> = Vec::new();
    let (mut gradients, mut at_positions) = (Vec::new(), [Vec::new(), Vec::new()]);
    for part in passed {
        join_losses(&mut losses, part.losses);
        gradients.push(part.gradients);
        for (all, own) in at_positions.iter_mut().zip(part.positions) {
            all.extend(own);
        }
    }
    let linear = positions.into_iter().zip(at_positions).filter_map(|(position, gradients)| {
        Some((position? * Tensor::cat(gradients, 0)).sum()) // its gradient is the one that arrived
    });
    if let Some(sum) = linear.reduce(|a, b| a + b) {
        gradients.push(GradientsParams::from_grads(sum.backward(), model));
    }
    BatchGradients { losses, gradients }
}

/// Items of a batch of `count` that a thread takes.
pub(super) fn share_size(count: usize, device: &Device) -> usize {
    let threads = if is_host(device) { rayon::current_num_threads() } else { 1 };
    count.div_ceil(threads).max(1)
}

/// `pass` of every part, each on a thread of its own; results in the order of the parts.
pub(super) fn side_by_side<P: Send, R: Send>(parts: Vec<P>, pass: impl Fn(P) -> R + Sync) -> Vec<R> {
    if parts.len() == 1 {
        // On the caller's thread: a GPU's queue belongs to one.
        return parts.into_iter().map(pass).collect();
    }
    let pass = &pass;
    thread::scope(|scope| {
        let running: Vec<_> = parts.into_iter().map(|part| scope.spawn(move || pass(part))).collect();
        let joined = running.into_iter().map(|part| part.join());
        joined.map(|part| part.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    })
}

/// Adds a share's losses to those of the shares before it: the first is its part of the whole loss, the others are per pair.
pub(super) fn join_losses(losses: &mut Vec<(String, Vec<f32>)>, share: Vec<(String, Vec<f32>)>) {
    for (index, (name, values)) in share.into_iter().enumerate() {
        match losses.get_mut(index) {
            None => losses.push((name, values)),
            Some((_, all)) if index == 0 => all.iter_mut().zip(values).for_each(|(a, v)| *a += v),
            Some((_, all)) => all.extend(values),
        }
    }
}

/// Some of a batch's pairs with a network of their own.
struct Share<'a> {
    model: UnoPose,
    kept: Option<&'a FeatureExtraction>,
    samples: &'a [TrainSample],
    /// Leaves of the tape.
    positions: [Option<Tensor<3>>; 2],
    /// Of the batch.
    share: f64,
}

/// What the pass over a share gives.
struct ShareGradients {
    /// The share's contribution to the whole loss, then the terms.
    losses: Vec<(String, Vec<f32>)>,
    gradients: GradientsParams,
    positions: [Option<Tensor<3>>; 2],
}

impl Share<'_> {
    fn forward_backward(self, config: &Config, device: &Device) -> ShareGradients {
        let batch = PairTensors::from_samples(self.samples, &config.model, device);
        let computing = self.model.clone().in_precision(config.train.precision);
        let outputs = computing.forward_matching(&batch, self.positions.clone());
        let mut losses = pair_losses(&config.loss, &outputs, &batch);
        if let Some(kept) = self.kept {
            let structure = kept_structure(kept, &outputs.colors, &batch);
            losses.total =
                losses.total + structure.clone().mean().mul_scalar(config.loss.kept_structure_weight);
            losses.terms.push(("kept_structure".into(), structure));
        }
        losses.total = losses.total * self.share;
        let values = on_host(&losses);
        let mut gradients = (losses.total / config.train.accumulation as f64).backward();
        ShareGradients {
            losses: values,
            positions: self.positions.map(|position| position?.grad_remove(&mut gradients)),
            gradients: GradientsParams::from_grads(gradients, &self.model),
        }
    }
}

/// How far the structure of the features is from the distilled encoder's, per pair `[B]`.
fn kept_structure(kept: &FeatureExtraction, colors: &[Tensor<3>; 2], batch: &PairTensors) -> Tensor<1> {
    let own = colors.each_ref().map(|colors| colors.clone().narrow(1, 0, KEPT_POINTS.min(colors.dims()[1])));
    let theirs = [&batch.query.view, &batch.reference.view]
        .map(|view| kept.forward(view.images.clone(), &view.choose.first(KEPT_POINTS)).autodiff());
    structure(&own, &theirs)
}

/// The total and the terms, in one read from the device.
pub(super) fn on_host(losses: &Losses) -> Vec<(String, Vec<f32>)> {
    let named: Vec<(&str, &Tensor<1>)> = std::iter::once((TOTAL, &losses.total))
        .chain(losses.terms.iter().map(|(name, value)| (name.as_str(), value)))
        .collect();
    let all = Tensor::cat(named.iter().map(|(_, value)| (*value).clone().inner()).collect(), 0);
    let all = all.into_data().convert::<f32>();
    let mut flat = all.iter::<f32>();
    named
        .iter()
        .map(|(name, value)| ((*name).to_owned(), flat.by_ref().take(value.dims()[0]).collect()))
        .collect()
}
