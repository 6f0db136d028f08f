//! Times of every stage of one pair, beside the machine's matrix product:
//! `cargo bench --bench pair [-- --config geo] [--set model.color.depth=24] [--rounds 9] [STAGE]`.
//!
//! One query and one reference of the configuration's sizes (default: `unopose`, the paper's), untrained weights. A
//! stage's time is the median over the rounds; the ratio is to a product of two 1024 x 1024 matrices right after it.

use std::{hint::black_box, time::Instant};

use burn::tensor::{Device, Distribution, Tensor};
use clap::Parser;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::{
    config::{ColorConfig, Config, ModelConfig, Precision},
    geometry::{coarse_pose, fine_pose, match_assignment},
};
use unopose_infer::{CloudPair, Uniforms, encode_references, estimate_encoded, estimate_pairs};
use unopose_nn::{
    device::{DeviceChoice, keep_freed_memory, require_precision},
    model::{CloudTensors, EncodedCloud, Supervision, UnoPose, group_tensors},
};
use unopose_pairs::data::{
    CloudInput, PreparedReference, positional_groups, query_from_points, reference_from_points,
};

#[derive(Parser)]
struct Arguments {
    /// A built-in configuration.
    #[arg(long, default_value = "unopose")]
    config: String,
    /// Change a configuration value.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    overrides: Vec<String>,
    #[arg(long, default_value = "auto")]
    device: DeviceChoice,
    /// Number type of the network's products.
    #[arg(long, default_value_t)]
    precision: Precision,
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// Instances of the batch against cached references.
    #[arg(long, default_value_t = 8)]
    instances: usize,
    /// Choose pixels anywhere in the crop, so that all of it is read, instead of where the points are seen.
    #[arg(long)]
    scattered: bool,
    /// Measure only stages whose names contain this.
    #[arg(value_name = "STAGE")]
    filter: Option<String>,
    /// Passed by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

struct Bench {
    rounds: usize,
    device: Device,
    filter: String,
    /// Factors of the product that every round measures, too.
    factors: [Tensor<2>; 2],
}

impl Bench {
    fn seconds<T>(&self, work: impl FnOnce() -> T) -> f64 {
        let start = Instant::now();
        black_box(work());
        // Backends may compute later; nothing is asked of an idle one.
        let _ = self.device.sync();
        start.elapsed().as_secs_f64()
    }

    fn product(&self) -> f64 {
        let [a, b] = &self.factors;
        self.seconds(|| a.clone().matmul(b.clone()))
    }

