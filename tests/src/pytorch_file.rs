//! Writes state dicts as `torch.save` did before version 1.6: five pickles, then the storages. Enough for tests of
//! reading, without Python.

use std::path::Path;

/// A tensor to be pickled.
pub struct Pickled {
    pub name: String,
    pub shape: Vec<usize>,
    /// `FloatStorage`, `HalfStorage`, `BFloat16Storage`, `DoubleStorage`, `LongStorage`.
    pub storage: &'static str,
    /// Little-endian.
    pub bytes: Vec<u8>,
}

impl Pickled {
    pub fn f32(name: &str, shape: &[usize], values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Self { name: name.into(), shape: shape.to_vec(), storage: "FloatStorage", bytes }
    }
}

fn text(out: &mut Vec<u8>, text: &str) {
    out.push(b'X');
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}

fn int(out: &mut Vec<u8>, value: usize) {
    out.push(b'J');
    out.extend((value as i32).to_le_bytes());
}

fn tuple(out: &mut Vec<u8>, values: &[usize]) {
    out.push(b'(');
    values.iter().for_each(|&v| int(out, v));
    out.push(b't');
}

/// `{key: {name: tensor}}`, or `{name: tensor}` without a key, with further entries pickled by the caller.
pub fn write(path: &Path, key: Option<&str>, tensors: &[Pickled], more: &[u8]) {
    let mut out = b"\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.".to_vec();
    out.extend(b"\x80\x02M\xe9\x03.");
    out.extend(b"\x80\x02}");
    text(&mut out, "little_endian");
    out.extend(b"\x88s.");
    out.extend(b"\x80\x02}(");
    if let Some(key) = key {
        text(&mut out, key);
        out.extend(b"}(");
    }
    for (i, tensor) in tensors.iter().enumerate() {
        let numbers: usize = tensor.shape.iter().product();
        text(&mut out, &tensor.name);
        out.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut out, "storage");
        out.extend(format!("ctorch\n{}\n", tensor.storage).as_bytes());
        text(&mut out, &i.to_string());
        text(&mut out, "cpu");
        int(&mut out, numbers);
        out.extend(b"NtQ");
        int(&mut out, 0);
        tuple(&mut out, &tensor.shape);
        let strides: Vec<usize> =
            (0..tensor.shape.len()).map(|axis| tensor.shape[axis + 1..].iter().product()).collect();
        tuple(&mut out, &strides);
        out.extend(b"\x89ccollections\nOrderedDict\n)RtR");
    }
    if key.is_some() {
        out.push(b'u');
    }
    out.extend(more);
    out.extend(b"u.\x80\x02](");
    (0..tensors.len()).for_each(|i| text(&mut out, &i.to_string()));
    out.extend(b"e.");
    for tensor in tensors {
        let numbers: usize = tensor.shape.iter().product();
        out.extend((numbers as i64).to_le_bytes());
        out.extend(&tensor.bytes);
    }
    std::fs::write(path, out).unwrap();
}
