//! Throughput of training: `cargo bench --bench step [-- --config geo] [--set train.batch_size=32] [--steps 20]`.
//!
//! Pairs of two views of ellipsoids, prepared once; then whole optimizer steps, the first ones not counted: a GPU's
//! kernels are compiled in them. Medians.

use std::{sync::Arc, time::Instant};

use clap::Parser;
use unopose_core::config::Config;
use unopose_nn::{
    device::{DeviceChoice, keep_freed_memory, require_precision},
    model::UnoPose,
};
use unopose_pairs::data::{PairSampler, TrainSample};
use unopose_tests::ellipsoid_views::EllipsoidViews;
use unopose_train::{Optimization, forward_backward};

/// Steps before the first that counts.
const WARM_UP: usize = 3;

#[derive(Parser)]
struct Arguments {
    /// A built-in configuration.
    #[arg(long, default_value = "geo")]
    config: String,
    /// Change a configuration value.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    overrides: Vec<String>,
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// Steps that count.
    #[arg(long, default_value_t = 10)]
    steps: usize,
    /// Passed by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

fn median(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_unstable_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}

fn main() -> anyhow::Result<()> {
    keep_freed_memory();
    let arguments = Arguments::parse();
    let mut config = Config::embedded(&arguments.config, &arguments.overrides)?;
    config.data.min_overlap = 0.0; // of two views of the same few, some hardly overlap
    let (device, backend) = arguments.device.open()?;
    require_precision(&device, config.train.precision)?;
    let size = config.train.batch_size;

    let source = Arc::new(EllipsoidViews::new(24, 0));
    let sampler = PairSampler::new(source, &config.data, &config.model, 0)?;
    let mut preparation = Vec::new();
    let samples: Vec<TrainSample> = (0..size as u64)
        .map(|index| {
            let start = Instant::now();
            let sample = sampler.sample(index, false);
            preparation.push(start.elapsed().as_secs_f64());
            sample
        })
        .collect::<Result<_, _>>()?;

    let training = device.clone().autodiff();
    let mut optimization = Optimization::new(UnoPose::new(&config.model, 0, &training), &config.train);
    let (mut passes, mut updates) = (Vec::new(), Vec::new());
    for step in 0..WARM_UP + arguments.steps.max(1) {
        let start = Instant::now();
        let passed = forward_backward(optimization.model(), &config, &samples, &training);
        let _ = device.sync();
        let passed_at = start.elapsed().as_secs_f64();
        passed.gradients.into_iter().for_each(|gradients| optimization.add(gradients));
        optimization.apply(config.train.learning_rate);
        let _ = device.sync();
        if step >= WARM_UP {
            passes.push(passed_at);
            updates.push(start.elapsed().as_secs_f64() - passed_at);
        }
    }
    let (prepared, passed, updated) = (median(preparation), median(passes), median(updates));
    println!(
        "backend {backend}, {}, {} threads, configuration {}, batches of {size}\n",
        config.train.precision,
        rayon::current_num_threads(),
        arguments.config
    );
    println!("| part of a step | ms |\n|--|--|");
    println!("| forward and backward pass | {:.1} |", 1e3 * passed);
    println!("| gradients' norm, Adam, moving average | {:.1} |", 1e3 * updated);
    println!(
        "\n{:.1} pairs/s; preparing a pair takes a core {:.1} ms",
        size as f64 / (passed + updated),
        1e3 * prepared
    );
    Ok(())
}
