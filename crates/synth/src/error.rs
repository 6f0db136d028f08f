//! Why data cannot be generated or checked.

use std::{ops::Range, path::PathBuf};

use unopose_core::{config::ConfigError, files::FileError, folder_lock::LockError};
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
    /// Every mesh of `synth.mesh_folder` is broken.
    #[error("{}: none of {files} meshes can be used; the first: {reason}", folder.display())]
    NoUsableMesh {
        /// The folder of the meshes.
        folder: PathBuf,
        /// Number of mesh files in it.
        files: usize,
        /// Why the first one cannot be used.
        reason: String,
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
    /// `synth.background_folder` or `synth.texture_folder` holds no picture.
    #[error("{}: no jpg or png files found", folder.display())]
    NoPictures {
        /// The folder that was searched.
        folder: PathBuf,
    },
    /// A configuration value that no images can be made with.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Shards that the set does not have.
    #[error("shards {}..{} of a set of {count}, expected 0..{count} or a part of it", range.start, range.end)]
    Shards {
        /// The shards asked for.
        range: Range<u32>,
        /// Shards of the whole set.
        count: u32,
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
