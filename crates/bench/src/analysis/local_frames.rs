//! How alike the local reference frames of the same place are in both views.

use unopose_core::{
    config::ModelConfig,
    geometry::{FrameAxes, LocalFrames, Pose, local_frames, nearest_match},
};

use super::record::FrameDifference;

/// Points count as the same place up to here, radii: half the spacing of the dense points.
const SAME_PLACE: f32 = 0.05;

/// Differences for both balls of the positional encoding, over the query's points with a reference point at the same place.
/// Clouds in radii; `None` without such points.
pub(crate) fn frame_differences(
    query: &[[f32; 3]],
    reference: &[[f32; 3]],
    t_reference_query: &Pose,
    config: &ModelConfig,
) -> [Option<FrameDifference>; 2] {
    let moved: Vec<[f32; 3]> = query.iter().map(|p| t_reference_query.transform_f32(p)).collect();
    let matches = nearest_match(&moved, reference, SAME_PLACE);
    let form = LocalFrames::of(&config.quirks);
    std::array::from_fn(|ball| {
        let (radius, samples) = (config.fine.pe_radii[ball], config.fine.pe_samples[ball]);
        let [of_query, of_reference] = [&moved, reference].map(|p| local_frames(p, radius, samples, form));
        let pairs = of_query
            .iter()
            .zip(&matches)
            .filter_map(|(axes, &label)| Some((axes, of_reference.get((label as usize).checked_sub(1)?)?)));
        let (mut frames, mut normals): (Vec<f64>, Vec<f64>) = pairs
            .map(|(a, b)| (frame_angle(a, b), a.z.dot(&b.z).clamp(-1.0, 1.0).acos().to_degrees()))
            .unzip();
        Some(FrameDifference { frame_deg: median(&mut frames)?, normal_deg: median(&mut normals)? })
    })
}

/// Angle of the rotation between two frames, degrees. The x and y axes of flat neighbourhoods are shorter than 1.
fn frame_angle(a: &FrameAxes, b: &FrameAxes) -> f64 {
    let axes = [(a.x, b.x), (a.y, b.y), (a.z, b.z)];
    let trace: f64 = axes.iter().map(|(u, v)| u.dot(v) / (u.norm() * v.norm()).max(1e-12)).sum();
    ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees()
}

fn median(values: &mut [f64]) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn moved_clouds_agree_and_counted_padding_follows_the_order_of_points() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let bump = |[x, y]: [f32; 2]| [x, y, 0.3 * (3.0 * x).sin() * (2.0 * y + 0.4).cos()];
        let query: Vec<[f32; 3]> = (0..500)
            .map(|_| bump([random.random_range(-1.0..1.0), random.random_range(-1.0..1.0)]))
            .collect();
        let axis = Vector3::new(0.3, -0.8, 0.5);
        let pose = Pose::new(*Rotation3::new(axis).matrix(), Vector3::new(0.2, -0.1, 0.4));
        let mut reference: Vec<[f32; 3]> = query.iter().map(|p| pose.transform_f32(p)).collect();
        reference.reverse();
        let mut config = ModelConfig::default();
        (config.fine.pe_radii, config.fine.pe_samples) = ([0.15, 0.3], [64, 64]);
        let differences = |padding: bool| {
            let mut config = config.clone();
            config.quirks.local_frames_count_padding = padding;
            frame_differences(&query, &reference, &pose, &config).map(|d| d.unwrap())
        };
        for d in differences(false) {
            assert!(d.frame_deg < 0.1 && d.normal_deg < 0.1, "{d:?}");
        }
        // Which neighbour is found first, and outweighs the others, depends on the order of the points.
        for d in differences(true) {
            assert!(d.frame_deg > 10.0, "{d:?}");
        }
        let nothing = frame_differences(&query, &[[9.0; 3]], &pose, &config);
        assert_eq!(nothing, [None, None]);
    }
}
