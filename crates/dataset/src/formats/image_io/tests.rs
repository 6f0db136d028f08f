use image::{DynamicImage, ExtendedColorType, GrayImage, ImageEncoder, Luma, RgbImage};

use super::*;

fn gradient() -> RgbImage {
    RgbImage::from_fn(64, 48, |x, y| image::Rgb([(x * 4) as u8, (y * 5) as u8, ((x * y) % 251) as u8]))
}

#[test]
fn gray_becomes_three_channels_and_colour_is_no_depth() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gray.tif");
    GrayImage::from_fn(3, 2, |x, _| Luma([x as u8 * 100])).save(&path).unwrap();
    assert_eq!(read_rgb(&path).unwrap().get_pixel(2, 1).0, [200; 3]);
    let rgb = folder.path().join("rgb.png");
    write_rgb(&rgb, &gradient()).unwrap();
    assert_eq!(read_rgb(&rgb).unwrap(), gradient());
    for no_depth in [&rgb, &path] {
        assert!(read_depth(no_depth, 1.0).unwrap_err().to_string().contains("16-bit gray"));
    }
}

#[test]
fn colour_of_other_types_is_the_same_colour() {
    let folder = tempfile::tempdir().unwrap();
    let whole = DynamicImage::ImageRgb8(gradient());
    for (name, image) in [
        ("a.webp", whole.clone()),
        ("a.png", DynamicImage::ImageRgba8(whole.to_rgba8())),
        ("b.png", DynamicImage::ImageRgb16(whole.to_rgb16())),
        ("a.bmp", whole.clone()),
    ] {
        let path = folder.path().join(name);
        image.save(&path).unwrap();
        assert!(read_rgb(&path).unwrap() == gradient(), "{name}");
        assert_eq!(image_size(&path).unwrap(), (64, 48));
    }
}

#[test]
fn an_exif_orientation_is_applied() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    // TIFF header, one entry: orientation (0x0112), a short, 6: turned by 90 degrees clockwise to be seen.
    let exif = [b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0".as_slice()].concat();
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif).unwrap();
    encoder.write_image(gradient().as_raw(), 64, 48, ExtendedColorType::Rgb8).unwrap();
    std::fs::write(&path, bytes).unwrap();
    let seen = read_rgb(&path).unwrap();
    assert_eq!((seen.dimensions(), image_size(&path).unwrap()), ((48, 64), (48, 64)));
    // The lower left corner comes to the upper left.
    assert_eq!(seen.get_pixel(0, 0), gradient().get_pixel(0, 47));
    assert_eq!(size_before_orientation(&path), Some((64, 48)));
}

#[test]
fn truncated_files_are_errors_that_name_the_file() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.png", "a.jpg", "a.tif", "a.bmp", "a.webp"] {
        let path = folder.path().join(name);
        write_rgb(&path, &gradient()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(decode_rgb(&bytes, name).is_ok());
        for keep in [0, 1, 10, bytes.len() / 2, bytes.len() * 9 / 10] {
            let message = decode_rgb(&bytes[..keep], name).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
        }
    }
}
