//! `metrics.jsonl`: one JSON object per line and event, safe to append to after any interruption.

use std::{
    fs::{File, OpenOptions},
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use unopose_core::files::write_atomic;

use super::TrainError;

/// A line of the journal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// An optimizer step.
    Step(StepRecord),
    /// A validation.
    Validation(ValidationRecord),
}

/// One optimizer step.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct StepRecord {
    /// Steps taken, this one included.
    pub step: u64,
    /// Mean loss of the step's pairs, all terms together.
    pub loss: f64,
    /// Learning rate of the step.
    pub learning_rate: f64,
    /// L2 norm of all gradients before clipping.
    pub gradient_norm: f64,
    /// Training time of all calls so far, seconds.
    pub elapsed_s: f64,
    /// Mean of each loss term by name, such as `coarse.info_nce.0`.
    pub terms: std::collections::BTreeMap<String, f64>,
}

/// One validation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct ValidationRecord {
    /// Steps taken before it.
    pub step: u64,
    /// Training time of all calls so far, seconds.
    pub elapsed_s: f64,
    /// Pairs that were evaluated.
    pub pairs: usize,
    /// Mean loss of the pairs.
    pub loss: f64,
    /// Median rotation error of the final poses up to the object's symmetries, degrees.
    pub median_rotation_deg: f64,
    /// Median translation error of the final poses, metres.
    pub median_translation_m: f64,
    /// Share of pairs within 5 degrees and 5 cm.
    pub within_5deg_5cm: f64,
    /// Share of pairs within 15 degrees.
    pub within_15deg: f64,
    /// BOP average recall (mean of the VSD, MSSD and MSPD recalls) when the objects' meshes are known.
    pub average_recall: Option<f64>,
    /// Share of pairs whose coarse pose, before the fine stage, is within 15 degrees.
    pub coarse_within_15deg: f64,
    /// Share of the pairs whose pose only the print tells that are within 15 degrees; `None` for a set that has none or does not
    /// say which.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub print_within_15deg: Option<f64>,
    /// Of a distilled encoder instead of poses: area under the ROC curve of the features' cosines, same points of a pair's views
    /// against others, mean over the pairs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roc_area: Option<f64>,
    /// Of a proposal network instead of poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proposals: Option<ProposalRecall>,
}

/// How well proposals cover the objects of images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProposalRecall {
    /// Objects of which at least a tenth is visible.
    pub objects: usize,
    /// Share of them with a proposal whose overlap (intersection over union) is at least 0.5.
    pub recall_50: f64,
    /// The same at 0.75.
    pub recall_75: f64,
    /// Mean over the objects of the best proposal's overlap.
    pub mean_iou: f64,
    /// Mean number of proposals per image.
    pub proposals: f64,
}

impl Event {
    /// Steps taken when the event was written.
    pub fn step(&self) -> u64 {
        match self {
            Self::Step(record) => record.step,
            Self::Validation(record) => record.step,
        }
    }
}

impl ValidationRecord {
    /// The score by which the best weights are chosen: the average recall, or the mean of the two shares where it is not
    /// known, or the features' ROC area, or the proposals' mean overlap; the loss decides between equals.
    pub fn score(&self) -> f64 {
        let poses = || self.average_recall.unwrap_or(0.5 * (self.within_5deg_5cm + self.within_15deg));
        let proposals = self.proposals.map(|recall| recall.mean_iou);
        proposals.or(self.roc_area).unwrap_or_else(poses) - 1e-4 * self.loss.clamp(0.0, 100.0)
    }

    /// One line of text for people.
    pub fn describe(&self) -> String {
        if let Some(recall) = self.proposals {
            return format!(
                "loss {:.3}, proposal recall {:.3} at 0.5, {:.3} at 0.75, mean overlap {:.3}, {:.1} proposals per image",
                self.loss, recall.recall_50, recall.recall_75, recall.mean_iou, recall.proposals
            );
        }
        if let Some(area) = self.roc_area {
            return format!("loss {:.3}, area under the ROC curve {area:.3}", self.loss);
        }
        let recall = self.average_recall.map(|ar| format!(", AR {ar:.3}")).unwrap_or_default();
        let prints = self
            .print_within_15deg
            .map(|share| format!(" ({:.0} % of those that the print decides)", 100.0 * share))
            .unwrap_or_default();
        format!(
            "loss {:.3}, median {:.1} deg and {:.1} cm, {:.0} % within 5 deg/5 cm, {:.0} % within 15 deg{prints}{recall}",
            self.loss,
            self.median_rotation_deg,
            100.0 * self.median_translation_m,
            100.0 * self.within_5deg_5cm,
            100.0 * self.within_15deg,
        )
    }
}

