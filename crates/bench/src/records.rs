//! Results of pairs that are kept from run to run.

use std::{
    collections::HashMap,
    fs::{File, OpenOptions},
    hash::{DefaultHasher, Hash, Hasher},
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use unopose_core::geometry::Pose;
use unopose_dataset::formats::{FormatError, ReferenceTarget, detections::Detection, rle::Counts};

/// What a pair is: the target, its reference, and the mask.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(crate) struct RecordKey {
    pub scene_id: u32,
    pub im_id: u32,
    pub obj_id: u32,
    pub ref_scene_id: u32,
    pub ref_im_id: u32,
    /// Of the query's mask.
    pub mask_hash: u64,
}

impl RecordKey {
    pub(crate) fn new(target: &ReferenceTarget, detection: &Detection) -> Self {
        let mut hasher = DefaultHasher::new();
        detection.segmentation.size.hash(&mut hasher);
        match &detection.segmentation.counts {
            Counts::Compressed(text) => text.hash(&mut hasher),
            Counts::Runs(runs) => runs.hash(&mut hasher),
        }
        Self {
            scene_id: target.scene_id,
            im_id: target.im_id,
            obj_id: target.obj_id,
            ref_scene_id: target.ref_scene_id,
            ref_im_id: target.ref_im_id,
            mask_hash: hasher.finish(),
        }
    }
}

/// What became of a pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum PairOutcome {
    /// Reference to query camera, metres.
    Posed { t_query_reference: Pose, score: f64, seconds: f64 },
    /// Why there is no pose.
    Rejected { reason: String },
}

/// A line of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Record {
    #[serde(flatten)]
    pub key: RecordKey,
    #[serde(flatten)]
    pub outcome: PairOutcome,
}

/// All results of one method on one dataset, in a file that grows line by line.
#[derive(Debug)]
pub(crate) struct Records {
    known: HashMap<RecordKey, PairOutcome>,
    path: PathBuf,
    file: File,
}

impl Records {
    /// Opens the file of a method in `folder`, made anew when absent. `identity` is everything the results depend on
    /// besides the pairs; another identity is another file. A last line that was cut off is dropped.
    pub(crate) fn open(folder: &Path, name: &str, identity: &str) -> Result<Self, FormatError> {
        let mut hasher = DefaultHasher::new();
        identity.hash(&mut hasher);
        let path = folder.join(format!("{name}-{:016x}.jsonl", hasher.finish()));
        let io = |e| FormatError::io(&path, e);
        std::fs::create_dir_all(folder).map_err(io)?;
        let mut file = OpenOptions::new().read(true).append(true).create(true).open(&path).map_err(io)?;
        let (mut known, mut whole) = (HashMap::new(), 0u64);
        let mut reader = BufReader::new(&file);
        let mut line = String::new();
        loop {
            line.clear();
            let length = reader.read_line(&mut line).map_err(io)?;
            if length == 0 || !line.ends_with('\n') {
                break;
            }
            let record: Record = serde_json::from_str(&line)
                .map_err(|source| FormatError::Json { path: path.clone(), source })?;
            known.insert(record.key, record.outcome);
            whole += length as u64;
        }
        file.set_len(whole).map_err(io)?;
        file.flush().map_err(io)?;
        Ok(Self { known, path, file })
    }

    pub(crate) fn get(&self, key: &RecordKey) -> Option<&PairOutcome> {
        self.known.get(key)
    }

    /// Keeps a result, on disk at once.
    pub(crate) fn add(&mut self, key: RecordKey, outcome: PairOutcome) -> Result<(), FormatError> {
        let record = Record { key, outcome };
        let mut line = serde_json::to_string(&record)
            .map_err(|source| FormatError::Json { path: self.path.clone(), source })?;
        line.push('\n');
        self.file.write_all(line.as_bytes()).map_err(|e| FormatError::io(&self.path, e))?;
        self.known.insert(record.key, record.outcome);
        Ok(())
    }
}
