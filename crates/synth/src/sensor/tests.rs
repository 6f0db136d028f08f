use unopose_dataset::render::Finish;

use super::*;
use crate::random::{Domain, stream};

const SIZE: (usize, usize) = (320, 240);

/// A matt grey plane across the view with a square 30 cm nearer in the middle.
fn step(z: f32, albedo: f32) -> Rendering {
    let (w, h) = SIZE;
    let n = w * h;
    let mut depth = DepthMap { width: w as u32, height: h as u32, data: vec![z; n] };
    for i in 0..n {
        if (120..200).contains(&(i % w)) && (80..160).contains(&(i / w)) {
            depth.data[i] = z - 0.3;
        }
    }
    Rendering {
        radiance: vec![[albedo; 3]; n],
        depth,
        ids: vec![0; n],
        incidence: vec![0.95; n],
        albedo: vec![albedo; n],
        finish: vec![Finish { roughness: 1.0, metallic: 0.0 }; n],
    }
}

fn measure(style: Style, view: &Rendering, seed: u64) -> DepthMap {
    let config = SensorConfig { noise_gain: [1.0, 1.0], ..SensorConfig::default() };
    let mut rng = stream(seed, Domain::Sensor, 0);
    let sensor = DepthSensor { style, baseline: 0.075, edges: 1.0, ..DepthSensor::draw(&config, &mut rng) };
    // Fine contrast, so that stereo finds something to match.
    let picture: Vec<f32> = (0..view.albedo.len()).map(|i| 0.4 + 0.1 * (i % 2) as f32).collect();
    sensor.measure(view, 300.0, &picture, &config, &mut rng)
}

/// Standard deviation far from the edges, and share of holes there.
fn noise(style: Style, z: f32, albedo: f32) -> (f32, f32) {
    let (mut errors, mut holes, mut count) = (Vec::new(), 0, 0);
    for seed in 0..3 {
        let measured = measure(style, &step(z, albedo), seed);
        for (_, &d) in measured.data.iter().enumerate().filter(|(i, _)| i % SIZE.0 < 100) {
            count += 1;
            if d > 0.0 { errors.push(d - z) } else { holes += 1 }
        }
    }
    let mean = errors.iter().sum::<f32>() / errors.len() as f32;
    let variance = errors.iter().map(|e| (e - mean).powi(2)).sum::<f32>() / errors.len() as f32;
    (variance.sqrt(), holes as f32 / count as f32)
}

#[test]
fn disparity_noise_grows_with_the_square_of_the_distance_and_phase_noise_more_slowly() {
    for style in [Style::StructuredLight, Style::Stereo] {
        let ratio = noise(style, 1.5, 0.3).0 / noise(style, 0.75, 0.3).0;
        assert!((3.4..4.6).contains(&ratio), "{style:?}: {ratio}");
    }
    // Khoshelham & Elberink: about 1.4 mm at 1 m; here between one and four.
    let kinect = noise(Style::StructuredLight, 1.0, 0.3).0;
    assert!((0.001..0.004).contains(&kinect), "{kinect}");
    let (near, far) = (noise(Style::TimeOfFlight, 0.75, 0.3).0, noise(Style::TimeOfFlight, 1.5, 0.3).0);
    assert!((1.8..3.2).contains(&(far / near)), "{near} {far}");
    let dark = noise(Style::TimeOfFlight, 0.75, 0.05).0;
    assert!(dark > 1.8 * near, "{dark} {near}");
}

#[test]
fn dark_surfaces_and_edges_lose_depth() {
    for style in [Style::StructuredLight, Style::Stereo, Style::TimeOfFlight] {
        let (grey, black) = (noise(style, 0.8, 0.3).1, noise(style, 0.8, 0.01).1);
        assert!(grey < 0.02 && black > 0.2, "{style:?}: {grey} {black}");
        let measured = measure(style, &step(0.9, 0.3), 4);
        let band = |from: usize, to: usize| {
            let pixels = (90..150).flat_map(|row| (from..to).map(move |col| row * SIZE.0 + col));
            let (all, lost) =
                pixels.fold((0, 0), |(n, l), i| (n + 1, l + usize::from(measured.data[i] == 0.0)));
            lost as f32 / all as f32
        };
        let (edge, inside) = (band(118, 122).max(band(198, 202)), band(150, 170));
        assert!(edge > inside + 0.2, "{style:?}: {edge} {inside}");
        // Only a time-of-flight camera and flying pixels report depth between the surfaces.
        let between = measured.data.iter().filter(|z| (0.65..0.85).contains(*z)).count();
        assert!(between < 400, "{style:?}: {between} pixels between the surfaces");
    }
    let phase = measure(Style::TimeOfFlight, &step(0.9, 0.3), 1);
    assert!(phase.data.iter().all(|z| ((z * 1000.0).round() - z * 1000.0).abs() < 1e-3));
}
