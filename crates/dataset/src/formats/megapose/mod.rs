//! MegaPose training sets: webdataset shards, packed (`shard-NNNNNN.tar`) or unpacked (`NNNNNN/KEY.*`).
//!
//! [`ShardDataset`] indexes a folder of shards and loads single images from anywhere inside them; [`ShardWriter`]
//! writes the same layout. Beside the shards: `key_to_shard.json`, a models list (`gso_models.json`), the published
//! index files of valid instances and references (rebuilt when absent), and `models/models_info.json` where known.

mod archive;
mod dataset;
mod file;
mod index_files;
mod instance;
mod records;
mod shard_image;
mod write_index;
mod writer;

pub use dataset::ShardDataset;
pub use file::ShardFile;
pub use index_files::ReferenceEntry;
pub use instance::InstanceRef;
pub use records::ImageRecords;
pub use write_index::write_index_files;
pub use writer::{EncodedImage, ShardWriter, shard_file_name};

#[cfg(test)]
mod tests;