    /// Prints the medians of `work / share` and of its ratio to a product right after it, after one round that does not
    /// count. The CPU's clock follows its load, so a product measured at another time is another yardstick.
    fn row<T>(&self, stage: &str, share: usize, mut work: impl FnMut() -> T) {
        if !stage.contains(&self.filter) {
            return;
        }
        black_box(work());
        let mut rounds: Vec<[f64; 2]> = (0..self.rounds)
            .map(|_| {
                let seconds = self.seconds(&mut work) / share.max(1) as f64;
                let mut products = [self.product(), self.product(), self.product()];
                products.sort_unstable_by(f64::total_cmp);
                [seconds, seconds / products[1]]
            })
            .collect();
        let [seconds, ratio] = [0, 1].map(|column| {
            rounds.sort_unstable_by(|a, b| a[column].total_cmp(&b[column]));
            rounds[self.rounds / 2][column]
        });
        println!("| {stage} | {:.1} | {ratio:.1} |", seconds * 1e3);
    }
}

fn main() -> anyhow::Result<()> {
    keep_freed_memory();
    let arguments = Arguments::parse();
    let config = Config::embedded(&arguments.config, &arguments.overrides)?.model;
    let (device, backend) = arguments.device.open()?;
    require_precision(&device, arguments.precision)?;
    let model = UnoPose::new(&config, 0, &device).in_precision(arguments.precision);
    let matrix = || Tensor::<2>::random([1024, 1024], Distribution::Uniform(-1.0, 1.0), &device);
    let bench = Bench {
        rounds: arguments.rounds.max(1),
        device: device.clone(),
        filter: arguments.filter.clone().unwrap_or_default(),
        factors: [matrix(), matrix()],
    };
    println!(
        "backend {backend}, {}, {} threads, configuration {}",
        arguments.precision,
        rayon::current_num_threads(),
        arguments.config
    );
    let views = Views { config: &config, scattered: arguments.scattered };
    let (query, reference) = views.pair(0);
    if let Some((used, all)) = patches(&config, &query.choose) {
        println!("the query's points are seen in {used} of {all} patches");
    }
    println!("\n| stage | ms | ratio |\n|--|--|--|");
    let mut products: Vec<f64> = (0..20).map(|_| bench.product()).collect();
    products.sort_unstable_by(f64::total_cmp);
    println!(
        "| product of 1024 x 1024 ({:.0} GFLOP/s) | {:.2} | 1 |",
        2.0 * 1024f64.powi(3) / products[10] / 1e9,
        products[10] * 1e3
    );
    stages(&bench, &model, views);

    let encoded = encode_references(&model, &config, &[&reference], &device);
    let again = |query: &CloudInput, reference: &PreparedReference, encoded: &EncodedCloud| {
        estimate_encoded(
            &model,
            &config,
            &[CloudPair::new(query, reference)],
            &[encoded],
            Uniforms::Shared(0),
            &device,
        )
    };
    bench.row("**pair, cached reference**", 1, || again(&query, &reference, &encoded));
    bench.row("**whole pair**", 1, || {
        estimate_pairs(&model, &config, &[(&query, &reference)], Uniforms::Shared(0), &device)
    });
    let of_pair = peak_memory();
    // What is kept of a reference; its neighbourhoods are in the positional encoding.
    let kept: Vec<_> = (0..arguments.instances as u64)
        .map(|seed| {
            let (query, reference) = views.pair(seed);
            let encoded = encode_references(&model, &config, &[&reference], &device);
            (query, reference.cloud, reference.radius, encoded)
        })
        .collect();
    let batch: Vec<_> = kept
        .iter()
        .map(|(query, reference, radius, _)| CloudPair { query, reference, radius: *radius })
        .collect();
    let encoded: Vec<&EncodedCloud> = kept.iter().map(|(.., encoded)| encoded).collect();
    let row = format!("**instance of {}, cached references**", batch.len());
    bench.row(&row, batch.len(), || {
        estimate_encoded(&model, &config, &batch, &encoded, Uniforms::Shared(0), &device)
    });
    if let (Some(pair), Some(batch)) = (of_pair, peak_memory()) {
        println!("\npeak memory {pair} MiB before the batch, {batch} MiB with it");
    }
    Ok(())
}

/// The parts of the whole, each on the inputs it has there.
fn stages(bench: &Bench, model: &UnoPose, views: Views<'_>) {
    let (device, config) = (&bench.device, views.config);
    let (points, choose, rgb) = views.view(1, config.reference_points);
    bench
        .row("reference: prepare (host)", 1, || reference_from_points(&points, &choose, rgb.clone(), config));
    let (query, reference) = views.pair(0);
    let [q, p] = [&query, &reference.cloud].map(|cloud| CloudTensors::from_clouds(&[cloud], config, device));
    bench.row("colour features, one image", 1, || model.colors(&q.view));
    bench.row("structure embedding, one cloud", 1, || {
        model.geo_embedding.forward(q.structure.distances.clone(), q.structure.angles.clone())
    });
    let [q, p] = [&q, &p].map(|cloud| model.encode(cloud));
    let coarse = || model.coarse(&q, &p, Supervision::LastBlock).pop();
    bench.row("coarse matching", 1, coarse);
    let values = |tensor: Tensor<3>| tensor.try_into_vec_as::<f32>().unwrap_or_default();
    let ones = |count: usize| vec![1.0; count];
    if let Some(block) = coarse() {
        let similarity = values(block.similarity);
        let assignment =
            match_assignment(&similarity, &ones(query.sparse.len()), &ones(reference.cloud.sparse.len()));
        let sparse = |cloud: &CloudInput| -> Vec<[f32; 3]> {
            cloud.sparse.iter().map(|&i| cloud.points[i as usize]).collect()
        };
        let (from, to) = (sparse(&query), sparse(&reference.cloud));
        let degenerate = config.quirks.degenerate_triplets;
        bench.row("hypotheses (host)", 1, || {
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            coarse_pose(&assignment, &from, &to, &config.hypotheses, || rng.random(), degenerate)
        });
    }
    let Some(stage) = &model.fine_point_matching else { return };
    let groups = positional_groups(&query.points, config);
    bench.row("ball groups with local frames (host)", 1, || positional_groups(&query.points, config));
    bench.row("positional encoding, one cloud", 1, || {
        stage.position(&group_tensors(&[&groups], config, device))
    });
    let position = [&groups, &reference.groups].map(|g| stage.position(&group_tensors(&[g], config, device)));
    let [at_query, at_reference] = position.map(Some);
    let (q, p) = (EncodedCloud { position: at_query, ..q }, EncodedCloud { position: at_reference, ..p });
    let fine = || model.fine(&q, &p, Supervision::LastBlock).pop();
    bench.row("fine matching", 1, fine);
    let Some(block) = fine() else { return };
    let similarity = values(block.similarity);
    let ones = [ones(query.points.len()), ones(reference.cloud.points.len())];
    bench.row("assignment (host)", 1, || match_assignment(&similarity, &ones[0], &ones[1]));
    let assignment = match_assignment(&similarity, &ones[0], &ones[1]);
    bench.row("weighted Procrustes and score (host)", 1, || {
        fine_pose(&assignment, &query.points, &reference.cloud.points)
    });
}

/// Views of the configuration's sizes.
#[derive(Clone, Copy)]
struct Views<'a> {
    config: &'a ModelConfig,
    /// Pixels anywhere in the crop instead of where the points are seen.
    scattered: bool,
}

