//! Segment Anything networks of the published sizes with random weights, and an image for them.

use std::{
    fs::File,
    io::{BufWriter, Write},
    path::Path,
};

use image::{Rgb, RgbImage};
use serde_json::{Map, Value, json};
use unopose_core::{
    frame::{BoundingBox, DepthMap, RgbdFrame},
    geometry::Intrinsics,
};

/// A box prompt in [`frame`].
pub const BOUNDS: BoundingBox = BoundingBox { col_min: 100, row_min: 100, col_max: 300, row_max: 200 };

/// An image of 640 x 480 pixels without depth.
pub fn frame() -> RgbdFrame {
    let rgb = RgbImage::from_fn(640, 480, |x, y| {
        Rgb([(x / 3) as u8, (y / 2) as u8, ((x / 80 + y / 60) * 40) as u8])
    });
    let intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
    RgbdFrame { rgb, depth: DepthMap::zeros(640, 480), intrinsics }
}

/// The same above a table with six boxes on it that cover an eighth of the image.
pub fn frame_with_depth() -> RgbdFrame {
    let on_box = |pixel: usize| (pixel % 640 % 210 < 80) && (pixel / 640 % 230 < 80);
    let data = (0..640 * 480).map(|pixel| if on_box(pixel) { 0.9 } else { 1.0 }).collect();
    RgbdFrame { depth: DepthMap { width: 640, height: 480, data }, ..frame() }
}

/// Writes a state with the published names and shapes: small random weights, normalisation as at the start of training,
/// and every mask rated as good, which is the slowest case.
pub fn write_random(path: &Path, network: &str) {
    let text = include_str!("../../crates/segment/src/sam/states.txt");
    let lines = text.lines().skip_while(|line| *line != format!("# {network}")).skip(1);
    let (mut header, mut end) = (Map::new(), 0);
    let mut tensors: Vec<(&str, usize, bool)> = Vec::new();
    for line in lines.take_while(|line| !line.starts_with('#')) {
        let (name, shape) = line.split_once(' ').unwrap_or((line, ""));
        let shape: Vec<usize> = shape.split_whitespace().map(|n| n.parse().unwrap()).collect();
        let count: usize = shape.iter().product();
        let start = end;
        end += 4 * count;
        header.insert(name.into(), json!({"dtype": "F32", "shape": shape, "data_offsets": [start, end]}));
        tensors.push((name, count, shape.len() == 1));
    }
    let mut header = Value::Object(header).to_string();
    header.push_str(&" ".repeat(header.len().next_multiple_of(8) - header.len()));
    let mut file = BufWriter::new(File::create(path).unwrap());
    file.write_all(&(header.len() as u64).to_le_bytes()).unwrap();
    file.write_all(header.as_bytes()).unwrap();
    let mut state = 1u32;
    for (name, count, vector) in tensors {
        for _ in 0..count {
            // Numbers in (-0.06, 0.06) from a linear congruential generator.
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let random = (state >> 8) as f32 / (1 << 24) as f32 * 0.12 - 0.06;
            let value = match vector {
                true if name.ends_with("iou_prediction_head.layers.2.bias") => 2.0,
                true if name.ends_with("weight") || name.ends_with("running_var") => 1.0,
                _ => random,
            };
            file.write_all(&value.to_le_bytes()).unwrap();
        }
    }
    file.flush().unwrap();
}
