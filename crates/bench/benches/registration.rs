//! Times of classical registration on one core: `cargo bench --bench registration [-- --rounds 9]`.
//!
//! A bumpy body seen from two sides, 28 degrees apart, 0.7 mm of noise; the clouds are thinned to about 2000 points each
//! for the descriptors, and to the methods' own spacing for whole pairs. Minimum and median over the rounds.

use std::{hint::black_box, time::Instant};

use clap::Parser;
use nalgebra::{Point3, Rotation3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use unopose_core::geometry::Pose;
use unopose_pairs::registration::{
    AlignCenter, CloudRegistration, FpfhMac, FpfhRansac, Ppf, Refinement, Surface, fpfh, nearest_features,
};

#[derive(Parser)]
struct Arguments {
    #[arg(long, default_value_t = 9)]
    rounds: usize,
    /// Cores.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// Passed by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

/// Points of the descriptors.
const POINTS: usize = 2000;
/// Radius of their neighbourhoods in cells, that of the methods.
const RADIUS_CELLS: f32 = 5.0;

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    rayon::ThreadPoolBuilder::new().num_threads(arguments.threads).build()?.install(|| run(arguments.rounds))
}

fn run(rounds: usize) -> anyhow::Result<()> {
    let [query, reference] = [(28.0, 1), (0.0, 2)].map(|(degrees, seed)| view(degrees, seed));
    println!("{} and {} measured points, {rounds} rounds", query.len(), reference.len());
    println!("| step | points | minimum ms | median ms |\n|--|--|--|--|");
    let cell = cell_for(&reference, POINTS)?;
    let surface = |points: &[[f32; 3]]| Surface::new(points, cell, "view");
    let surfaces = [surface(&query)?, surface(&reference)?];
    let points = format!("{} + {}", surfaces[0].points.len(), surfaces[1].points.len());
    row("voxel grid and normals", &points, rounds, || [surface(&query), surface(&reference)]);
    row("FPFH", &points, rounds, || surfaces.each_ref().map(|s| fpfh(s, RADIUS_CELLS * cell)));
    let features = surfaces.each_ref().map(|s| fpfh(s, RADIUS_CELLS * cell));
    row("matches of FPFH", &points, rounds, || nearest_features(&features[0], &features[1], 3));
    let methods: [Box<dyn CloudRegistration>; 4] = [
        Box::new(AlignCenter),
        Box::new(FpfhRansac::default()),
        Box::new(FpfhMac::default()),
        Box::new(Ppf::default()),
    ];
    for method in methods {
        let name = format!("whole pair: {}", method.name());
        row(&name, "all", rounds, || method.register(&query, &reference));
    }
    let (pose, _) = FpfhRansac::default().register(&query, &reference)?;
    for refinement in [Refinement::Icp, Refinement::Gicp] {
        let name = format!("refinement: {refinement}");
        row(&name, "all", rounds, || refinement.apply(&query, &reference, &pose));
    }
    Ok(())
}

fn row<T>(step: &str, points: &str, rounds: usize, mut work: impl FnMut() -> T) {
    black_box(work());
    let mut times: Vec<f64> = (0..rounds.max(1))
        .map(|_| {
            let start = Instant::now();
            black_box(work());
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("| {step} | {points} | {:.1} | {:.1} |", times[0], times[times.len() / 2]);
}

/// The spacing that leaves about `count` points.
fn cell_for(points: &[[f32; 3]], count: usize) -> anyhow::Result<f32> {
    let (mut low, mut high) = (1e-4f32, 0.05f32);
    for _ in 0..12 {
        let middle = (low * high).sqrt();
        if Surface::new(points, middle, "view")?.points.len() > count { low = middle } else { high = middle }
    }
    Ok(high)
}

/// The half of the body that faces the camera, about as dense as a depth image from 0.6 m.
fn view(degrees: f64, seed: u64) -> Vec<[f32; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rotation = Rotation3::from_axis_angle(&Vector3::y_axis(), degrees.to_radians());
    let pose = Pose::new(*rotation.matrix(), Vector3::new(0.0, 0.0, 0.6));
    let radius = |n: &Vector3<f64>| {
        0.06 + 0.012 * (5.0 * n.x + 2.0 * n.y).sin() * (4.0 * n.y - n.z).cos() + 0.02 * n.x * n.y
    };
    let mut points = Vec::new();
    while points.len() < 20_000 {
        let n = Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng)).normalize();
        let p: Point3<f64> = pose.transform(&Point3::from(n * radius(&n)));
        let noise: f64 = StandardNormal.sample(&mut rng);
        if (pose.rotation * n).z < -0.2 && rng.random_bool(0.9) {
            points.push([p.x as f32, p.y as f32, (p.z + 0.0007 * noise) as f32]);
        }
    }
    points
}
