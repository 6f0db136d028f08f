//! Mutated samples of every reader: an answer or an error, never a panic, and memory in proportion to the file.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    time::Instant,
};

use peak_alloc::PeakAlloc;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use unopose_tests::readers::{READERS, Reader};

/// Mutations of each sample.
const MUTATIONS: u64 = 10_000;
/// Seconds for all readers together; the rest of the mutations is left out on a slow machine.
const SECONDS: f64 = 40.0;

/// One to four changes of bits, bytes, digits, order or length.
fn mutate(sample: &[u8], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = sample.to_vec();
    for _ in 0..rng.random_range(1..=4) {
        if bytes.is_empty() {
            break;
        }
        let at = rng.random_range(0..bytes.len());
        match rng.random_range(0..8) {
            0..3 => bytes[at] ^= 1 << rng.random_range(0..8),
            3 => bytes[at] = rng.random(),
            4 => bytes[at] = b"0123456789-/. \n,[]{}\""[rng.random_range(0..21)],
            5 => {
                let numbers = ["4294967295", "-1", "1e308", "99999999999999999999", "NaN", "null"];
                let number = numbers[rng.random_range(0..numbers.len())].bytes();
                bytes.splice(at..at, number);
            }
            6 => {
                let end = (at + rng.random_range(1..40)).min(bytes.len());
                bytes.extend_from_within(at..end);
            }
            _ => bytes.truncate(at),
        }
    }
    bytes
}

fn write(folder: &Path, reader: &Reader, bytes: &[u8]) {
    let path = folder.join(reader.file);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    // Some file systems write a file that is replaced in place to the disk at once.
    let _ = std::fs::remove_file(&path);
    std::fs::write(path, bytes).unwrap();
}

/// Bytes that a reader may use beside a multiple of the file: buffers and tables of decoders, messages.
const BASE_BYTES: usize = 8 << 20;
/// The same for readers of images: one of four million equal pixels compresses to next to nothing.
const IMAGE_BYTES: usize = 256 << 20;
/// Bytes per byte of the file.
const BYTES_PER_BYTE: usize = 200;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

// The only test of its program: what others allocate meanwhile would count.
#[test]
fn no_mutation_of_a_sample_panics_or_takes_memory() {
    for reader in &READERS {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), reader, &(reader.sample)());
        (reader.read)(folder.path()).unwrap_or_else(|error| panic!("{}: {error}", reader.name));
    }
    let start = Instant::now();
    let share = SECONDS / READERS.len() as f64;
    for (index, reader) in READERS.iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let sample = (reader.sample)();
        let is_image =
            ["rgb", "depth", "mask", "shard", "sequence"].iter().any(|of| reader.name.starts_with(of));
        let base = if is_image { IMAGE_BYTES } else { BASE_BYTES };
        let (mut refused, mut largest) = (0, 0);
        let mut tried = 0;
        for seed in 0..MUTATIONS {
            if start.elapsed().as_secs_f64() > share * (index + 1) as f64 {
                break;
            }
            tried += 1;
            let bytes = mutate(&sample, &mut ChaCha8Rng::seed_from_u64(seed));
            write(folder.path(), reader, &bytes);
            let before = MEMORY.current_usage();
            MEMORY.reset_peak_usage();
            match catch_unwind(AssertUnwindSafe(|| (reader.read)(folder.path()).is_err())) {
                Ok(is_error) => refused += u64::from(is_error),
                Err(_) => panic!("{}: mutation {seed} of its sample panics", reader.name),
            }
            let used = MEMORY.peak_usage().saturating_sub(before);
            largest = largest.max(used);
            assert!(
                used <= base + BYTES_PER_BYTE * bytes.len(),
                "{}: mutation {seed} of {} bytes takes {used} bytes",
                reader.name,
                bytes.len()
            );
        }
        println!(
            "{}: {tried} of {MUTATIONS} mutations, {refused} refused, at most {largest} bytes",
            reader.name
        );
        assert!(refused > 0, "{}: no mutation was refused", reader.name);
    }
}
