//! Mutated samples of every reader: an answer or an error, never a panic, and memory in proportion to the file.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    time::Instant,
};

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
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn every_reader_reads_its_sample() {
    for reader in &READERS {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), reader, &(reader.sample)());
        (reader.read)(folder.path()).unwrap_or_else(|error| panic!("{}: {error}", reader.name));
    }
}

#[test]
fn no_mutation_of_a_sample_panics() {
    let start = Instant::now();
    let share = SECONDS / READERS.len() as f64;
    for (index, reader) in READERS.iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let sample = (reader.sample)();
        let mut refused = 0;
        for seed in 0..MUTATIONS {
            if start.elapsed().as_secs_f64() > share * (index + 1) as f64 {
                println!("{}: {seed} of {MUTATIONS} mutations in its share of the time", reader.name);
                break;
            }
            let bytes = mutate(&sample, &mut ChaCha8Rng::seed_from_u64(seed));
            write(folder.path(), reader, &bytes);
            match catch_unwind(AssertUnwindSafe(|| (reader.read)(folder.path()).is_err())) {
                Ok(is_error) => refused += u64::from(is_error),
                Err(_) => panic!("{}: mutation {seed} panics: {}", reader.name, bytes.escape_ascii()),
            }
        }
        assert!(refused > 0, "{}: no mutation was refused", reader.name);
    }
}
