//! Decoded images kept in memory up to a budget, oldest out first.

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex, PoisonError},
};

use unopose_core::{
    frame::{BoundingBox, Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::formats::{AnnotatedFrame, FormatError};

/// An annotated frame with its masks cut to their boxes.
pub struct CachedFrame {
    pub frame: RgbdFrame,
    pub instances: Vec<CachedInstance>,
}

/// What pairs need of an instance.
pub struct CachedInstance {
    pub obj_id: u32,
    pub t_camera_object: Pose,
    mask: CroppedMask,
}

/// A mask cropped to its tight box; `None` for an empty mask.
struct CroppedMask {
    width: u32,
    height: u32,
    inside: Option<(BoundingBox, Vec<bool>)>,
}

/// Cache of frames by image number.
pub struct FrameCache {
    budget: usize,
    state: Mutex<CacheState>,
}

#[derive(Default)]
struct CacheState {
    bytes: usize,
    frames: HashMap<u32, Arc<CachedFrame>>,
    order: VecDeque<u32>,
}

impl FrameCache {
    /// `budget` in bytes; 0 keeps nothing.
    pub fn new(budget: usize) -> Self {
        Self { budget, state: Mutex::default() }
    }

    /// The frame of `image`, from memory or by `load`.
    pub fn get(
        &self,
        image: u32,
        load: impl FnOnce() -> Result<AnnotatedFrame, FormatError>,
    ) -> Result<Arc<CachedFrame>, FormatError> {
        if let Some(frame) = self.lock().frames.get(&image) {
            return Ok(frame.clone());
        }
        // Decoded outside the lock; two threads may decode the same image, which is rare and harmless.
        let frame = Arc::new(CachedFrame::new(load()?));
        let bytes = frame.bytes();
        let mut state = self.lock();
        if bytes <= self.budget && !state.frames.contains_key(&image) {
            while state.bytes + bytes > self.budget {
                let Some(oldest) = state.order.pop_front().and_then(|i| state.frames.remove(&i)) else {
                    break;
                };
                state.bytes -= oldest.bytes();
            }
            state.bytes += bytes;
            state.frames.insert(image, frame.clone());
            state.order.push_back(image);
        }
        Ok(frame)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, CacheState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CachedFrame {
    fn new(annotated: AnnotatedFrame) -> Self {
        let instances = annotated
            .instances
            .into_iter()
            .map(|i| CachedInstance {
                obj_id: i.obj_id,
                t_camera_object: i.t_camera_object,
                mask: CroppedMask::new(&i.mask_visib),
            })
            .collect();
        Self { frame: annotated.frame, instances }
    }

    fn bytes(&self) -> usize {
        let masks: usize =
            self.instances.iter().map(|i| i.mask.inside.as_ref().map_or(0, |m| m.1.len())).sum();
        self.frame.rgb.as_raw().len() + 4 * self.frame.depth.data.len() + masks + 256 * self.instances.len()
    }
}

impl CachedInstance {
    /// The visible part, in the image's size.
    pub fn mask(&self) -> Mask {
        self.mask.full()
    }
}

impl CroppedMask {
    fn new(mask: &Mask) -> Self {
        let inside = mask.bounding_box().map(|b| {
            let rows =
                (b.row_min..b.row_max).flat_map(|row| (b.col_min..b.col_max).map(move |col| (col, row)));
            (b, rows.map(|(col, row)| mask.get(col, row)).collect())
        });
        Self { width: mask.width, height: mask.height, inside }
    }

    fn full(&self) -> Mask {
        let mut mask = Mask::empty(self.width, self.height);
        if let Some((b, cut)) = &self.inside {
            let cut_width = (b.col_max - b.col_min) as usize;
            for (row, values) in (b.row_min as usize..).zip(cut.chunks_exact(cut_width)) {
                let start = row * self.width as usize + b.col_min as usize;
                mask.data[start..start + cut_width].copy_from_slice(values);
            }
        }
        mask
    }
}

#[cfg(test)]
mod tests {
    use unopose_core::{frame::DepthMap, geometry::Intrinsics};

    use super::*;

    fn annotated(level: u8) -> AnnotatedFrame {
        let frame = RgbdFrame {
            rgb: image::RgbImage::from_pixel(10, 10, image::Rgb([level; 3])),
            depth: DepthMap::zeros(10, 10),
            intrinsics: Intrinsics { fx: 10.0, fy: 10.0, cx: 5.0, cy: 5.0 },
        };
        AnnotatedFrame { frame, instances: vec![] }
    }

    #[test]
    fn keeps_the_newest_within_the_budget() {
        // 700 bytes per frame.
        let cache = FrameCache::new(1500);
        for image in 0..3 {
            cache.get(image, || Ok(annotated(image as u8))).unwrap();
        }
        let level = |image| cache.get(image, || Ok(annotated(99))).unwrap().frame.rgb.get_pixel(0, 0).0[0];
        assert_eq!((level(2), level(1)), (2, 1));
        assert_eq!(level(0), 99);
        assert!(cache.lock().bytes <= 1500);
    }

    #[test]
    fn cut_masks_come_back_whole() {
        let mut mask = Mask::empty(7, 5);
        for i in [9, 10, 18, 25] {
            mask.data[i] = true;
        }
        assert_eq!(CroppedMask::new(&mask).full(), mask);
        assert_eq!(CroppedMask::new(&Mask::empty(3, 2)).full(), Mask::empty(3, 2));
    }
}
