//! Where the members of a shard lie.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

use unopose_core::files::{open_regular, read_regular};

use super::{super::FormatError, records::MemberKind};

/// Bytes of the largest member of an unpacked shard.
const MAX_MEMBER: u64 = 1 << 30;

/// Place of a member: a whole file, or a part of a tar.
#[derive(Clone, Debug)]
enum Place {
    Part { offset: u64, size: u64 },
    File(PathBuf),
}

/// The members of one image.
#[derive(Clone, Debug, Default)]
pub(super) struct Members(BTreeMap<MemberKind, Place>);

/// One shard: a tar or a folder.
#[derive(Clone, Debug)]
pub(super) struct Archive {
    pub path: PathBuf,
    pub images: BTreeMap<String, Members>,
    /// What was left out and why.
    pub problems: Vec<String>,
}

impl Archive {
    /// Lists the members without reading their content. A damaged tar gives what lies before the damage.
    pub fn scan(path: &Path) -> Result<Self, FormatError> {
        let mut archive = Self { path: path.to_owned(), images: BTreeMap::new(), problems: Vec::new() };
        if path.is_dir() {
            archive.scan_folder()?
        } else {
            archive.scan_tar()?
        }
        let path = archive.path.display().to_string();
        let problems = &mut archive.problems;
        archive.images.retain(|key, members| {
            let missing =
                MemberKind::ALL.iter().find(|k| **k != MemberKind::Mask && !members.0.contains_key(k));
            if let Some(kind) = missing {
                problems.push(format!("{path}: {key}.{} not found, image skipped", kind.extension()));
            }
            missing.is_none()
        });
        Ok(archive)
    }

    fn scan_folder(&mut self) -> Result<(), FormatError> {
        let entries = std::fs::read_dir(&self.path).map_err(|e| FormatError::io(&self.path, e))?;
        for entry in entries {
            let file = entry.map_err(|e| FormatError::io(&self.path, e))?.path();
            let name = file.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_owned();
            if file.is_file() {
                self.add(&name, Place::File(file));
            }
        }
        Ok(())
    }

    fn scan_tar(&mut self) -> Result<(), FormatError> {
        let io = |e| FormatError::io(&self.path, e);
        let file = open_regular(&self.path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut tar = tar::Archive::new(file);
        let mut found = Vec::new();
        for entry in tar.entries_with_seek().map_err(io)? {
            let part = entry.and_then(|entry| {
                let path = entry.path()?.into_owned();
                let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_owned();
                let is_file = entry.header().entry_type().is_file();
                Ok((name, is_file, entry.raw_file_position(), entry.size()))
            });
            match part {
                Ok((name, is_file, offset, size)) if size <= length.saturating_sub(offset) => {
                    if is_file {
                        found.push((name, offset, size));
                    }
                }
                Ok((name, _, offset, size)) => {
                    let (path, end) = (self.path.display(), offset.saturating_add(size));
                    self.problems.push(format!("{path}: truncated: {name} ends at byte {end} of {length}"));
                    break;
                }
                Err(error) => {
                    self.problems.push(format!(
                        "{}: damaged after {} members: {error}",
                        self.path.display(),
                        found.len()
                    ));
                    break;
                }
            }
        }
        for (name, offset, size) in found {
            self.add(&name, Place::Part { offset, size });
        }
        if self.images.is_empty() && self.problems.is_empty() {
            self.problems.push(format!("{}: no images in {length} bytes", self.path.display()));
        }
        Ok(())
    }

    fn add(&mut self, name: &str, place: Place) {
        let Some((key, kind)) = MemberKind::split(name) else { return };
        if self.images.entry(key.to_owned()).or_default().0.insert(kind, place).is_some() {
            let path = self.path.display();
            self.problems
                .push(format!("{path}: {key}.{} is there twice, the last one is read", kind.extension()));
        }
    }

    /// A reader of this shard's members; keeps the tar open.
    pub fn reader(&self) -> Result<MemberReader<'_>, FormatError> {
        let tar = match self.path.is_dir() {
            true => None,
            false => Some(open_regular(&self.path).map_err(|e| FormatError::io(&self.path, e))?),
        };
        Ok(MemberReader { archive: self, tar })
    }
}

pub(super) struct MemberReader<'a> {
    archive: &'a Archive,
    tar: Option<File>,
}

impl MemberReader<'_> {
    /// Content of a member and its name for messages.
    pub fn read(&mut self, key: &str, kind: MemberKind) -> Result<(Vec<u8>, String), FormatError> {
        let name = format!("{}: {key}.{}", self.archive.path.display(), kind.extension());
        let place = self.archive.images.get(key).and_then(|m| m.0.get(&kind));
        let io = |e| FormatError::io(Path::new(&name), e);
        let bytes = match (place, &mut self.tar) {
            (Some(Place::File(path)), _) => read_regular(path, MAX_MEMBER).map_err(io)?,
            (Some(Place::Part { offset, size }), Some(tar)) => {
                tar.seek(SeekFrom::Start(*offset)).map_err(io)?;
                let mut bytes = vec![0; *size as usize];
                tar.read_exact(&mut bytes).map_err(io)?;
                bytes
            }
            _ => return Err(FormatError::missing(name, "member", "")),
        };
        Ok((bytes, name))
    }
}
