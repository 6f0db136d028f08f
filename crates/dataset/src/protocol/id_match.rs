//! Do the ids of a list of detections or results agree with those of the targets?

use std::collections::BTreeSet;

/// Scene, image and object.
pub type Ids = [u32; 3];

const FIELDS: [&str; 3] = ["scene", "image", "object"];
/// Ids that a message lists before it only counts.
const LISTED: usize = 6;

/// How many entries of a list belong to targets.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct IdMatch {
    /// All entries.
    pub entries: usize,
    /// Entries whose scene, image and object are no target.
    pub unmatched: usize,
    /// Where they differ, in words; empty when all match.
    difference: String,
    /// What an offset of the ids would explain, in words.
    offset: Option<String>,
}

impl IdMatch {
    /// Compares the ids of all entries with those of the targets.
    pub fn new(entries: &[Ids], targets: &BTreeSet<Ids>) -> Self {
        let unmatched: Vec<&Ids> = entries.iter().filter(|ids| !targets.contains(*ids)).collect();
        let mut found = Self { entries: entries.len(), unmatched: unmatched.len(), ..Self::default() };
        if !unmatched.is_empty() {
            found.difference = difference(&unmatched, targets);
            found.offset = offset(entries, entries.len() - unmatched.len(), targets);
        }
        found
    }

    /// Whether the list is likely about something else: nothing matches, or an offset of the ids would make it match.
    pub fn is_suspicious(&self) -> bool {
        self.offset.is_some() || self.unmatched > 0 && self.unmatched == self.entries
    }

    /// "N of M `what` match no target (...)"; `None` when all match.
    pub fn message(&self, what: &str) -> Option<String> {
        let Self { entries, unmatched, difference, offset } = self;
        let offset = offset.as_ref().map(|offset| format!("; {offset}")).unwrap_or_default();
        (*unmatched > 0)
            .then(|| format!("{unmatched} of {entries} {what} match no target ({difference}){offset}"))
    }
}

/// The fields whose ids the targets do not have, or all of them where only the combinations differ.
fn difference(unmatched: &[&Ids], targets: &BTreeSet<Ids>) -> String {
    let sets = |field: usize| -> [BTreeSet<u32>; 2] {
        [unmatched.iter().map(|ids| ids[field]).collect(), targets.iter().map(|ids| ids[field]).collect()]
    };
    let mut differing: Vec<usize> = (0..3).filter(|&f| sets(f)[0].is_disjoint(&sets(f)[1])).collect();
    if differing.is_empty() {
        differing = (0..3).collect();
    }
    let of_field = |field: usize| {
        let [file, targets] = sets(field).map(|ids| listed(&ids));
        format!("{} ids in the file: {file}, in the targets: {targets}", FIELDS[field])
    };
    differing.into_iter().map(of_field).collect::<Vec<_>>().join("; ")
}

fn listed(ids: &BTreeSet<u32>) -> String {
    let mut all: Vec<String> = ids.iter().take(LISTED).map(u32::to_string).collect();
    if let (true, Some(last)) = (ids.len() > LISTED, ids.last()) {
        all.push(format!("... {last} ({} ids)", ids.len()));
    }
    all.join(" ")
}

/// A difference of the ids of one field that explains the entries without a target: with it, all match and the ids begin and
/// end as those of the targets, or more than twice as many match as do now and they are half of the entries or targets.
fn offset(entries: &[Ids], matched: usize, targets: &BTreeSet<Ids>) -> Option<String> {
    let ends = |field: usize| -> Option<[i64; 2]> {
        let difference = |of_entries: Option<u32>, of_targets: Option<u32>| {
            Some(i64::from(of_entries?) - i64::from(of_targets?))
        };
        let (entries, targets) = (entries.iter().map(|ids| ids[field]), targets.iter().map(|ids| ids[field]));
        Some([
            difference(entries.clone().min(), targets.clone().min())?,
            difference(entries.max(), targets.max())?,
        ])
    };
    let ends = [ends(0)?, ends(1)?, ends(2)?];
    let candidates = (0..3).flat_map(|field| [1, -1, ends[field][0]].map(|k| (field, k)));
    let explained = |&(field, k): &(usize, i64)| {
        let shifted = |ids: &&Ids| {
            let mut ids = **ids;
            u32::try_from(i64::from(ids[field]) - k).is_ok_and(|id| {
                ids[field] = id;
                targets.contains(&ids)
            })
        };
        entries.iter().filter(shifted).count()
    };
    let best = candidates.map(|candidate| (explained(&candidate), candidate)).max_by_key(|(count, _)| *count);
    let (count, (field, k)) = best?;
    let all = count == entries.len() && ends[field] == [k; 2];
    let most = count > 2 * matched && 2 * count >= entries.len().min(targets.len()).max(1);
    (all || most).then(|| {
        let (field, direction, k) = (FIELDS[field], if k > 0 { "large" } else { "small" }, k.abs());
        format!("the {field} ids of the file look too {direction} by {k}: {count} would match then")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(entries: &[Ids], targets: &[Ids]) -> Option<String> {
        IdMatch::new(entries, &targets.iter().copied().collect()).message("detections")
    }

    #[test]
    fn ids_off_by_a_constant_are_told() {
        let targets = [[1, 0, 3], [1, 0, 7]];
        let found = message(&[[1, 1, 3], [1, 1, 7]], &targets).unwrap();
        assert_eq!(
            found,
            "2 of 2 detections match no target (image ids in the file: 1, in the targets: 0); the image ids of the file \
             look too large by 1: 2 would match then"
        );
        let found = message(&[[1, 0, 2], [1, 0, 6]], &targets).unwrap();
        assert!(found.contains("(object ids in the file: 2 6, in the targets: 3 7)"), "{found}");
        assert!(found.contains("object ids of the file look too small by 1: 2 would match"), "{found}");
        let found = message(&[[48, 0, 3], [48, 0, 7]], &targets).unwrap();
        assert!(found.contains("scene ids of the file look too large by 47"), "{found}");
        // A video of which all but one frame match by accident.
        let [file, frames] =
            [1, 0].map(|first| (first..first + 10).map(|im| [1, im, 1]).collect::<Vec<Ids>>());
        let found = message(&file, &frames).unwrap();
        assert!(
            found.starts_with("1 of 10 detections match no target")
                && found.contains("image ids of the file look too large by 1"),
            "{found}"
        );
        assert_eq!(message(&targets, &targets), None);
        assert_eq!(message(&[], &targets), None);
    }

    #[test]
    fn other_objects_are_counted_without_suspicion() {
        // Every object detected everywhere, one of five is a target of every image.
        let entries: Vec<Ids> = (0..100).map(|i| [1, i / 5, i % 5]).collect();
        let targets: BTreeSet<Ids> = (0..20).map(|im| [1, im, im % 5]).collect();
        let found = IdMatch::new(&entries, &targets);
        assert_eq!((found.unmatched, found.entries, found.is_suspicious()), (80, 100, false));
        let message = found.message("detections").unwrap();
        assert!(message.contains("image ids in the file: 0 1 2 3 4 5 ... 19 (20 ids)"), "{message}");
        let elsewhere = IdMatch::new(&[[9, 1, 1]], &BTreeSet::from([[1, 5, 1], [1, 6, 2]]));
        assert!(elsewhere.is_suspicious() && elsewhere.offset.is_none());
    }
}
