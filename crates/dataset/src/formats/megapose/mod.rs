//! MegaPose training sets: webdataset shards, packed (`shard-NNNNNN.tar`) or unpacked (`NNNNNN/KEY.*`).
//!
//! [`ShardDataset`] indexes a folder of shards and loads single images from anywhere inside them; [`ShardWriter`]
//! writes the same layout. Beside the shards: `key_to_shard.json`, a models list (`gso_models.json`), the published
//! index files of valid instances and references (rebuilt when absent), and `models/models_info.json` where known.

mod archive;
mod dataset;
mod fault_log;
mod file;
mod index_files;
mod instance;
mod instance_fault;
mod records;
mod shard_image;
mod write_index;
mod writer;

pub use dataset::ShardDataset;
pub use fault_log::FaultCounts;
pub use file::{ShardFile, ShardFileImage};
pub use index_files::ReferenceEntry;
pub use instance::InstanceRef;
pub use instance_fault::InstanceFault;
pub use records::ImageRecords;
pub use write_index::write_index_files;
pub use writer::{EncodedImage, ShardWriter, shard_file_name};

#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod tests;
