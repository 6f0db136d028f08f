use std::path::{Path, PathBuf};

use ::exr::prelude::{AnyChannel, AnyChannels, FlatSamples, Image, WritableImage};
use ::tiff::encoder::{TiffEncoder, colortype};
use image::{ImageBuffer, Luma};
use unopose_core::frame::DepthMap;

use super::*;

#[test]
fn depth_survives_the_file_at_its_resolution() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.png");
    let depth = DepthMap { width: 4, height: 1, data: vec![0.0, 0.71501, 6.5534, 6.5535] };
    write_depth(&path, &depth, 0.1).unwrap();
    // 0.1 mm steps; 65535 is no measurement.
    assert_eq!(read_depth(&path, 0.1).unwrap().data, [0.0, 0.7150, 6.5534, 0.0]);
    assert!((read_depth(&path, 1.0).unwrap().data[1] - 7.150).abs() < 1e-6);
    for scale in [0.0, f64::NAN] {
        assert!(read_depth(&path, scale).unwrap_err().to_string().contains("depth_scale"));
    }
}

/// 3 x 2 millimetres: 700 is at the left, the last one is no measurement.
const MILLIMETRES: [u16; 6] = [700, 701, 702, 1500, 0, u16::MAX];
const METRES: [f32; 6] = [0.7, 0.701, 0.702, 1.5, 0.0, 0.0];

pub fn npy(descr: &str, order: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
    let length = (header.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\0", length.as_slice(), header.as_bytes(), data].concat()
}

fn bytes<T: Copy, const N: usize>(values: impl IntoIterator<Item = T>, to: fn(T) -> [u8; N]) -> Vec<u8> {
    values.into_iter().flat_map(to).collect()
}

pub fn write(folder: &Path, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, content).unwrap();
    path
}

#[test]
fn depth_has_the_same_metres_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // What is not measured is written in as many ways as floats have.
    let floats = [0.7, 0.701, 0.702, 1.5, f32::NAN, f32::INFINITY];
    let negative = [0.7, 0.701, 0.702, 1.5, -1.0, 65504.0];
    let columns = [0, 3, 1, 4, 2, 5];
    let shorts = bytes(MILLIMETRES, u16::to_le_bytes);
    let exr = folder.join("z.exr");
    let channel = AnyChannel::new("Z", FlatSamples::F32(floats.to_vec()));
    let channels = AnyChannels::sort([channel].into_iter().collect());
    Image::from_channels((3, 2), channels).write().to_file(&exr).unwrap();
    let tif = folder.join("float.tif");
    let mut encoded = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut encoded).unwrap();
    encoder.write_image::<colortype::Gray32Float>(3, 2, &negative).unwrap();
    std::fs::write(&tif, encoded.into_inner()).unwrap();
    let wide = folder.join("wide.tif");
    let mut encoded = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut encoded).unwrap();
    encoder.write_image::<colortype::Gray32>(3, 2, &MILLIMETRES.map(u32::from)).unwrap();
    std::fs::write(&wide, encoded.into_inner()).unwrap();
    let png = folder.join("depth.png");
    ImageBuffer::<Luma<u16>, _>::from_raw(3, 2, MILLIMETRES.to_vec()).unwrap().save(&png).unwrap();
    let short_tif = folder.join("short.tif");
    ImageBuffer::<Luma<u16>, _>::from_raw(3, 2, MILLIMETRES.to_vec()).unwrap().save(&short_tif).unwrap();
    let bottom_up = [floats[3], floats[4], floats[5], floats[0], floats[1], floats[2]];
    let pgm = [b"P5\n# a camera\n3 2\n65535\n".as_slice(), &bytes(MILLIMETRES, u16::to_be_bytes)].concat();
    // 12 bits of range are numbers as they stand, too.
    let narrow =
        [b"P5 3 2 4095\n".as_slice(), &bytes([700, 701, 702, 1500, 0, 0], u16::to_be_bytes)].concat();
    let files = [
        png,
        short_tif,
        wide,
        exr,
        tif,
        write(folder, "u2.npy", npy("<u2", "False", "(2, 3)", &shorts)),
        write(folder, "u2.big.npy", npy(">u2", "False", "(2, 3)", &bytes(MILLIMETRES, u16::to_be_bytes))),
        write(
            folder,
            "i4.npy",
            npy("<i4", "False", "(2, 3, 1)", &bytes([700, 701, 702, 1500, -3, 65535], i32::to_le_bytes)),
        ),
        write(folder, "f4.npy", npy("<f4", "False", "(1, 2, 3)", &bytes(floats, f32::to_le_bytes))),
        write(
            folder,
            "f8.npy",
            npy(">f8", "False", "(2, 3)", &bytes([0.7, 0.701, 0.702, 1.5, f64::NAN, 0.0], f64::to_be_bytes)),
        ),
        write(
            folder,
            "fortran.npy",
            npy("<f4", "True", "(2, 3)", &bytes(columns.map(|i| negative[i]), f32::to_le_bytes)),
        ),
        write(
            folder,
            "le.pfm",
            [b"Pf\n3 2\n-1.0\n".as_slice(), &bytes(bottom_up, f32::to_le_bytes)].concat(),
        ),
        write(folder, "be.pfm", [b"Pf\n3 2\n1\n".as_slice(), &bytes(bottom_up, f32::to_be_bytes)].concat()),
        write(folder, "a.pgm", pgm),
        write(folder, "narrow.pgm", narrow),
        write(folder, "text.pgm", "P2 3 2 65535\n700 701 702\n1500 0 65535\n"),
    ];
    for path in &files {
        let depth = read_depth(path, 1.0).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((depth.width, depth.height), (3, 2));
        assert_eq!(depth.data, METRES, "{}", path.display());
    }
    let half = write(folder, "f2.npy", npy("<f2", "False", "(1, 2)", &[0x00, 0x3a, 0x00, 0x7c]));
    assert_eq!(read_depth(&half, 1.0).unwrap().data, [0.75, 0.0]);
    // Integers follow the scale, floats do not need one.
    assert_eq!(read_depth(&files[5], 10.0).unwrap().data[3], 15.0);
    let none = || Err(FormatError::missing("camera.json", "depth_scale", ""));
    assert_eq!(read_depth_by(&files[8], none).unwrap().data, METRES);
    assert!(read_depth_by(&files[5], none).unwrap_err().to_string().contains("depth_scale not found"));
}

