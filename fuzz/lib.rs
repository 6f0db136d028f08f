//! One run of a fuzz target: the bytes as the reader's file.

use unopose_tests::readers::READERS;

/// Reads `data` with the reader of this name. Errors are answers; a panic, an abort or a limit of libFuzzer is a finding.
pub fn run(name: &str, data: &[u8]) {
    let reader = READERS.iter().find(|reader| reader.name == name).expect("a reader of this name");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join(reader.file);
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    std::fs::write(path, data).expect("a file");
    let _ = (reader.read)(folder.path());
}
