//! Times of the geometric steps at the paper's sizes:
//! `cargo test --release --test data geometry_timing -- --ignored --nocapture`.

use std::time::Instant;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_core::{config::HypothesisConfig, geometry::*};

/// Half of a bumpy unit sphere, as a camera sees it.
fn half_surface(n: usize, rng: &mut ChaCha8Rng) -> Vec<[f32; 3]> {
    (0..n)
        .map(|_| {
            let (z, a) = (rng.random_range(-1.0f32..0.0), rng.random_range(0.0..std::f32::consts::TAU));
            let (rho, bump) = ((1.0 - z * z).sqrt(), 1.0 + 0.1 * (5.0 * a).sin() * z);
            [bump * rho * a.cos(), bump * rho * a.sin(), bump * z + 7.0]
        })
        .collect()
}

/// Best of five, milliseconds.
fn time<T>(name: &str, mut f: impl FnMut() -> T) -> T {
    let mut best = f64::INFINITY;
    let mut result = f();
    for _ in 0..5 {
        let start = Instant::now();
        result = f();
        best = best.min(start.elapsed().as_secs_f64() * 1e3);
    }
    println!("{name:45} {best:8.3} ms");
    result
}

#[test]
#[ignore = "a measurement, not a check"]
fn steps_at_the_papers_sizes() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let raw = half_surface(5000, &mut rng);
    let kept = time("farthest_point_sampling 5000 -> 2048", || farthest_point_sampling(&raw, 2048));
    let points: Vec<[f32; 3]> = kept.iter().map(|&i| raw[i as usize]).collect();
    let sparse = time("farthest_point_sampling 2048 -> 196", || farthest_point_sampling(&points, 196));
    let sparse: Vec<[f32; 3]> = sparse.iter().map(|&i| points[i as usize]).collect();
    time("global_reference_frame 5000", || global_reference_frame(&raw, false));
    time("ball_groups 2048, radius 0.1, 64", || ball_groups(&points, 0.1, 64, Some(LocalFrames::default())));
    time("ball_groups 2048, radius 0.2, 256", || {
        ball_groups(&points, 0.2, 256, Some(LocalFrames::default()))
    });
    let frame = global_reference_frame(&sparse, false);
    time("structure_indices 197 x 197 x 3", || structure_indices(&frame, 0.2, 15.0, 3));
    time("nearest_distances 2048 x 2048", || nearest_distances(&points, &points));

    for (name, cloud) in [("196", &sparse), ("2048", &points)] {
        let n = cloud.len();
        let similarity: Vec<f32> = (0..(n + 1) * (n + 1))
            .map(|k| if k / (n + 1) == k % (n + 1) { 8.0 } else { rng.random_range(-10.0..5.0) })
            .collect();
        let ones = vec![1.0; n];
        let assignment =
            time(&format!("match_assignment {name}"), || match_assignment(&similarity, &ones, &ones));
        if n < 1000 {
            let config = HypothesisConfig::default();
            for degenerate in [true, false] {
                let mut uniforms = ChaCha8Rng::seed_from_u64(2);
                time(&format!("coarse_pose 6000 -> 300, degenerate {degenerate}"), || {
                    coarse_pose(&assignment, cloud, cloud, &config, || uniforms.random(), degenerate)
                });
            }
        } else {
            time("fine_pose 2048", || fine_pose(&assignment, cloud, cloud));
        }
    }
}
