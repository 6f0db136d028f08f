//! MegaPose training sets: webdataset shards, packed (`shard-NNNNNN.tar`) or unpacked (`NNNNNN/KEY.*`).
//!
//! [`ShardDataset`] indexes a folder of shards and loads single images from anywhere inside them; [`ShardWriter`]
//! writes the same layout. Beside the shards: `key_to_shard.json`, a models list (`gso_models.json`), the published
//! index files of valid instances and references (rebuilt when absent), and `models/models_info.json` where known.

mod archive;
mod dataset;
mod file;
mod index;
mod records;
mod shard_image;
mod writer;

pub use dataset::{InstanceRef, ShardDataset};
pub use file::ShardFile;
pub use index::{
    REFERENCE_VISIB_FRACT, ReferenceEntry, VALID_PX_COUNT_VISIB, VALID_VISIB_FRACT, valid_px_count_visib,
    write_index_files,
};
pub use records::{ImageRecords, MemberKind};
pub use writer::{EncodedImage, ShardWriter, shard_file_name};

#[cfg(test)]
mod tests;