impl Views<'_> {
    /// A query and a reference.
    fn pair(&self, seed: u64) -> (CloudInput, PreparedReference) {
        let (points, choose, rgb) = self.view(2 * seed, self.config.reference_points);
        let reference = reference_from_points(&points, &choose, rgb, self.config);
        let (points, choose, rgb) = self.view(2 * seed + 1, self.config.fine_points);
        (query_from_points(&points, &choose, rgb, reference.radius, self.config), reference)
    }

    /// The visible half of a bumpy ellipsoid with half axes of 10, 6 and 5 cm, 0.7 m away, and a noise picture of the
    /// square crop around it.
    fn view(&self, seed: u64, count: usize) -> (Vec<[f32; 3]>, Vec<u32>, Vec<f32>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let points: Vec<[f32; 3]> = (0..count)
            .map(|_| {
                let (z, a) = (rng.random_range(-1.0f32..0.0), rng.random_range(0.0..std::f32::consts::TAU));
                let (rho, bump) = ((1.0 - z * z).sqrt(), 1.0 + 0.1 * (5.0 * a).sin() * z);
                [0.10 * bump * rho * a.cos(), 0.06 * bump * rho * a.sin(), 0.05 * bump * z + 0.7]
            })
            .collect();
        let pixels = (self.config.image_size * self.config.image_size) as u32;
        let choose = match self.scattered {
            true => (0..count).map(|_| rng.random_range(0..pixels)).collect(),
            false => self.seen_at(&points),
        };
        let rgb = (0..3 * pixels).map(|_| rng.random_range(-2.0..2.0)).collect();
        (points, choose, rgb)
    }

    /// The pixel of the crop, which the object fills in its larger direction, that shows each point.
    fn seen_at(&self, points: &[[f32; 3]]) -> Vec<u32> {
        let projected = || points.iter().map(|[x, y, z]| [x / z, y / z]);
        let bounds = [0, 1].map(|axis| {
            projected().fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], p| {
                [low.min(p[axis]), high.max(p[axis])]
            })
        });
        let side = bounds.iter().map(|[low, high]| high - low).fold(f32::MIN_POSITIVE, f32::max);
        let size = self.config.image_size;
        let pixel = |axis: usize, x: f32| {
            let [low, high] = bounds[axis];
            let x = ((x - 0.5 * (low + high)) / side + 0.5) * size as f32;
            (x as usize).min(size - 1)
        };
        projected().map(|[x, y]| (pixel(1, y) * size + pixel(0, x)) as u32).collect()
    }
}

/// Patches of the transformer's grid that hold chosen pixels, out of how many.
fn patches(config: &ModelConfig, choose: &[u32]) -> Option<(usize, usize)> {
    let ColorConfig::Vit(vit) = &config.color else { return None };
    let side = config.image_size / vit.patch_size;
    let used: std::collections::BTreeSet<usize> = choose
        .iter()
        .map(|&pixel| {
            let at = |x: usize| (x / vit.patch_size).min(side - 1);
            at(pixel as usize / config.image_size) * side + at(pixel as usize % config.image_size)
        })
        .collect();
    Some((used.len(), side * side))
}

/// Largest resident memory of this process so far; known on Linux.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().trim_end_matches("kB").trim().parse::<u64>().ok()? / 1024)
}
