//! Filling a folder with shards, models and index files.

use std::{
    ops::Range,
    path::Path,
    sync::atomic::{AtomicUsize, Ordering},
};

use unopose_core::{config::SynthConfig, folder_lock::FolderLock};
use unopose_dataset::formats::megapose::{ShardDataset, ShardWriter, shard_file_name, write_index_files};

use super::{
    SynthError,
    folder::{Layout, check, remove_parts, reserve},
    models::write_models,
    object_cache::ObjectCache,
    progress::{GenerationProgress, GenerationSummary, Reporter, Stage},
    shard,
};

/// Part of the index files' names; readers of MegaPose's sets look for it.
const SET_NAME: &str = "gso";

/// Makes the whole set in `out`: shards, models, index files. Finished shards of an earlier run are kept, so that a
/// killed run can be resumed. `progress` is called from several threads. Refuses a folder that another process fills.
pub fn generate(
    config: &SynthConfig,
    out: &Path,
    progress: &(dyn Fn(GenerationProgress) + Sync),
) -> Result<GenerationSummary, SynthError> {
    check(config)?;
    let _lock = FolderLock::exclusive(out)?;
    reserve(config, out, Layout::Shards)?;
    remove_parts(out)?;
    let reporter = Reporter::new(progress);
    let mut cache = ObjectCache::new(config)?;
    write_models(config, out, SET_NAME, &mut cache, &reporter)?;
    let shards = config.images.div_ceil(config.images_per_shard.max(1)) as u32;
    let summary = make_shards(config, out, 0..shards, &mut cache, &reporter)?;
    let index = out.join(format!("megapose_{SET_NAME}_fixed_obj_id_to_visib0_8_scene_im_inst_ids.json"));
    if summary.shards_written > 0 || !index.is_file() {
        remove_index_files(out)?;
        let dataset = ShardDataset::open(out)?;
        write_index_files(out, SET_NAME, &dataset, [config.width, config.height])?;
    }
    Ok(summary)
}

/// Makes some shards only, for sets spread over many machines; [`generate`] completes the set once all are there.
pub fn generate_shards(
    config: &SynthConfig,
    out: &Path,
    shards: Range<u32>,
    progress: &(dyn Fn(GenerationProgress) + Sync),
) -> Result<GenerationSummary, SynthError> {
    check(config)?;
    // Others make other shards meanwhile; every shard is written whole.
    let _lock = FolderLock::shared(out)?;
    reserve(config, out, Layout::Shards)?;
    make_shards(config, out, shards, &mut ObjectCache::new(config)?, &Reporter::new(progress))
}

fn make_shards(
    config: &SynthConfig,
    out: &Path,
    shards: Range<u32>,
    cache: &mut ObjectCache,
    reporter: &Reporter,
) -> Result<GenerationSummary, SynthError> {
    let per_shard = config.images_per_shard;
    let images_in = |shard: u32| (config.images.saturating_sub(shard as usize * per_shard)).min(per_shard);
    let count = config.images.div_ceil(per_shard.max(1)) as u32;
    if shards.end > count {
        return Err(SynthError::Shards { range: shards, count });
    }
    let total = shards.clone().map(images_in).sum();
    let done = AtomicUsize::new(0);
    let report = |finished: usize| {
        let done = done.fetch_add(finished, Ordering::Relaxed) + finished;
        reporter.report(Stage::Images, done, total);
    };
    let mut summary = GenerationSummary::default();
    for shard in shards {
        let path = out.join("train_pbr_web").join(shard_file_name(shard));
        let images = images_in(shard);
        if images == 0 || path.is_file() {
            summary.shards_kept += usize::from(images > 0);
            report(images);
            continue;
        }
        reporter.go_on()?;
        let assets = cache.scene_assets(config, shard)?;
        let mut writer = ShardWriter::default();
        for image in shard::encode_shard(config, &assets, shard, images, reporter, &report)? {
            writer.push(image);
        }
        writer.write(&path)?;
        summary.shards_written += 1;
        summary.images_written += images;
    }
    summary.meshes_replaced = cache.replaced();
    Ok(summary)
}

fn remove_index_files(out: &Path) -> Result<(), SynthError> {
    for suffix in ["valid_inst_ids.json", "obj_id_to_visib0_8_scene_im_inst_ids.json"] {
        let path = out.join(format!("megapose_{SET_NAME}_fixed_{suffix}"));
        match std::fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(SynthError::Io { path, source });
            }
            _ => {}
        }
    }
    Ok(())
}
