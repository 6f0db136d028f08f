//! The bytes of a glTF asset: its buffers, views and accessors, with every range checked.

use std::{borrow::Cow, collections::HashMap, path::Path, sync::Arc};

use base64::Engine;
use gltf::json::{
    Accessor, Index, Root,
    accessor::{ComponentType, Type},
    buffer::View,
    validation::Checked,
};

use super::super::file::{excerpt, read_regular};

/// The entry of a list of the asset.
pub(super) fn entry<'a, T>(list: &'a [T], index: usize, name: &str) -> Result<&'a T, String> {
    list.get(index)
        .ok_or_else(|| format!("{name}[{index}] is referred to, but there are only {}", list.len()))
}

/// Bytes of an asset's buffers.
pub(super) struct Buffers<'a> {
    root: &'a Root,
    /// Those of [`Root::buffers`].
    data: Vec<Arc<Cow<'a, [u8]>>>,
    /// Of all buffers.
    total: usize,
}

/// Elements of an accessor, without gaps.
struct Packed<'a> {
    bytes: Cow<'a, [u8]>,
    component: ComponentType,
    kind: Type,
    normalized: bool,
}

impl<'a> Buffers<'a> {
    /// Reads the buffers of an asset in `folder`; `blob` is the binary part of a GLB file.
    pub fn read(root: &'a Root, folder: &Path, blob: Option<&'a [u8]>) -> Result<Self, String> {
        // What many buffers name is read once.
        let mut known: HashMap<Option<&str>, Arc<Cow<[u8]>>> = HashMap::new();
        let mut data = Vec::new();
        for (i, buffer) in root.buffers.iter().enumerate() {
            let (uri, length) = (buffer.uri.as_deref(), buffer.byte_length.0);
            let bytes = match (known.get(&uri), uri, blob) {
                (Some(bytes), ..) => bytes.clone(),
                (None, Some(uri), _) => {
                    Arc::new(Cow::Owned(read_uri(folder, uri).map_err(|e| format!("buffers[{i}]: {e}"))?))
                }
                (None, None, Some(blob)) => Arc::new(Cow::Borrowed(blob)),
                (None, None, None) => {
                    return Err(format!("buffers[{i}] has no uri, and there is no binary part"));
                }
            };
            known.insert(uri, bytes.clone());
            // The last word of a buffer may be cut.
            if (bytes.len().next_multiple_of(4) as u64) < length {
                return Err(format!("buffers[{i}] has {} bytes, byteLength says {length}", bytes.len()));
            }
            data.push(bytes);
        }
        let total = known.values().map(|bytes| bytes.len()).sum();
        Ok(Self { root, data, total })
    }

    /// Bytes of all buffers together.
    pub fn total(&self) -> usize {
        self.total
    }

    /// The bytes of a view and its stride, 0 where it has none.
    pub fn view(&self, index: Index<View>) -> Result<(&[u8], usize), String> {
        let i = index.value();
        let view = entry(&self.root.buffer_views, i, "bufferViews")?;
        let data = entry(&self.data, view.buffer.value(), "buffers")?;
        let start = view.byte_offset.map_or(0, |offset| offset.0);
        let bytes = range(data, start, view.byte_length.0).ok_or_else(|| {
            let (end, has) = (start.saturating_add(view.byte_length.0), data.len());
            format!("bufferViews[{i}] is bytes {start} to {end} of a buffer of {has}")
        })?;
        Ok((bytes, view.byte_stride.map_or(0, |stride| stride.0)))
    }

    /// Elements of vectors with `kinds` many components, integers as fractions where they are normalised; what a
    /// vector does not have is 1.
    pub fn vectors(&self, index: Index<Accessor>, kinds: &[Type]) -> Result<Vec<[f32; 4]>, String> {
        let packed = self.packed(index, kinds)?;
        let (size, parts) = (packed.component.size(), packed.kind.multiplicity());
        let vector = |bytes: &[u8]| {
            let mut values = [1.0; 4];
            for (value, bytes) in values.iter_mut().zip(bytes.chunks_exact(size)) {
                *value = number(bytes, packed.component, packed.normalized);
            }
            values
        };
        Ok(packed.bytes.chunks_exact(size * parts).map(vector).collect())
    }

    /// Vertex indices, all below `vertices`.
    pub fn indices(&self, index: Index<Accessor>, vertices: usize) -> Result<Vec<u32>, String> {
        let i = index.value();
        let read: fn(&[u8]) -> u32 = match self.component(i)? {
            ComponentType::U8 => |b| b[0].into(),
            ComponentType::U16 => |b| u16::from_le_bytes([b[0], b[1]]).into(),
            ComponentType::U32 => |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            other => return Err(format!("accessors[{i}]: indices are {other:?}, expected U8, U16 or U32")),
        };
        let packed = self.packed(index, &[Type::Scalar])?;
        let indices: Vec<u32> = packed.bytes.chunks_exact(packed.component.size()).map(read).collect();
        match indices.iter().position(|&v| v as usize >= vertices) {
            Some(k) => {
                let vertex = indices[k];
                Err(format!("accessors[{i}]: index {k} is vertex {vertex}, but there are only {vertices}"))
            }
            None => Ok(indices),
        }
    }

    /// Number of elements, no larger than the buffers can justify.
    pub fn count(&self, index: Index<Accessor>) -> Result<usize, String> {
        let i = index.value();
        let count = entry(&self.root.accessors, i, "accessors")?.count.0;
        let checked = usize::try_from(count).ok().filter(|&count| count <= self.total);
        checked.ok_or_else(|| {
            format!("accessors[{i}]: count is {count}, but the buffers have {} bytes", self.total)
        })
    }

