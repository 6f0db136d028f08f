//! Errors of data generation.

use std::path::PathBuf;

use unopose_core::files::FileError;
use unopose_dataset::{formats::FormatError, mesh::MeshError, protocol::ProtocolError};

#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    #[error(transparent)]
    Write(#[from] FileError),
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("{}: no ply, obj, stl, glb or gltf files found", folder.display())]
    NoMeshes { folder: PathBuf },
    #[error("{}: neither shards (shard-NNNNNN.tar, train_pbr_web/) nor BOP scenes (SPLIT/SSSSSS/scene_camera.json) found", folder.display())]
    NoDataset { folder: PathBuf },
    #[error("{}: {faces} faces, expected at most {most}; simplify the mesh", path.display())]
    LargeMesh { path: PathBuf, faces: usize, most: usize },
    #[error("{}: no jpg or png files found", folder.display())]
    NoPictures { folder: PathBuf },
    #[error("synth.{field} is {value}, expected {expected}")]
    Config { field: &'static str, value: String, expected: &'static str },
    #[error("{}: holds data of another configuration ({difference}); choose another folder, or allow overwriting", folder.display())]
    OtherConfig { folder: PathBuf, difference: String },
}
