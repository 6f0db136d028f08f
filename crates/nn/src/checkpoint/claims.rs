//! What a PyTorch file claims about its size, held against its length before anything is allocated for it.

use std::{fs::File, path::Path};

use burn::store::pytorch_reader::Tensor;
use zip::ZipArchive;

use super::CheckpointError;

/// Largest pickle, bytes. That of a training checkpoint with a thousand tensors has under one million.
const PICKLE: u64 = 16 << 20;
/// Largest size of all entries, or of all tensors, relative to the file's length. Weights hardly compress; tensors that
/// share a storage count several times.
const EXPANSION: u64 = 20;

/// The file's length, once the entries of a zip archive are found to be in proportion to it.
pub(super) fn check_archive(path: &Path) -> Result<u64, CheckpointError> {
    let read = |source| CheckpointError::Read { path: path.to_owned(), source };
    let file = File::open(path).map_err(read)?;
    let length = file.metadata().map_err(read)?.len();
    // Tar and legacy pickles are not compressed.
    let Ok(mut archive) = ZipArchive::new(file) else { return Ok(length) };
    let mut total = 0u64;
    for index in 0..archive.len() {
        let entry = archive.by_index_raw(index).map_err(|e| refused(path, e.to_string()))?;
        let name = entry.name().map_or_else(|_| String::new(), |name| name.into_owned());
        let size = entry.size();
        total = total.saturating_add(size);
        if name.ends_with(".pkl") && size > PICKLE {
            return Err(refused(path, format!("{name} is {size} bytes, expected at most {PICKLE}")));
        }
    }
    within(path, "entries of the archive", total, length)?;
    Ok(length)
}

/// Checks tensors that are to be read from a file of `length` bytes.
pub(super) fn check_tensors<'a>(
    path: &Path,
    tensors: impl Iterator<Item = &'a Tensor>,
    length: u64,
) -> Result<(), CheckpointError> {
    let bytes = |tensor: &Tensor| {
        let count = tensor.shape().iter().try_fold(1u64, |n, &axis| n.checked_mul(axis as u64));
        count.and_then(|n| n.checked_mul(tensor.dtype().size() as u64)).unwrap_or(u64::MAX)
    };
    within(path, "tensors", tensors.map(bytes).fold(0, u64::saturating_add), length)
}

fn within(path: &Path, what: &str, total: u64, length: u64) -> Result<(), CheckpointError> {
    if total <= length.saturating_mul(EXPANSION) {
        return Ok(());
    }
    Err(refused(
        path,
        format!(
            "its {what} would be {total} bytes, but the file is {length}; expected at most {EXPANSION} times as many"
        ),
    ))
}

fn refused(path: &Path, message: String) -> CheckpointError {
    CheckpointError::Pytorch { path: path.to_owned(), message }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use zip::{ZipWriter, write::SimpleFileOptions};

    use super::{super::stored::Container, *};

    /// `{"w": tensor of this shape and strides over 16 floats}` as `torch.save` writes it.
    fn state(path: &Path, shape: [u32; 3], strides: [u32; 3], padding: usize) {
        let tuple = |values: [u32; 3]| -> Vec<u8> {
            let ints = values.iter().flat_map(|v| [&b"J"[..], &v.to_le_bytes()].concat());
            [b"(".to_vec(), ints.collect(), b"t".to_vec()].concat()
        };
        let text = |text: &str| [b"X", &(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat();
        let pickle = [
            b"\x80\x02}".to_vec(),
            // Values that are made and dropped again.
            b"]0".repeat(padding),
            text("w"),
            b"ctorch._utils\n_rebuild_tensor_v2\n((".to_vec(),
            text("storage"),
            b"ctorch\nFloatStorage\n".to_vec(),
            text("0"),
            text("cpu"),
            b"K\x10tQK\x00".to_vec(),
            tuple(shape),
            tuple(strides),
            b"\x89ccollections\nOrderedDict\n)RtRs.".to_vec(),
        ]
        .concat();
        let mut archive = ZipWriter::new(File::create(path).unwrap());
        for (name, bytes) in [("data.pkl", &pickle[..]), ("byteorder", b"little"), ("data/0", &[0; 64])] {
            archive.start_file(format!("archive/{name}"), SimpleFileOptions::default()).unwrap();
            archive.write_all(bytes).unwrap();
        }
        archive.finish().unwrap();
    }

    fn read(path: &Path) -> Result<usize, String> {
        let open = Container::open(path).and_then(|file| file.read(path, ""));
        open.map(|(tensors, _)| tensors[0].bytes.len()).map_err(|e| e.to_string())
    }

    #[test]
    fn sizes_out_of_proportion_to_the_file_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.pth");
        state(&path, [2, 2, 4], [8, 4, 1], 0);
        assert_eq!(read(&path), Ok(64));
        // One number, a thousand million times.
        state(&path, [1000, 1000, 1000], [0, 0, 0], 0);
        let error = read(&path).unwrap_err();
        assert!(error.contains("tensors would be 4000000000 bytes, but the file is "), "{error}");
        state(&path, [u32::MAX >> 1, u32::MAX >> 1, u32::MAX >> 1], [0, 0, 0], 0);
        // More numbers than there can be.
        read(&path).unwrap_err();
        state(&path, [2, 2, 4], [8, 4, 1], 9 << 20);
        let error = read(&path).unwrap_err();
        assert!(error.contains("archive/data.pkl is 18874"), "{error}");
        assert!(error.contains("expected at most 16777216"), "{error}");
    }
}
