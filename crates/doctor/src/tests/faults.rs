//! Every fault is found, with the advice that mends it.

use image::imageops;

use super::*;

#[test]
fn a_shift_between_colour_and_depth_is_measured() {
    for (right, down, level) in [(4i64, -3i64, Level::Wrong), (-3, 2, Level::Look), (0, 6, Level::Wrong)] {
        let mut shot = shot();
        let still = shot.frame.rgb.clone();
        imageops::replace(&mut shot.frame.rgb, &still, right, down);
        let finding = shot.finding(Check::Alignment);
        let found = [finding.values["right_px"], finding.values["down_px"]];
        assert!(
            (found[0] - right as f64).abs() <= 1.0 && (found[1] - down as f64).abs() <= 1.0,
            "{finding:?}"
        );
        assert_eq!(finding.level, level, "{finding}");
    }
}

#[test]
fn masks_that_leak_or_are_too_tight_are_told_apart() {
    let clean = shot();
    let with = |mask: Mask| Shot { mask, ..clean.clone() }.finding(Check::Mask);
    let wide = with(grown(&clean.mask, 5));
    // Along rows and columns, slanted borders move more than five pixels.
    assert!((-8.0..=-5.0).contains(&wide.values["outwards_px"]) && wide.text.contains("too wide"), "{wide}");
    assert!(wide.level >= Level::Look && wide.advice.contains("leaks"), "{wide}");
    let tight = with(inverted(&grown(&inverted(&clean.mask), 5)));
    assert!(
        (5.0..=8.0).contains(&tight.values["outwards_px"]) && tight.text.contains("too tight"),
        "{tight}"
    );
    assert!(tight.level >= Level::Look && tight.advice.contains("goes on"), "{tight}");

    // A part of the table behind the box, as large as half the box.
    let mut leaky = clean.mask.clone();
    let top = clean.mask.bounding_box().unwrap();
    let center = (top.col_min + top.col_max) / 2;
    for (col, row) in
        (center - 30..center + 30).flat_map(|c| (top.row_min - 30..top.row_min + 25).map(move |r| (c, r)))
    {
        leaky.data[(row * 320 + col) as usize] = true;
    }
    let added = (leaky.count() - clean.mask.count()) as f64 / leaky.count() as f64;
    let leaky = with(leaky);
    assert!((leaky.values["leak"] - added).abs() < 0.05, "{added}: {leaky}");
    assert!(leaky.level >= Level::Look && leaky.advice.contains("leaks"), "{leaky}");

    let inverse = with(inverted(&clean.mask));
    assert!(inverse.level >= Level::Look && inverse.advice.contains("inverted"), "{inverse}");
}

#[test]
fn dark_and_clipped_images_are_named() {
    let exposed = |gain: f32| {
        let mut shot = shot();
        shot.frame.rgb.pixels_mut().for_each(|p| p.0 = p.0.map(|c| (f32::from(c) * gain) as u8));
        shot.finding(Check::Exposure)
    };
    assert_eq!(exposed(1.0).level, Level::Ok);
    for (gain, level, part) in
        [(0.2, Level::Look, "dark"), (0.02, Level::Wrong, "dark"), (12.0, Level::Wrong, "bright")]
    {
        let finding = exposed(gain);
        assert!(finding.level == level && finding.advice.contains(part), "{gain}: {finding}");
    }
}

#[test]
fn a_wrong_unit_is_named_with_the_right_one() {
    let shot = shot();
    let object = MaskedObject::measure(&shot.frame.masked_points(&shot.mask)).unwrap();
    for (taken, right, level) in [
        (1000.0, 1.0, Level::Wrong),
        (1.0, 0.1, Level::Look),
        (0.1, 1.0, Level::Look),
        (1.0, 1000.0, Level::Wrong),
    ] {
        let factor = taken / right;
        let seen = MaskedObject {
            distance: object.distance * factor,
            radius: object.radius * factor,
            extent: object.extent.map(|side| side * factor),
        };
        let finding = unit_finding(&seen, Some(taken));
        let expected = format!("depth_scale of {right} instead of {taken}");
        assert!(finding.level == level && finding.advice.contains(&expected), "{finding}");
        // The advice tells what the object is really like.
        assert!(finding.advice.contains(&shot.finding(Check::Unit).text[21..40]), "{finding}");
        let times = if factor > 1.0 { "times smaller" } else { "times larger" };
        assert!(unit_finding(&seen, None).advice.contains(times));
    }
}

#[test]
fn sizes_of_reference_and_query_check_each_other() {
    let object = MaskedObject { distance: 0.7, radius: 0.08, extent: [0.18, 0.12, 0.08] };
    let level = |ratio: f64| pair_finding(&object, &MaskedObject { radius: 0.08 * ratio, ..object }).level;
    for (ratio, expected) in [
        (1.0, Level::Ok),
        (3.0, Level::Ok),
        (0.3, Level::Ok),
        (5.0, Level::Look),
        (10.0, Level::Wrong),
        (0.1, Level::Look),
    ] {
        assert_eq!(level(ratio), expected, "{ratio}");
    }
    assert_eq!(level(f64::NAN), Level::Wrong);
}

#[test]
fn intrinsics_of_another_size_are_named() {
    let mut shot = shot();
    shot.frame.intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 319.5, cy: 239.5 };
    let finding = shot.finding(Check::Camera);
    assert_eq!(finding.level, Level::Wrong);
    assert!(finding.advice.contains("639 x 479"), "{finding}");
    shot.frame.intrinsics = Intrinsics { fx: 30_000.0, ..CAMERA };
    assert_eq!(shot.finding(Check::Camera).level, Level::Wrong);
    shot.frame.intrinsics = Intrinsics { fy: 360.0, ..CAMERA };
    let finding = shot.finding(Check::Camera);
    assert!(finding.level == Level::Look && finding.text.contains("300.0 and 360.0"), "{finding}");
}

#[test]
fn missing_depth_and_few_points_are_counted() {
    let mut shot = shot();
    let pixels: Vec<(u32, u32)> = shot.mask.pixels().collect();
    let total = pixels.len();
    let mut blind = |count: usize| {
        pixels.iter().take(count).for_each(|&(c, r)| shot.frame.depth.data[(r * 320 + c) as usize] = 0.0);
        (shot.finding(Check::Depth), shot.finding(Check::Points))
    };
    let (depth, points) = blind(total * 3 / 5);
    assert!((depth.values["missing"] - 0.6).abs() < 0.01 && depth.level == Level::Look, "{depth}");
    assert_eq!(points.values["points"] as usize, total - total * 3 / 5);
    let (depth, points) = blind(total - 20);
    assert!(depth.level == Level::Wrong && points.level == Level::Wrong, "{depth} {points}");
    blind(total);
    assert!(shot.findings().iter().all(|finding| finding.check != Check::Unit));
}
