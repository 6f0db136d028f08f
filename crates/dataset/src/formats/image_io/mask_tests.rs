use image::{DynamicImage, GrayImage, ImageBuffer, Luma, RgbImage, Rgba, RgbaImage};
use unopose_core::frame::Mask;

use super::*;

/// 24 x 20 with a disc of value 1 and radius 7 in the middle.
fn disc(col: u32, row: u32) -> bool {
    (col as i32 - 12).pow(2) + (row as i32 - 10).pow(2) <= 49
}

fn disc_mask() -> Mask {
    let data = (0..480).map(|i| disc(i % 24, i / 24)).collect();
    Mask { width: 24, height: 20, data }
}

/// Share of the disc that a pixel covers, sampled, of 255.
fn smooth_disc(col: u32, row: u32) -> u8 {
    let inside = (0..64).filter(|i| {
        let (x, y) =
            (f64::from(col) + f64::from(i % 8) / 8.0 - 12.4, f64::from(row) + f64::from(i / 8) / 8.0 - 10.4);
        x * x + y * y <= 49.0
    });
    (inside.count() * 255 / 64) as u8
}

fn gray(value: impl Fn(u32, u32) -> u8) -> DynamicImage {
    DynamicImage::ImageLuma8(GrayImage::from_fn(24, 20, |x, y| Luma([value(x, y)])))
}

fn rgba(value: impl Fn(u32, u32) -> [u8; 4]) -> DynamicImage {
    DynamicImage::ImageRgba8(RgbaImage::from_fn(24, 20, |x, y| Rgba(value(x, y))))
}

#[test]
fn masks_survive_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mask.png");
    write_mask(&path, &disc_mask()).unwrap();
    assert_eq!(read_mask(&path).unwrap(), disc_mask());
    let empty = folder.path().join("empty.png");
    write_mask(&empty, &Mask::empty(5, 4)).unwrap();
    assert_eq!(read_mask(&empty).unwrap(), Mask::empty(5, 4));
}

#[test]
fn masks_of_all_kinds_are_the_same_disc() {
    let folder = tempfile::tempdir().unwrap();
    let texture = |x: u32, y: u32| [(x * 9) as u8 + 20, (y * 11) as u8 + 3, 77];
    let on = |x, y, value| if disc(x, y) { value } else { 0 };
    let images = [
        ("one.png", gray(|x, y| on(x, y, 1))),
        ("full.bmp", gray(|x, y| on(x, y, 255))),
        ("full.tif", gray(|x, y| on(x, y, 255))),
        ("full.webp", gray(|x, y| on(x, y, 255))),
        ("lossy.jpg", gray(|x, y| on(x, y, 255))),
        (
            "short.png",
            DynamicImage::ImageLuma16(ImageBuffer::from_fn(24, 20, |x, y| Luma([on(x, y, 7).into()]))),
        ),
        (
            "red.png",
            DynamicImage::ImageRgb8(RgbImage::from_fn(24, 20, |x, y| image::Rgb([on(x, y, 128), 0, 0]))),
        ),
        ("opaque.png", rgba(|x, y| [on(x, y, 255), on(x, y, 255), on(x, y, 255), 255])),
        // Cut-outs: colours everywhere, colours in the object alone, black, a mask in both.
        ("cut.png", rgba(|x, y| [texture(x, y)[0], texture(x, y)[1], 77, on(x, y, 255)])),
        ("cleared.png", rgba(|x, y| if disc(x, y) { [texture(x, y)[0], 0, 0, 255] } else { [0; 4] })),
        ("black.png", rgba(|x, y| [0, 0, 0, on(x, y, 255)])),
        ("both.png", rgba(|x, y| [on(x, y, 255); 4])),
    ];
    for (name, image) in images {
        let path = folder.path().join(name);
        image.save(&path).unwrap();
        let iou = read_mask(&path).unwrap_or_else(|e| panic!("{e}")).iou(&disc_mask());
        // Compression moves edge pixels.
        assert!(iou == 1.0 || (name == "lossy.jpg" && iou > 0.95), "{name}: {iou}");
    }
    let bools: Vec<u8> = disc_mask().data.iter().map(|&m| m.into()).collect();
    let path =
        depth_tests::write(folder.path(), "m.npy", depth_tests::npy("|b1", "False", "(20, 24)", &bools));
    assert_eq!(read_mask(&path).unwrap(), disc_mask());
}

