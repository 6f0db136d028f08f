use nalgebra::{Rotation3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

use super::*;
use crate::appearance::tests::{can, turned, view};

/// A bumpy sheet of 0.16 m x 0.12 m seen from 0.7 m; `from` is the column where it begins, in metres.
fn sheet(from: f64, width: f64, noise: f64, rng: &mut ChaCha8Rng) -> Vec<[f32; 3]> {
    let normal = Normal::new(0.0, noise).unwrap();
    (0..8000)
        .map(|_| {
            let (x, y): (f64, f64) = (from + rng.random_range(0.0..width), rng.random_range(-0.06..0.06));
            let z = 0.7 + 0.010 * (x * 60.0).sin() * (y * 75.0).cos() + 0.4 * x * x + normal.sample(rng);
            [x as f32, y as f32, z as f32]
        })
        .collect()
}

fn off(degrees: f64, metres: f64) -> Pose {
    let centre = Vector3::new(0.0, 0.0, 0.7);
    let rotation = *Rotation3::new(Vector3::new(1.0, 2.0, -0.5).normalize() * degrees.to_radians()).matrix();
    Pose::new(rotation, centre - rotation * centre + Vector3::new(1.0, -1.0, 1.0).normalize() * metres)
}

fn errors(a: &Pose, b: &Pose) -> (f64, f64) {
    let centre = Vector3::new(0.0, 0.0, 0.7);
    let at = |pose: &Pose| pose.rotation * centre + pose.translation;
    ((at(a) - at(b)).norm(), a.rotation_angle_deg(b))
}

#[test]
fn a_noisy_half_overlapping_bumpy_surface_is_aligned() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let reference = IcpReference::new(&sheet(-0.08, 0.12, 0.0008, &mut rng)).unwrap();
    // 0.10 of the 0.12 m overlap; a neighbouring object has leaked into the mask.
    let truth = off(25.0, 0.1);
    let leak = (0..500).map(|_| [0.09, rng.random_range(-0.06..0.06), rng.random_range(0.6..0.65f32)]);
    let mut query: Vec<[f32; 3]> = leak.collect();
    query.extend(sheet(-0.06, 0.12, 0.0008, &mut rng));
    let query: Vec<[f32; 3]> = query.iter().map(|p| truth.transform_f32(p)).collect();
    for settings in [IcpSettings::POINT_TO_PLANE, IcpSettings::GENERALIZED] {
        let outcome = refine_with(&query, &reference, &(truth * off(5.0, 0.005)), &settings);
        let (shift, turn) = errors(&outcome.t_query_reference, &truth);
        assert!(outcome.accepted && outcome.residual[1] < 0.5 * outcome.residual[0], "{outcome:?}");
        assert!(shift < 0.0008 && turn < 0.4, "{shift} m, {turn} deg");
        assert!((outcome.motion[1] - 5.0).abs() < 0.5, "{outcome:?}");
    }
}

#[test]
fn it_stays_local_and_never_makes_it_worse() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let cloud = sheet(-0.08, 0.16, 0.0005, &mut rng);
    let reference = IcpReference::new(&cloud).unwrap();
    // Far starts: whatever comes back is within the limits of the start.
    for (degrees, metres) in [(20.0, 0.0), (60.0, 0.02), (5.0, 0.045), (170.0, 0.3)] {
        let start = off(degrees, metres);
        let outcome = refine_with(&cloud, &reference, &start, &IcpSettings::POINT_TO_PLANE);
        let (_, turn) = errors(&outcome.t_query_reference, &start);
        assert!(turn <= MAX_ROTATION_DEG, "{outcome:?}");
        let unchanged = outcome.t_query_reference == start;
        assert!(outcome.accepted || unchanged);
        assert!(!outcome.accepted || outcome.motion[0] <= MAX_TRANSLATION, "{outcome:?}");
    }
    let nothing = refine_with(&[], &reference, &off(1.0, 0.001), &IcpSettings::GENERALIZED);
    assert!(!nothing.accepted);
}

