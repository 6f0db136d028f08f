//! Networks of the published sizes with random weights: they load from a file and run; time and memory.
//!
//! `cargo test --release --test weights sam_full -- --ignored --nocapture`; `UNOPOSE_SAM_NETWORKS=vit_h` (or `vit_l`) for
//! others than MobileSAM and ViT-B.

use std::time::Instant;

use unopose_nn::device::DeviceChoice;
use unopose_segment::{Prompt, ProposalGenerator, SamProposals};
use unopose_tests::sam_network::{BOUNDS, frame, frame_with_depth, write_random};

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
    let (frame, above_table) = (frame(), frame_with_depth());
    for name in names.split(',') {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sam.safetensors");
        write_random(&path, name);
        let start = Instant::now();
        let sam = SamProposals::load(&path, &device).unwrap();
        println!("{}: loaded in {:.1} s, {:.0} MB", sam.name(), start.elapsed().as_secs_f64(), peak_memory());
        let start = Instant::now();
        // Random weights may find nothing in the box.
        let found = sam.segment_prompt(&frame, Prompt::Box(BOUNDS)).map_or(0, |p| p.mask.count());
        let seconds = start.elapsed().as_secs_f64();
        println!("{name}: encoder and one box in {seconds:.1} s ({found} pixels), {:.0} MB", peak_memory());
        for (clicks, frame) in [("everywhere", &frame), ("off the table", &above_table)] {
            let start = Instant::now();
            let found = sam.proposals(frame, None).unwrap();
            let seconds = start.elapsed().as_secs_f64();
            println!(
                "{name}: automatic, {clicks}, in {seconds:.1} s, {} masks, {:.0} MB",
                found.len(),
                peak_memory()
            );
            assert!(found.len() <= 100 && found.iter().all(|p| p.mask.data.len() == 640 * 480));
        }
    }
}
