//! Why data cannot be generated or checked.

use std::path::PathBuf;

use unopose_core::{files::FileError, folder_lock::LockError};
use unopose_dataset::{formats::FormatError, mesh::MeshError, protocol::ProtocolError};

/// Why data cannot be generated or checked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SynthError {
    /// A file cannot be written atomically.
    #[error(transparent)]
    Write(#[from] FileError),
    /// Another process fills the folder.
    #[error(transparent)]
    Lock(#[from] LockError),
    /// The caller asked to stop; what is finished is kept.
    #[error("stopped before the set was complete")]
    Stopped,
    /// A file of a set is malformed or cannot be read or written.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A mesh file cannot be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The target and reference lists of a test set cannot be built.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// A file or folder cannot be read, written or removed.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system reports.
        source: std::io::Error,
    },
    /// `synth.mesh_folder` holds no mesh of the chosen layout.
    #[error("{}: no ply, obj, stl, glb or gltf files found", folder.display())]
    NoMeshes {
        /// The folder that was searched.
        folder: PathBuf,
    },
    /// A folder to be checked holds no data set.
    #[error("{}: neither shards (shard-NNNNNN.tar, train_pbr_web/) nor BOP scenes (SPLIT/SSSSSS/scene_camera.json) found", folder.display())]
    NoDataset {
        /// The folder that was searched.
        folder: PathBuf,
    },
    /// A mesh has too many faces to be simulated and rendered in bulk.
    #[error("{}: {faces} faces, expected at most {most}; simplify the mesh", path.display())]
    LargeMesh {
        /// The mesh file.
        path: PathBuf,
        /// Its number of triangles.
        faces: usize,
        /// The largest number accepted.
        most: usize,
    },
    /// `synth.background_folder` holds no picture.
    #[error("{}: no jpg or png files found", folder.display())]
    NoPictures {
        /// The folder that was searched.
        folder: PathBuf,
    },
    /// A configuration value that no images can be made with.
    #[error("synth.{field} is {value}, expected {expected}")]
    Config {
        /// Its path below `synth`, such as `camera.distance`.
        field: &'static str,
        /// The value met.
        value: String,
        /// The values accepted.
        expected: &'static str,
    },
    /// The folder holds data that this configuration did not make.
    #[error("{}: holds data of another configuration ({difference}); choose another folder, or allow overwriting", folder.display())]
    OtherConfig {
        /// The folder to be filled.
        folder: PathBuf,
        /// The first difference found.
        difference: String,
    },
}