/// Appends events to the file.
pub struct Journal {
    path: PathBuf,
    file: File,
    /// Bytes of the whole lines in the file.
    length: u64,
}

impl Journal {
    /// Opens the journal of a run that resumes at `step`, or begins anew: later lines and torn ones are dropped. Returns
    /// the events that remain.
    pub fn open(path: &Path, step: Option<u64>) -> Result<(Self, Vec<Event>), TrainError> {
        let io = |source| TrainError::Io { path: path.to_owned(), source };
        let mut events = Self::read(path)?;
        events.retain(|event| step.is_some_and(|step| event.step() <= step));
        write_atomic(path, |writer| events.iter().try_for_each(|event| writer.write_all(&line(event)?)))?;
        let file = OpenOptions::new().append(true).open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        Ok((Self { path: path.to_owned(), file, length }, events))
    }

    /// All complete lines, with a warning about others; none when there is no file.
    pub fn read(path: &Path) -> Result<Vec<Event>, TrainError> {
        let content = match std::fs::read(path) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            content => content.map_err(|source| TrainError::Io { path: path.to_owned(), source })?,
        };
        let lines: Vec<&[u8]> = content.split(|&b| b == b'\n').collect();
        let (mut events, mut unreadable) = (Vec::new(), Vec::new());
        for (index, line) in lines.iter().enumerate().filter(|(_, line)| !line.is_empty()) {
            match serde_json::from_slice(line) {
                Ok(event) => events.push(event),
                Err(_) => unreadable.push(index + 1),
            }
        }
        if let Some(first) = unreadable.first() {
            let (path, count) = (path.display(), unreadable.len());
            tracing::warn!(
                "{path}: {count} lines cannot be read and are left out, the first is line {first}"
            );
        }
        Ok(events)
    }

    /// Writes an event as a whole line, or nothing of it.
    pub fn append(&mut self, event: &Event) -> Result<(), TrainError> {
        let written = line(event).and_then(|line| {
            self.file.write_all(&line)?;
            self.length += line.len() as u64;
            Ok(())
        });
        written.map_err(|source| {
            // What a full disk took of the line goes again; if that fails too, the next resume drops it.
            let _ = self.file.set_len(self.length);
            TrainError::Io { path: self.path.clone(), source }
        })
    }

    /// Waits until all lines are on the disk.
    pub fn sync(&self) -> Result<(), TrainError> {
        self.file.sync_data().map_err(|source| TrainError::Io { path: self.path.clone(), source })
    }
}

/// The line of an event with its end.
fn line(event: &Event) -> std::io::Result<Vec<u8>> {
    let mut line = serde_json::to_vec(event)?;
    line.push(b'\n');
    Ok(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(step: u64) -> Event {
        Event::Step(StepRecord {
            step,
            loss: 1.5,
            learning_rate: 1e-3,
            gradient_norm: 2.0,
            elapsed_s: 3.0,
            terms: [("coarse.info_nce.0".to_owned(), 0.5)].into(),
        })
    }

    #[test]
    fn resuming_drops_later_and_torn_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let (mut journal, events) = Journal::open(&path, None).unwrap();
        assert!(events.is_empty());
        for step in 1..=5 {
            journal.append(&at(step)).unwrap();
        }
        journal.append(&Event::Validation(ValidationRecord { step: 3, ..Default::default() })).unwrap();
        drop(journal);
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        // Not UTF-8 either.
        file.write_all(b"{\"event\":\"step\",\"st\xff").unwrap();
        drop(file);

        let (mut journal, events) = Journal::open(&path, Some(3)).unwrap();
        assert_eq!(events.iter().map(Event::step).collect::<Vec<_>>(), [1, 2, 3, 3]);
        assert_eq!(events[0], at(1));
        journal.append(&at(4)).unwrap();
        drop(journal);
        let lines = std::fs::read_to_string(&path).unwrap();
        assert_eq!(lines.lines().count(), 5);
        assert!(lines.ends_with('\n'));
        // A run without a state begins anew.
        assert!(Journal::open(&path, None).unwrap().1.is_empty());
        assert_eq!(std::fs::read(&path).unwrap(), b"");
    }
}