    fn component(&self, accessor: usize) -> Result<ComponentType, String> {
        match &entry(&self.root.accessors, accessor, "accessors")?.component_type {
            Checked::Valid(component) => Ok(component.0),
            Checked::Invalid => Err(format!("accessors[{accessor}]: unknown componentType")),
        }
    }

    fn packed(&self, index: Index<Accessor>, kinds: &[Type]) -> Result<Packed<'_>, String> {
        let i = index.value();
        let accessor = entry(&self.root.accessors, i, "accessors")?;
        let component = self.component(i)?;
        let Checked::Valid(kind) = accessor.type_ else {
            return Err(format!("accessors[{i}]: unknown type"));
        };
        if !kinds.contains(&kind) {
            return Err(format!("accessors[{i}]: type is {kind:?}, expected one of {kinds:?}"));
        }
        let (count, size) = (self.count(index)?, component.size() * kind.multiplicity());
        let strided = |view, offset: u64, count: usize, size: usize| {
            self.strided(view, offset, count, size).map_err(|e| format!("accessors[{i}]: {e}"))
        };
        let mut bytes = match accessor.buffer_view {
            Some(view) => strided(view, accessor.byte_offset.map_or(0, |o| o.0), count, size)?,
            None if accessor.sparse.is_some() => vec![0; count * size].into(),
            None => return Err(format!("accessors[{i}] has neither bufferView nor sparse")),
        };
        if let Some(sparse) = &accessor.sparse {
            let changes = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
            if changes > count {
                return Err(format!("accessors[{i}]: sparse.count is {changes}, but count is {count}"));
            }
            let Checked::Valid(places) = &sparse.indices.component_type else {
                return Err(format!("accessors[{i}]: unknown componentType of sparse.indices"));
            };
            let width = places.0.size();
            let at = strided(sparse.indices.buffer_view, sparse.indices.byte_offset.0, changes, width)?;
            let values = strided(sparse.values.buffer_view, sparse.values.byte_offset.0, changes, size)?;
            let base = bytes.to_mut();
            for (place, value) in at.chunks_exact(width).zip(values.chunks_exact(size)) {
                let place = place.iter().rev().fold(0usize, |sum, &b| sum << 8 | usize::from(b));
                let Some(element) = base.chunks_exact_mut(size).nth(place) else {
                    return Err(format!("accessors[{i}]: sparse index {place}, but count is {count}"));
                };
                element.copy_from_slice(value);
            }
        }
        Ok(Packed { bytes, component, kind, normalized: accessor.normalized })
    }

    /// `count` elements of `size` bytes of a view.
    fn strided(
        &self,
        view: Index<View>,
        offset: u64,
        count: usize,
        size: usize,
    ) -> Result<Cow<'_, [u8]>, String> {
        let (bytes, stride) = self.view(view)?;
        let stride = if stride == 0 { size } else { stride };
        if stride < size {
            return Err(format!("byteStride is {stride}, but an element has {size} bytes"));
        }
        let Some(last) = count.checked_sub(1) else { return Ok(Cow::Borrowed(&[])) };
        let length = stride.checked_mul(last).and_then(|start| start.checked_add(size));
        let used = length.and_then(|length| range(bytes, offset, length as u64)).ok_or_else(|| {
            let has = bytes.len();
            format!(
                "{count} elements of {size} bytes every {stride} from {offset} on, but the view has {has}"
            )
        })?;
        if stride == size {
            return Ok(Cow::Borrowed(used));
        }
        Ok(used.chunks(stride).flat_map(|element| &element[..size]).copied().collect())
    }
}

/// The bytes that a URI stands for: data in the URI itself, or a file in or below the asset's folder.
pub(super) fn read_uri(folder: &Path, uri: &str) -> Result<Vec<u8>, String> {
    let bad = |reason: &str| format!("uri {}: {reason}", excerpt(uri));
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, encoded) = data.split_once(";base64,").ok_or_else(|| bad("expected base64 data"))?;
        let decoded = base64::engine::general_purpose::STANDARD.decode(encoded);
        return decoded.map_err(|e| bad(&e.to_string()));
    }
    let name = percent_encoding::percent_decode_str(uri).decode_utf8().map_err(|e| bad(&e.to_string()))?;
    let path = Path::new(&*name);
    let inside = |part| matches!(part, std::path::Component::Normal(_) | std::path::Component::CurDir);
    if name.contains("://") || name.starts_with("file:") || !path.components().all(inside) {
        return Err(bad("expected a file in the folder of the mesh"));
    }
    read_regular(&folder.join(path)).map_err(|e| bad(&e))
}

fn range(bytes: &[u8], start: u64, length: u64) -> Option<&[u8]> {
    let end = usize::try_from(start.checked_add(length)?).ok()?;
    bytes.get(usize::try_from(start).ok()?..end)
}

fn number(bytes: &[u8], component: ComponentType, normalized: bool) -> f32 {
    let (value, largest) = match (component, bytes) {
        (ComponentType::I8, &[a]) => (f32::from(a as i8), 127.0),
        (ComponentType::U8, &[a]) => (f32::from(a), 255.0),
        (ComponentType::I16, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])), 32_767.0),
        (ComponentType::U16, &[a, b]) => (f32::from(u16::from_le_bytes([a, b])), 65_535.0),
        (ComponentType::U32, &[a, b, c, d]) => (u32::from_le_bytes([a, b, c, d]) as f32, u32::MAX as f32),
        (ComponentType::F32, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
        _ => return f32::NAN,
    };
    if normalized { (value / largest).max(-1.0) } else { value }
}
