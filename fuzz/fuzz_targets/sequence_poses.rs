#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| unopose_fuzz::run("sequence_poses", data));
