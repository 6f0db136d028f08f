//! Networks of the published sizes with random weights: they load from a file and run; time and memory.
//!
//! `cargo test --release --test weights sam_full -- --ignored --nocapture`; `UNOPOSE_SAM_NETWORKS=vit_h` (or `vit_l`) for
//! others than MobileSAM and ViT-B.

use std::{
    fs::File,
    io::{BufWriter, Write},
    path::Path,
    time::Instant,
};

use image::{Rgb, RgbImage};
use serde_json::{Map, Value, json};
use unopose_core::{
    frame::{BoundingBox, DepthMap, RgbdFrame},
    geometry::Intrinsics,
};
use unopose_nn::device::DeviceChoice;
use unopose_segment::{Prompt, ProposalGenerator, SamProposals};

/// Writes a state with the published names and shapes: small random weights, normalisation as at the start of training,
/// and every mask rated as good, which is the slowest case.
fn write_random(path: &Path, network: &str) {
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

/// Largest memory of the process so far, megabytes (Linux).
fn peak_memory() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|kb| kb.trim().trim_end_matches(" kB").parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
}

#[test]
#[ignore = "minutes; run by name"]
fn networks_of_the_published_sizes_load_and_run() {
    let names = std::env::var("UNOPOSE_SAM_NETWORKS").unwrap_or_else(|_| "vit_t,vit_b".into());
    let (device, _) = DeviceChoice::Auto.open().unwrap();
    let rgb = RgbImage::from_fn(640, 480, |x, y| {
        Rgb([(x / 3) as u8, (y / 2) as u8, ((x / 80 + y / 60) * 40) as u8])
    });
    let intrinsics = Intrinsics { fx: 600.0, fy: 600.0, cx: 320.0, cy: 240.0 };
    let frame = RgbdFrame { rgb, depth: DepthMap::zeros(640, 480), intrinsics };
    for name in names.split(',') {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sam.safetensors");
        write_random(&path, name);
        let start = Instant::now();
        let sam = SamProposals::load(&path, &device).unwrap();
        println!("{}: loaded in {:.1} s, {:.0} MB", sam.name(), start.elapsed().as_secs_f64(), peak_memory());
        let start = Instant::now();
        let bounds = BoundingBox { col_min: 100, row_min: 100, col_max: 300, row_max: 200 };
        // Random weights may find nothing in the box.
        let found = sam.segment_prompt(&frame, Prompt::Box(bounds)).map_or(0, |p| p.mask.count());
        let seconds = start.elapsed().as_secs_f64();
        println!("{name}: encoder and one box in {seconds:.1} s ({found} pixels), {:.0} MB", peak_memory());
        let start = Instant::now();
        let found = sam.proposals(&frame, None).unwrap();
        let seconds = start.elapsed().as_secs_f64();
        println!("{name}: automatic in {seconds:.1} s, {} masks, {:.0} MB", found.len(), peak_memory());
        assert!(found.len() <= 100 && found.iter().all(|p| p.mask.data.len() == 640 * 480));
    }
}
