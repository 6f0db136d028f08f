//! A printed can in front of a wall, seen from two sides.

use image::{Rgb, RgbImage};
use nalgebra::{Matrix3, Rotation3, Vector3};
use unopose_core::{
    frame::{DepthMap, Mask, MaskedView, RgbdFrame},
    geometry::{Intrinsics, Pose},
};

use super::*;

const RADIUS: f64 = 0.04;
const SIZE: [u32; 2] = [160, 120];

/// The can's axis is the camera's y axis, 0.6 m away; `turn` about it in radians. Colours are multiplied by `gain`.
pub(crate) fn can(turn: f64, gain: f64) -> (RgbdFrame, Mask) {
    let [width, height] = SIZE;
    let intrinsics = Intrinsics { fx: 400.0, fy: 400.0, cx: 79.5, cy: 59.5 };
    let mut frame = RgbdFrame {
        rgb: RgbImage::new(width, height),
        depth: DepthMap { width, height, data: vec![0.9; (width * height) as usize] },
        intrinsics,
    };
    let mut mask = Mask::empty(width, height);
    for row in 0..height {
        for col in 0..width {
            let ray = intrinsics.back_project(col.into(), row.into(), 1.0);
            // |(x z, z) - (0, 0.6)| = RADIUS in the plane across the axis.
            let (a, b, c) = (ray.x * ray.x + 1.0, 0.6, 0.36 - RADIUS * RADIUS);
            let root = b * b - a * c;
            if root <= 0.0 {
                continue;
            }
            let z = (b - root.sqrt()) / a;
            if (ray.y * z).abs() > 0.05 {
                continue;
            }
            let angle = (ray.x * z).atan2(0.6 - z) - turn;
            let print = |phase: f64, times: f64| 0.5 + 0.4 * (times * angle + phase + 30.0 * ray.y).sin();
            let color = [print(0.0, 3.0), print(1.0, 5.0), print(2.0, 2.0)];
            frame.rgb.put_pixel(col, row, Rgb(color.map(|v| (255.0 * gain * v) as u8)));
            let index = (row * width + col) as usize;
            frame.depth.data[index] = z as f32;
            mask.data[index] = true;
        }
    }
    (frame, mask)
}

/// Turn about the can's axis, then a shift.
pub(crate) fn turned(degrees: f64, shift: [f64; 3]) -> Pose {
    let rotation = *Rotation3::from_axis_angle(&Vector3::y_axis(), degrees.to_radians()).matrix();
    let center = Vector3::new(0.0, 0.0, 0.6);
    Pose::new(rotation, center - rotation * center + Vector3::from(shift))
}

pub(crate) fn view((frame, mask): &(RgbdFrame, Mask)) -> AppearanceView {
    AppearanceView::new(MaskedView { frame, mask }).unwrap()
}

#[test]
fn the_print_tells_the_turn_of_a_can() {
    // A turn by +angle about y moves the near side towards -x: the print's angle falls.
    let (query, reference) = (view(&can((-30f64).to_radians(), 1.0)), view(&can(0.0, 1.0)));
    let dark = view(&can((-30f64).to_radians(), 0.6));
    for detail in [Detail::Fine, Detail::Blurred] {
        let of = |query: &AppearanceView, degrees| {
            Agreement::of(query, &reference, &turned(degrees, [0.0; 3]), 0.004, detail)
        };
        let right = of(&query, 30.0);
        assert!(right.color > 0.75 && right.on_surface > 0.6, "{right:?}");
        assert!(right.in_front < 0.06, "{right:?}");
        for degrees in [-30.0, 0.0, 60.0, 90.0] {
            let wrong = of(&query, degrees);
            assert!(wrong.color < 0.5 * right.color, "{degrees}: {wrong:?}");
            assert!((wrong.in_front - right.in_front).abs() < 0.06, "the shape is the same: {wrong:?}");
        }
        assert!((of(&dark, 30.0).color - right.color).abs() < 0.03, "a gain has no influence");
        // From the reference's side it is the inverse pose.
        let back = Agreement::of(&reference, &query, &turned(-30.0, [0.0; 3]), 0.004, detail);
        assert!((back.color - right.color).abs() < 1e-6 && back.on_surface == right.on_surface);
    }
}

#[test]
fn a_body_in_free_space_is_in_front_and_one_behind_the_surface_is_hidden() {
    let (query, reference) = (view(&can(0.0, 1.0)), view(&can(0.0, 1.0)));
    let of = |shift| Agreement::of(&query, &reference, &turned(0.0, shift), 0.004, Detail::Fine);
    let same = of([0.0; 3]);
    assert_eq!((same.on_surface, same.in_front), (1.0, 0.0));
    // 3 cm towards the query camera: the reference floats in front of the query's surface, the query is hidden behind
    // the reference's.
    let near = of([0.0, 0.0, -0.03]);
    assert!((0.35..0.55).contains(&near.in_front) && near.on_surface < 0.1, "{near:?}");
    // Beside it the camera sees the wall, 0.3 m behind.
    let beside = of([0.06, 0.0, 0.0]);
    assert!(beside.in_front > 0.3, "{beside:?}");
}

#[test]
fn a_plain_body_has_no_colours_that_agree() {
    let (mut frame, mask) = can(0.0, 1.0);
    frame.rgb.pixels_mut().for_each(|pixel| *pixel = Rgb([200, 200, 200]));
    let plain = view(&(frame, mask));
    let identity = Pose::new(Matrix3::identity(), Vector3::zeros());
    let agreement = Agreement::of(&plain, &plain, &identity, 0.004, Detail::Fine);
    assert!(agreement.color.abs() < 1e-6 && agreement.on_surface == 1.0, "{agreement:?}");
}

#[test]
fn maps_make_the_same_view_again() {
    let first = view(&can(0.3, 1.0));
    let again = AppearanceView::from_maps(
        *first.camera(),
        first.width(),
        first.depth().to_vec(),
        first.object().to_vec(),
        first.colors().to_vec(),
    );
    let pose = turned(10.0, [0.0; 3]);
    let of = |query| Agreement::of(query, &first, &pose, 0.004, Detail::Blurred);
    assert_eq!(of(&again), of(&first));
}
