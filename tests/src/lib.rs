//! What the tests of several crates use: where files are, reference tensors, small weights in foreign formats, and rendered
//! views with known poses.
#![allow(missing_docs)] // Helpers of tests, not an interface.

pub mod backbone_files;
pub mod ellipsoid_views;
pub mod pytorch_file;
pub mod readers;
pub mod reference_tensors;
pub mod sam_case;
pub mod sam_network;
mod set_readers;
pub mod tensor_fixture;
pub mod test_device;

use std::path::{Path, PathBuf};

/// A file or folder of the shared folder. Tests that call this are ignored where the folder is absent (`build.rs`).
pub fn shared(part: &str) -> PathBuf {
    let Some(folder) = option_env!("UNOPOSE_SHARED_FOLDER") else {
        panic!("a test that needs the shared folder is not marked as such");
    };
    let path = Path::new(folder).join(part);
    assert!(path.exists(), "{} is gone; set UNOPOSE_SHARED and build the tests again", path.display());
    path
}

/// A committed fixture.
pub fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name)
}
