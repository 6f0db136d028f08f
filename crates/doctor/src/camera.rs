//! Do intrinsics and image belong together?

use unopose_core::frame::RgbdFrame;

use super::{Check, Finding, Level};

/// Horizontal fields of view of depth cameras, degrees; outside the second range there is no such lens.
const FIELD: [[f64; 2]; 2] = [[20.0, 120.0], [5.0, 160.0]];
/// Ratio of the focal lengths, above 1.
const PIXEL_SHAPE: [f64; 2] = [1.1, 1.5];
/// How far the principal point is from the middle, as a share of the image's side; images that were cut out of larger ones
/// are farther off than lenses.
const OFF_CENTER: [f64; 2] = [0.2, 0.5];
/// Two ratios are the same within this.
const SAME: f64 = 0.06;

/// Field of view, pixel shape and principal point.
pub(crate) fn camera_finding(frame: &RgbdFrame) -> Finding {
    let k = &frame.intrinsics;
    let (width, height) = (f64::from(frame.width()), f64::from(frame.height()));
    let field = 2.0 * (width / (2.0 * k.fx)).atan().to_degrees();
    let [usual, possible] = FIELD.map(|[low, high]| (low..=high).contains(&field));
    let lens = if usual {
        Level::Ok
    } else if possible {
        Level::Look
    } else {
        Level::Wrong
    };
    let shape = Level::of((k.fx / k.fy).max(k.fy / k.fx), PIXEL_SHAPE);
    let off = (k.cx / width - 0.5).abs().max((k.cy / height - 0.5).abs());
    let center = Level::of(off, OFF_CENTER);
    // Of an image of another size the principal point is off by the same ratio in both directions.
    let ratio = [2.0 * k.cx / width, 2.0 * k.cy / height];
    let scaled = center > Level::Ok && (ratio[0] / ratio[1] - 1.0).abs() < SAME && ratio[0] > 0.0;
    let level = if scaled { Level::Wrong } else { lens.max(shape).max(center) };

    let mut text = format!(
        "{} x {} pixels, field of view {field:.0} degrees, principal point ({:.1}, {:.1})",
        frame.width(),
        frame.height(),
        k.cx,
        k.cy
    );
    if shape > Level::Ok {
        text = format!("{text}, focal lengths {:.1} and {:.1}", k.fx, k.fy);
    }
    let advice = if scaled {
        let size = [width * ratio[0], height * ratio[1]].map(f64::round);
        format!(
            "the intrinsics are those of an image of about {:.0} x {:.0} pixels: scale them to this one",
            size[0], size[1]
        )
    } else if lens > Level::Ok {
        "fx does not fit the image's width: take the intrinsics of this camera at this size".into()
    } else if shape > Level::Ok {
        "fx and fy are nearly equal in cameras with square pixels: are both in pixels, and of this image?"
            .into()
    } else {
        "the principal point is near the image's middle in an image that was not cut: is it cx, cy of this image?".into()
    };
    Finding::new(Check::Camera, level, text)
        .with_values([("field_of_view_deg", field), ("off_center", off), ("fx_over_fy", k.fx / k.fy)])
        .advise(advice)
}
