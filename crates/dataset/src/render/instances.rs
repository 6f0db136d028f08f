//! Masks and visibility of every object in a view.

use unopose_core::frame::Mask;

use super::{
    camera::Camera,
    raster::{self, Window},
    scene::PosedMesh,
};

/// What BOP's `gt_info` and masks say about one instance.
#[derive(Clone, Debug)]
pub struct InstanceView {
    /// Silhouette inside the image, hidden parts included.
    pub mask: Mask,
    /// The visible part of the silhouette.
    pub mask_visib: Mask,
    /// Silhouette pixels, also outside the image.
    pub px_count_all: u32,
    /// Visible pixels.
    pub px_count_visib: u32,
    /// Column, row, width, height of the whole silhouette (may leave the image), as in the BOP toolkit: width =
    /// last - first column; all -1 when nothing is seen.
    pub bbox_obj: [i32; 4],
    /// The same of the visible part.
    pub bbox_visib: [i32; 4],
    /// `px_count_visib / px_count_all`, 0 for an empty silhouette.
    pub visib_fract: f64,
}

/// One entry per object; `ids` is the view's id buffer.
pub fn instance_views(objects: &[PosedMesh], camera: &Camera, ids: &[u16]) -> Vec<InstanceView> {
    objects.iter().enumerate().map(|(i, placed)| instance_view(placed, camera, ids, i as u16 + 1)).collect()
}

fn instance_view(placed: &PosedMesh, camera: &Camera, ids: &[u16], id: u16) -> InstanceView {
    let (width, height) = (camera.width as i32, camera.height as i32);
    let t_camera_object = camera.t_camera_world * placed.t_world_object;
    let projected = raster::project(&placed.mesh.vertices, &t_camera_object, &camera.intrinsics);
    // The silhouette is counted on a canvas of three image sizes, as the BOP toolkit does.
    let visible = projected.iter().filter(|p| p.inv_z > 0.0);
    let mut window = Window { min: [2 * width, 2 * height], max: [-width, -height] };
    for p in visible {
        for (axis, (value, size)) in [(p.u, width), (p.v, height)].into_iter().enumerate() {
            window.min[axis] = window.min[axis].min((value.floor() as i32).max(-size));
            window.max[axis] = window.max[axis].max((value.ceil() as i32).saturating_add(1).min(2 * size));
        }
    }
    let span = |axis: usize| (window.max[axis] - window.min[axis]).max(0) as usize;
    let (cols, rows) = (span(0), span(1));
    let mut canvas = vec![false; cols * rows];
    if !canvas.is_empty() {
        for face in &placed.mesh.faces {
            raster::triangle(face.map(|i| projected[i as usize]), &window, |f| {
                canvas[(f.row - window.min[1]) as usize * cols + (f.col - window.min[0]) as usize] = true;
            });
        }
    }
    let mut mask = Mask::empty(camera.width, camera.height);
    let mut all = PixelBounds::default();
    for (i, _) in canvas.iter().enumerate().filter(|(_, set)| **set) {
        let (col, row) = (window.min[0] + (i % cols) as i32, window.min[1] + (i / cols) as i32);
        all.add(col, row);
        if (0..width).contains(&col) && (0..height).contains(&row) {
            mask.data[(row * width + col) as usize] = true;
        }
    }
    let mut mask_visib = Mask::empty(camera.width, camera.height);
    let mut visib = PixelBounds::default();
    for (i, _) in ids.iter().enumerate().filter(|(_, seen)| **seen == id) {
        visib.add(i as i32 % width, i as i32 / width);
        mask_visib.data[i] = true;
    }
    let visib_fract = if all.count == 0 { 0.0 } else { f64::from(visib.count) / f64::from(all.count) };
    InstanceView {
        mask,
        mask_visib,
        px_count_all: all.count,
        px_count_visib: visib.count,
        bbox_obj: all.xywh(),
        bbox_visib: visib.xywh(),
        visib_fract,
    }
}

#[derive(Default)]
struct PixelBounds {
    count: u32,
    min: [i32; 2],
    max: [i32; 2],
}

impl PixelBounds {
    fn add(&mut self, col: i32, row: i32) {
        if self.count == 0 {
            (self.min, self.max) = ([col, row], [col, row]);
        }
        self.min = [self.min[0].min(col), self.min[1].min(row)];
        self.max = [self.max[0].max(col), self.max[1].max(row)];
        self.count += 1;
    }

    fn xywh(&self) -> [i32; 4] {
        if self.count == 0 {
            return [-1; 4];
        }
        [self.min[0], self.min[1], self.max[0] - self.min[0], self.max[1] - self.min[1]]
    }
}
