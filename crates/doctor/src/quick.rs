//! What one pass over a mask tells: cheap enough for every estimate.

use unopose_core::frame::MaskedView;
use unopose_pairs::data::{Plausibility, plausibility, scale_correction};

use super::{Check, Finding, Level, MaskedObject, camera::camera_finding};

/// Share of the mask without depth.
const MISSING: [f64; 2] = [0.5, 0.95];
/// Share of the mask that is clipped, and share that is black.
const CLIPPED: [f64; 2] = [0.4, 0.9];
const BLACK: [f64; 2] = [0.7, 0.97];
/// Mean brightness, 0..255, below which little is seen.
const DARK: [f64; 2] = [25.0, 8.0];
/// A channel is clipped from here on, and a pixel black up to here.
const CLIP: u8 = 250;
const BLACK_VALUE: u8 = 10;
/// Share of the network's points below which the object is small, and fewest points.
const FEW: f64 = 0.5;
const FEWEST: usize = 32;
/// Ratio of the radii of reference and query.
const PAIR_RATIO: [f64; 2] = [4.0, 8.0];

/// What a view is measured against.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Millimetres per unit of the depth image, where it is known.
    pub depth_scale: Option<f64>,
    /// Points that the network samples.
    pub points: usize,
}

/// Camera, unit, missing depth, points and exposure of a masked object. The colours, depth and mask are equally large.
pub fn quick_findings(view: MaskedView<'_>, expected: &Expected) -> Vec<Finding> {
    let points = view.points();
    let masked = view.mask.count();
    let object = MaskedObject::measure(&points);
    let mut findings = vec![camera_finding(view.frame)];
    findings.extend(object.map(|object| unit_finding(&object, expected.depth_scale)));
    findings.push(depth_finding(points.len(), masked));
    findings.push(points_finding(points.len(), expected.points));
    findings.push(exposure_finding(view));
    findings
}

/// Distance and extent of the object, which nobody but the user can confirm.
pub fn unit_finding(object: &MaskedObject, depth_scale: Option<f64>) -> Finding {
    let MaskedObject { distance, radius, extent } = *object;
    let level = match plausibility(distance, radius) {
        Plausibility::Usual => Level::Ok,
        Plausibility::Unusual => Level::Look,
        Plausibility::Impossible => Level::Wrong,
    };
    let size = |factor: f64| {
        let [a, b, c] = extent.map(|side| length(side * factor * 100.0));
        format!("{a} x {b} x {c} cm, {} m away", length(distance * factor))
    };
    let advice = match (scale_correction(distance, radius, depth_scale), depth_scale) {
        (Some(factor), Some(scale)) => format!(
            "with a depth_scale of {} instead of {scale} (millimetres per unit of the depth image) it would be {}",
            rounded(factor * scale),
            size(factor)
        ),
        (Some(factor), None) if factor < 1.0 => {
            format!("with a depth unit {} times smaller it would be {}", rounded(1.0 / factor), size(factor))
        }
        (Some(factor), None) => {
            format!("with a depth unit {} times larger it would be {}", rounded(factor), size(factor))
        }
        (None, _) => "does the mask show the object alone, and is depth_scale right?".into(),
    };
    Finding::new(Check::Unit, level, format!("the masked object is {}: is that right?", size(1.0)))
        .with_values([
            ("distance_m", distance),
            ("radius_m", radius),
            ("length_m", extent[0]),
            ("width_m", extent[1]),
            ("height_m", extent[2]),
        ])
        .advise(advice)
}

/// Do reference and query show an object of about the same size?
pub fn pair_finding(reference: &MaskedObject, query: &MaskedObject) -> Finding {
    let ratio = query.radius / reference.radius;
    // A small part of the object may be all that a query shows; no part is larger than the object.
    let level = match Level::of(ratio, PAIR_RATIO).max(Level::of(1.0 / ratio, [PAIR_RATIO[0], f64::INFINITY]))
    {
        _ if !ratio.is_finite() => Level::Wrong,
        level => level,
    };
    let centimetres = |object: &MaskedObject| length(object.radius * 100.0);
    let text = format!(
        "the object's radius is {} cm in the query and {} cm in the reference",
        centimetres(query),
        centimetres(reference)
    );
    Finding::new(Check::Pair, level, text)
        .with_values([("query_over_reference", ratio)])
        .advise("do the units of both depth images differ, or does a mask show something else?")
}

fn depth_finding(measured: usize, masked: usize) -> Finding {
    let missing = 1.0 - measured as f64 / masked.max(1) as f64;
    let text = format!("{:.0} % of the mask's {masked} pixels have no depth", 100.0 * missing);
    Finding::new(Check::Depth, Level::of(missing, MISSING), text).with_values([("missing", missing)]).advise(
        "dark, shiny and transparent surfaces, and those nearer than the camera measures, have no depth; is the depth \
         image registered to the colour image?",
    )
}

fn points_finding(measured: usize, wanted: usize) -> Finding {
    let level = match measured {
        n if n < FEWEST => Level::Wrong,
        n if (n as f64) < FEW * wanted as f64 => Level::Look,
        _ => Level::Ok,
    };
    Finding::new(Check::Points, level, format!("{measured} measured points, the network samples {wanted}"))
        .with_values([("points", measured as f64), ("wanted", wanted as f64)])
        .advise("go nearer, or take a larger image")
}

fn exposure_finding(view: MaskedView<'_>) -> Finding {
    let (mut clipped, mut black, mut sum, mut count) = (0usize, 0usize, 0.0, 0usize);
    for (col, row) in view.mask.pixels() {
        let Some(pixel) = view.frame.rgb.get_pixel_checked(col, row) else { continue };
        let [r, g, b] = pixel.0;
        let high = r.max(g).max(b);
        clipped += usize::from(r.min(g).min(b) >= CLIP);
        black += usize::from(high <= BLACK_VALUE);
        sum += 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
        count += 1;
    }
    let share = |n: usize| n as f64 / count.max(1) as f64;
    let (clipped, black, mean) = (share(clipped), share(black), sum / count.max(1) as f64);
    let [bright, dark] = [Level::of(clipped, CLIPPED), Level::of(black, BLACK)];
    let dark = dark.max(Level::of(-mean, DARK.map(|limit| -limit)));
    let text = format!(
        "mean brightness {mean:.0} of 255, {:.0} % of the mask clipped, {:.0} % black",
        100.0 * clipped,
        100.0 * black
    );
    let advice = if dark > bright {
        "too dark: give more light or a longer exposure"
    } else {
        "too bright: less light or a shorter exposure"
    };
    Finding::new(Check::Exposure, bright.max(dark), text)
        .with_values([("brightness", mean), ("clipped", clipped), ("black", black)])
        .advise(advice)
}

/// With about three digits.
fn length(value: f64) -> String {
    match value.abs() {
        v if v >= 100.0 => format!("{value:.0}"),
        v if v >= 1.0 => format!("{value:.1}"),
        v if v >= 0.1 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    }
}

/// Without the rounding errors of a quotient.
fn rounded(value: f64) -> f64 {
    format!("{value:.6e}").parse().unwrap_or(value)
}