#[test]
fn unusable_numbers_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let zeros = [0; 64];
    for (content, part) in [
        (npy("|u1", "False", "(2, 3)", &zeros[..6]), "integers of 8 bits"),
        (npy("<u2", "False", "(2, 3)", &zeros[..11]), "array is 11 bytes, expected 12 bytes"),
        (npy("<u2", "False", "(2, 3, 3)", &zeros[..36]), "shape is (2, 3, 3)"),
        (npy("<u2", "False", "(100000, 100000)", &[]), "image size is 100000 x 100000"),
        (npy("<c8", "False", "(2, 3)", &zeros[..48]), "descr is <c8"),
        (npy("<f4", "False", "(1, 2)", &bytes([740.0, 750.0], f32::to_le_bytes)), "look like millimetres"),
        (b"\x93NUMPY\x01\0\xff\xff{".to_vec(), "truncated npy"),
        (b"P5 3 2 65535\n\0\0".to_vec(), "pixels is 2 bytes, expected 12 bytes"),
        (b"P5 3 2 255\n\0\0\0\0\0\0".to_vec(), "integers of 8 bits"),
        (b"PF 1 1 1\n\0\0\0\0\0\0\0\0\0\0\0\0".to_vec(), "channels is 3"),
        (b"Pf 1 1 0.5\n\0\0\0\0".to_vec(), "scale is 0.5"),
        (b"P5 -3 2 65535\n".to_vec(), "image size is 0 x 2"),
        (b"\x76\x2f\x31\x01\x02\0\0\0".to_vec(), "not a readable image"),
        (b"II\x2a\0\x08\0\0\0".to_vec(), "not a readable image"),
        (b"PK\x03\x04".to_vec(), "npz"),
    ] {
        let path = write(folder, "depth", content);
        let message = read_depth(&path, 1.0).unwrap_err().to_string();
        assert!(message.contains(part) && message.contains("depth"), "{message}");
    }
}
