//! What every fused kernel of the CPU gains: `cargo bench --bench kernels [-- --config unopose] [--rounds 15] [KERNEL]`.
//!
//! A whole pair and a training pass, or (`--sam vit_b`) an image and one box by Segment Anything with random weights, with the kernel and with its plain form, alternating; medians. The other kernels are on,
//! so a kernel that another one contains gains nothing where that one runs.

use std::{sync::Arc, time::Instant};

use clap::Parser;
use unopose_core::config::Config;
use unopose_infer::{Uniforms, estimate_pairs};
use unopose_nn::{
    device::{DeviceChoice, keep_freed_memory},
    model::{UnoPose, fused::Kernel},
};
use unopose_pairs::data::{PairSampler, TrainSample};
use unopose_segment::{Prompt, ProposalGenerator, SamProposals};
use unopose_tests::{
    ellipsoid_views::EllipsoidViews,
    sam_network::{BOUNDS, frame, write_random},
};
use unopose_train::forward_backward;

#[derive(Parser)]
struct Arguments {
    /// A built-in configuration.
    #[arg(long, default_value = "geo")]
    config: String,
    /// Change a configuration value.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    overrides: Vec<String>,
    /// Segment Anything instead of a pose network: vit_t (MobileSAM), vit_b, vit_l or vit_h.
    #[arg(long)]
    sam: Option<String>,
    /// Times that each form is measured.
    #[arg(long, default_value_t = 15)]
    rounds: usize,
    /// Pairs of a training pass.
    #[arg(long, default_value_t = 4)]
    pairs: u64,
    /// Only kernels whose names contain this.
    #[arg(value_name = "KERNEL")]
    filter: Option<String>,
    /// Passed by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

/// Work that is ready to be timed.
type Work<'a> = Box<dyn FnOnce() + 'a>;

/// Medians of the seconds with the kernel and without it of what `prepare` makes ready.
fn with_and_without<'a>(kernel: Kernel, rounds: usize, prepare: &dyn Fn() -> Work<'a>) -> [f64; 2] {
    let mut seconds = [Vec::new(), Vec::new()];
    for round in 0..=rounds {
        for (without, seconds) in seconds.iter_mut().enumerate() {
            kernel.switch(without == 0);
            let work = prepare();
            let start = Instant::now();
            work();
            // The first round fills caches.
            if round > 0 {
                seconds.push(start.elapsed().as_secs_f64());
            }
        }
    }
    kernel.switch(true);
    seconds.map(|mut seconds| {
        seconds.sort_unstable_by(f64::total_cmp);
        seconds[seconds.len() / 2]
    })
}

fn main() -> anyhow::Result<()> {
    keep_freed_memory();
    let arguments = Arguments::parse();
    let rounds = arguments.rounds.max(1);
    let wanted = arguments.filter.as_deref().unwrap_or_default();
    let kernels = Kernel::ALL.iter().copied().filter(|kernel| kernel.name().contains(wanted));
    match &arguments.sam {
        Some(network) => segment_anything(network, rounds, kernels),
        None => pose_network(&arguments, rounds, kernels),
    }
}

/// Milliseconds with and without a kernel and what it gains.
fn cells([with, without]: [f64; 2]) -> String {
    let gain = 100.0 * (1.0 - with / without);
    format!("{:.1} | {:.1} | {gain:.1}", 1e3 * with, 1e3 * without)
}

fn segment_anything(
    network: &str,
    rounds: usize,
    kernels: impl Iterator<Item = Kernel>,
) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("sam.safetensors");
    write_random(&path, network);
    let sam = SamProposals::load(&path, &DeviceChoice::Flex.open()?.0)?;
    let frame = frame();
    let segment = || -> Work<'_> {
        // Random weights may find nothing in the box.
        Box::new(|| drop(sam.segment_prompt(&frame, Prompt::Box(BOUNDS))))
    };
    println!("{network}, {} threads\n", rayon::current_num_threads());
    println!("| kernel | box ms | without | gain % |\n|--|--|--|--|");
    for kernel in kernels {
        println!("| `{}` | {} |", kernel.name(), cells(with_and_without(kernel, rounds, &segment)));
    }
    Ok(())
}

fn pose_network(
    arguments: &Arguments,
    rounds: usize,
    kernels: impl Iterator<Item = Kernel>,
) -> anyhow::Result<()> {
    let mut config = Config::embedded(&arguments.config, &arguments.overrides)?;
    config.data.min_overlap = 0.0; // of two views of the same few, some hardly overlap
    let (device, _) = DeviceChoice::Flex.open()?;
    let sampler = PairSampler::new(Arc::new(EllipsoidViews::new(24, 0)), &config.data, &config.model, 0)?;
    let samples: Vec<TrainSample> =
        (0..arguments.pairs.max(1)).map(|index| sampler.sample(index, false)).collect::<Result<_, _>>()?;
    let training = device.clone().autodiff();
    let model = UnoPose::new(&config.model, 0, &device);
    let pair = [(&samples[0].query, &samples[0].reference)];
    let estimate = || -> Work<'_> {
        Box::new(|| {
            estimate_pairs(&model, &config.model, &pair, Uniforms::Shared(0), &device).expect("a pose");
        })
    };
    // A new network each time, as a step has one: the tape of its running statistics would grow.
    let train = || -> Work<'_> {
        let trained = UnoPose::new(&config.model, 0, &training);
        let (config, samples, training) = (&config, &samples, &training);
        Box::new(move || drop(forward_backward(&trained, config, samples, training)))
    };
    println!(
        "configuration {}, {} threads, passes of {} pairs\n",
        arguments.config,
        rayon::current_num_threads(),
        samples.len()
    );
    println!("| kernel | pair ms | without | gain % | pass ms | without | gain % |\n|--|--|--|--|--|--|--|");
    for kernel in kernels {
        let pair = cells(with_and_without(kernel, rounds, &estimate));
        let pass = cells(with_and_without(kernel, rounds, &train));
        println!("| `{}` | {pair} | {pass} |", kernel.name());
    }
    Ok(())
}