#[test]
fn a_start_as_good_as_the_noise_is_kept() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let reference = IcpReference::new(&sheet(-0.08, 0.16, 0.0008, &mut rng)).unwrap();
    for count in [2500, 8000] {
        let cloud = sheet(-0.08, 0.16, 0.0008, &mut rng);
        let start = off(0.1, 0.0001);
        let outcome = refine_with(&cloud[..count], &reference, &start, &IcpSettings::POINT_TO_PLANE);
        assert_eq!(outcome.t_query_reference, start, "{outcome:?}");
        // A start beyond the noise is still refined.
        let outcome =
            refine_with(&cloud[..count], &reference, &off(6.0, 0.004), &IcpSettings::POINT_TO_PLANE);
        let (shift, turn) = errors(&outcome.t_query_reference, &Pose::identity());
        assert!(outcome.accepted && shift < 0.002 && turn < 1.5, "{shift} m, {turn} deg, {outcome:?}");
    }
}

#[test]
fn undetermined_directions_keep_the_start() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let noise = Normal::new(0.0, 0.0007).unwrap();
    let mut plane = |half: f32| -> Vec<[f32; 3]> {
        let mut at = || rng.random_range(-half..half);
        let flat: Vec<[f32; 2]> = (0..6000).map(|_| [at(), at()]).collect();
        flat.into_iter().map(|[x, y]| [x, y, 0.6 + noise.sample(&mut rng) as f32]).collect()
    };
    let (reference, query) = (plane(0.08), plane(0.05));
    let reference = IcpReference::new(&reference).unwrap();
    // 2 degrees about x and 4 mm along the normal are seen, 6 mm along the plane are not.
    let turn = *Rotation3::new(Vector3::x() * 2f64.to_radians()).matrix();
    let centre = Vector3::new(0.0, 0.0, 0.6);
    let start = Pose::new(turn, centre - turn * centre + Vector3::new(0.006, 0.0, 0.004));
    let refined = refine(&query, &reference, &start);
    let moved = refined.rotation * centre + refined.translation - centre;
    assert!(moved.z.abs() < 0.0003, "{moved}");
    assert!((moved.x - 0.006).abs() < 0.001 && moved.y.abs() < 0.001, "{moved}");
    assert!(refined.rotation_angle_deg(&Pose::identity()) < 0.3);
}

#[test]
fn stray_pixels_are_no_surface() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut cloud = sheet(-0.08, 0.16, 0.0005, &mut rng);
    cloud.extend((0..20).map(|i| [0.0, 0.0, 0.8 + 0.02 * i as f32]));
    let reference = IcpReference::new(&cloud).unwrap();
    assert!(reference.points().iter().all(|p| p[2] < 0.75));
    assert!((1500..6000).contains(&reference.points().len()), "{}", reference.points().len());
    assert!(IcpReference::new(&[[0.0, 0.0, 1.0]; 50]).is_none() && IcpReference::new(&[]).is_none());
}

/// Degrees that are left after the refinement of a can that was turned by 30 degrees, from `start` degrees.
fn left_of_a_can(start: f64, gain: f64, plain: bool, with_colors: bool) -> (f64, IcpOutcome) {
    let (mut query, mut reference) = (can((-30f64).to_radians(), gain), can(0.0, 1.0));
    if plain {
        for view in [&mut query, &mut reference] {
            view.0.rgb.pixels_mut().for_each(|pixel| *pixel = image::Rgb([180, 180, 180]));
        }
    }
    let [query_points, reference_points] =
        [&query, &reference].map(|(frame, mask)| frame.masked_points(mask));
    let (query, reference) = (view(&query), view(&reference));
    let icp = IcpReference::new(&reference_points).unwrap().with_colors(&reference);
    let surface = icp.query(&query_points, with_colors.then_some(&query)).unwrap();
    let outcome =
        refine_query(&surface, &icp, &turned(start, [0.0; 3]), &IcpSettings::POINT_TO_PLANE.colored());
    (outcome.t_query_reference.rotation_angle_deg(&turned(30.0, [0.0; 3])), outcome)
}

#[test]
fn colours_hold_what_the_shape_leaves_open() {
    for (start, gain) in [(20.0, 1.0), (40.0, 1.0), (20.0, 0.6), (40.0, 1.3)] {
        let (left, outcome) = left_of_a_can(start, gain, false, true);
        assert!(
            outcome.accepted && left < 5.0,
            "from {start} at gain {gain}: {left} degrees left, {outcome:?}"
        );
        // The shape alone lets it slide.
        let (left, outcome) = left_of_a_can(start, gain, false, false);
        assert!((left - f64::abs(start - 30.0)).abs() < 2.0, "{left} degrees left, {outcome:?}");
    }
    // A plain can has nothing to hold on to.
    let (left, outcome) = left_of_a_can(24.0, 1.0, true, true);
    assert!((left - 6.0).abs() < 1.5, "{left} degrees left, {outcome:?}");
}
