//! PLY meshes as BOP writes them: normals, colours per vertex or face, texture coordinates per vertex or per face
//! corner, and the picture named by a `TextureFile` comment.

mod faces;
mod read;
mod records;
mod write;

pub(super) use read::read;
pub use write::write;

#[cfg(test)]
mod tests;