#[test]
fn soft_edges_are_cut_at_half() {
    let folder = tempfile::tempdir().unwrap();
    let expected: Vec<bool> = (0..480).map(|i| smooth_disc(i % 24, i / 24) >= 128).collect();
    // A ramp that is wider than the image with flat ends, as a network's probabilities have.
    let ramp =
        |x: u32, _: u32| [0, 0, 0, 2, 2, 2, 2].get(x as usize).copied().unwrap_or((x * 14).min(255) as u8);
    let path = folder.path().join("a.png");
    for image in [
        gray(smooth_disc),
        rgba(|x, y| [255, 255, 255, smooth_disc(x, y)]),
        DynamicImage::ImageRgb8(RgbImage::from_fn(24, 20, |x, y| {
            image::Rgb([0, smooth_disc(x, y), smooth_disc(x, y) / 2])
        })),
    ] {
        image.save(&path).unwrap();
        assert_eq!(read_mask(&path).unwrap().data, expected);
    }
    gray(ramp).save(&path).unwrap();
    assert_eq!(read_mask(&path).unwrap().count(), 20 * (0..24).filter(|&x| ramp(x, 0) >= 128).count());
}

#[test]
fn label_maps_are_refused_until_a_value_is_chosen() {
    let folder = tempfile::tempdir().unwrap();
    // Two objects, the second with the void border that some data sets have.
    let labels = |x: u32, y: u32| match (disc(x, y), x) {
        (true, _) => 15,
        (_, 21..) => 2,
        (_, 20) => 255,
        _ => 0,
    };
    let path = folder.path().join("a.png");
    let fails = |value: Option<&str>, part: &str| {
        let message = read_mask_value(&path, value.map(|v| v.parse().unwrap())).unwrap_err().to_string();
        assert!(message.contains(part) && message.contains("a.png"), "{message}");
    };
    gray(labels).save(&path).unwrap();
    fails(None, "mask values is 2, 15, 255");
    fails(None, "--mask-value N");
    assert!(!read_mask(&path).unwrap_err().to_string().contains("--mask-value"));
    assert_eq!(read_mask_value(&path, Some(MaskValue::Number(15))).unwrap(), disc_mask());
    fails(Some("3"), "--mask-value is 3, expected a value of the mask: 2, 15, 255");
    fails(Some("1,2,3"), "a number for a mask of numbers");
    // In a palette the values are its indices.
    let mut content = Vec::new();
    let mut encoder = png::Encoder::new(&mut content, 24, 20);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Four);
    encoder.set_palette([[0, 0, 0], [128, 0, 0], [0, 128, 0], [64, 0, 0]].concat());
    let index = |i: u32| [0, 1, 3][usize::from(disc(i % 24, i / 24)) + usize::from(i % 24 > 20) * 2];
    let packed: Vec<u8> = (0..240).map(|i| index(2 * i) << 4 | index(2 * i + 1)).collect();
    encoder.write_header().unwrap().write_image_data(&packed).unwrap();
    std::fs::write(&path, content).unwrap();
    fails(None, "mask values is 1, 3");
    assert_eq!(read_mask_value(&path, Some(MaskValue::Number(1))).unwrap(), disc_mask());
    // Colours.
    let color = |x, y| {
        image::Rgb(match labels(x, y) {
            0 => [0; 3],
            15 => [200, 0, 50],
            _ => [0, 90, 0],
        })
    };
    DynamicImage::ImageRgb8(RgbImage::from_fn(24, 20, color)).save(&path).unwrap();
    fails(None, "mask values is (0,90,0), (200,0,50)");
    fails(Some("2"), "R,G,B for a mask with colours");
    assert_eq!(read_mask_value(&path, Some("200,0,50".parse().unwrap())).unwrap(), disc_mask());
    for wrong in ["", "0", "-1", "1,2", "1,2,256"] {
        assert!(wrong.parse::<MaskValue>().unwrap_err().contains("R,G,B"));
    }
}

#[test]
fn photographs_and_contradictions_are_no_masks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    for image in [gray(|x, y| (x * 5 + y * 4) as u8 + 30), gray(|x, y| if disc(x, y) { 110 } else { 0 })] {
        image.save(&path).unwrap();
        let message = read_mask(&path).unwrap_err().to_string();
        assert!(message.contains("photograph or a label map"), "{message}");
        let message = read_mask_value(&path, Some(MaskValue::Number(1))).unwrap_err().to_string();
        assert!(message.contains("values of jpeg are not exact"), "{message}");
    }
    let path = folder.path().join("a.png");
    rgba(|x, y| {
        let color = if x < 12 { 255 } else { 0 };
        [color, color, color, if disc(x, y) { 255 } else { 0 }]
    })
    .save(&path)
    .unwrap();
    let message = read_mask(&path).unwrap_err().to_string();
    assert!(message.contains("240 pixels in the colours and 149 in alpha"), "{message}");
}
