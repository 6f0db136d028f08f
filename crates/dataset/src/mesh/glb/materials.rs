//! Base colours of a glTF asset.

use std::{collections::HashMap, path::Path, sync::Arc};

use gltf::json::{Image, Index, Material as JsonMaterial, Root, texture::Info};
use image::RgbImage;

use super::{
    super::{atlas::Material, picture::Pictures},
    buffers::{Buffers, entry, read_uri},
};

/// sRGB of a primitive without a material.
const GREY: u8 = 176;

/// The materials of an asset; pictures are read when a primitive has them.
pub(super) struct Materials<'a> {
    path: &'a Path,
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    pictures: Pictures<'a>,
    /// By the index of the image.
    known: HashMap<usize, Option<Arc<RgbImage>>>,
    /// Those of [`Root::materials`], and one for primitives that have none.
    materials: Vec<Material>,
    used: Vec<bool>,
}

impl<'a> Materials<'a> {
    pub fn new(path: &'a Path, root: &'a Root, buffers: &'a Buffers<'a>) -> Self {
        let color = |material: &JsonMaterial| {
            let [r, g, b, _] = material.pbr_metallic_roughness.base_color_factor.0;
            Material { picture: None, color: [r, g, b].map(srgb) }
        };
        let mut materials: Vec<Material> = root.materials.iter().map(color).collect();
        materials.push(Material { picture: None, color: [GREY; 3] });
        let (used, known) = (vec![false; materials.len()], HashMap::new());
        Self { path, root, buffers, pictures: Pictures::of(path), known, materials, used }
    }

    /// Number of a material and the set of texture coordinates that its picture wants.
    pub fn use_material(&mut self, index: Option<Index<JsonMaterial>>) -> Result<(u32, u32), String> {
        let Some(index) = index.map(|index| index.value()) else {
            return Ok((self.root.materials.len() as u32, 0));
        };
        let material = entry(&self.root.materials, index, "materials")?;
        let texture = material.pbr_metallic_roughness.base_color_texture.as_ref();
        if !std::mem::replace(&mut self.used[index], true) {
            self.materials[index].picture = texture.and_then(|texture| self.picture(texture));
        }
        Ok((index as u32, texture.map_or(0, |texture| texture.tex_coord)))
    }

    /// Linear base colour of a material.
    pub fn factor(&self, material: u32) -> [f32; 3] {
        match self.root.materials.get(material as usize) {
            Some(material) => {
                let [r, g, b, _] = material.pbr_metallic_roughness.base_color_factor.0;
                [r, g, b]
            }
            None => [1.0; 3],
        }
    }

    /// sRGB of a material.
    pub fn color(&self, material: u32) -> [u8; 3] {
        self.materials[material as usize].color
    }

    pub fn finish(self) -> Vec<Material> {
        self.materials
    }

    fn picture(&mut self, info: &Info) -> Option<Arc<RgbImage>> {
        let moved = |e: &gltf::json::extensions::texture::Info| e.texture_transform.is_some();
        if info.extensions.as_ref().is_some_and(moved) {
            tracing::warn!("{}: KHR_texture_transform is not applied", self.path.display());
        }
        let texture = self.root.textures.get(info.index.value());
        let webp = texture
            .and_then(|t| t.extensions.as_ref()?.others.get("EXT_texture_webp")?.get("source")?.as_u64());
        let source = webp.map(|i| i as usize).or(texture.map(|t| t.source.value()));
        let image = source.and_then(|i| Some((i, self.root.images.get(i)?)));
        let Some((index, image)) = image else {
            let wanted = info.index.value();
            tracing::warn!("{}: textures[{wanted}] has no image; loaded without it", self.path.display());
            return None;
        };
        if let Some(known) = self.known.get(&index) {
            return known.clone();
        }
        let bytes = self.image_bytes(image);
        let picture = self.pictures.decode(bytes, &format!("images[{index}]"));
        self.known.insert(index, picture.clone());
        picture
    }

    fn image_bytes(&self, image: &Image) -> Result<Vec<u8>, String> {
        match (image.buffer_view, &image.uri) {
            (Some(view), _) => Ok(self.buffers.view(view)?.0.to_vec()),
            (None, Some(uri)) => read_uri(self.path.parent().unwrap_or(Path::new("")), uri),
            (None, None) => Err("neither bufferView nor uri".to_owned()),
        }
    }
}

pub(super) fn srgb(linear: f32) -> u8 {
    (linear.clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8
}
