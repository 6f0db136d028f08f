//! Images that could not be read. Each costs itself, not the run.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::formats::FormatError;

/// What is wrong with each image that could not be read, by its name.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct UnreadImages(BTreeMap<String, Unread>);

/// Why an image could not be read.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Unread {
    /// The same for equal causes.
    cause: String,
    /// With the file.
    message: String,
}

impl UnreadImages {
    /// Notes an image; returns the cause, the same for equal ones.
    pub fn add(&mut self, scene_id: u32, im_id: u32, error: &FormatError) -> String {
        let (cause, name) = (error.cause(), format!("scene {scene_id} image {im_id}"));
        tracing::warn!("{name} cannot be read: {error}");
        self.0.insert(name, Unread { cause: cause.clone(), message: error.to_string() });
        cause
    }

    /// Adds those of another list.
    pub fn merge(&mut self, other: &Self) {
        self.0.extend(other.0.clone());
    }

    /// Those that `known` does not name.
    pub fn except(&self, known: &BTreeMap<String, String>) -> Self {
        let others = self.0.iter().filter(|(name, _)| !known.contains_key(*name));
        Self(others.map(|(name, unread)| (name.clone(), unread.clone())).collect())
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether all images could be read.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// What is wrong with each image, by its name.
    pub fn messages(&self) -> BTreeMap<String, String> {
        self.0.iter().map(|(name, unread)| (name.clone(), unread.message.clone())).collect()
    }

    /// A line for every cause, with the number of images and the first of them; empty when all could be read.
    pub fn by_cause(&self) -> Vec<String> {
        let mut causes: BTreeMap<&str, (usize, &str, &str)> = BTreeMap::new();
        for (name, Unread { cause, message }) in &self.0 {
            causes.entry(cause).or_insert((0, name, message)).0 += 1;
        }
        let line = |(cause, (count, name, message)): (&str, (usize, &str, &str))| {
            format!("{count} images cannot be read: {cause} ({name}: {message})")
        };
        causes.into_iter().map(line).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_counted_with_the_first_image() {
        let mut unread = UnreadImages::default();
        for im_id in [3, 5, 3] {
            let missing = format!("depth/{im_id:06}.png|tif");
            assert_eq!(
                unread.add(1, im_id, &FormatError::missing("test/000001", missing, "")),
                "depth not found"
            );
        }
        unread.add(
            2,
            0,
            &FormatError::field("scene_camera.json: image 0", "depth_scale", -1, "a scale above 0"),
        );
        assert_eq!(unread.len(), 3);
        assert_eq!(
            unread.by_cause(),
            [
                "2 images cannot be read: depth not found (scene 1 image 3: test/000001: depth/000003.png|tif not found)",
                "1 images cannot be read: wrong depth_scale (scene 2 image 0: scene_camera.json: image 0: depth_scale is -1, \
                 expected a scale above 0)",
            ]
        );
    }
}
