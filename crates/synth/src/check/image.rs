//! One image: do its masks, poses, depth and numbers agree?

use unopose_core::{
    frame::{DepthMap, Mask, RgbdFrame},
    geometry::Pose,
};
use unopose_dataset::{
    formats::{
        bop::{GtInfoRecord, GtRecord},
        units,
    },
    mesh::TriangleMesh,
    render::depth::{DepthWindow, render_depth},
};

use super::{models::Models, report::Finding, statistics::Statistics};

/// Focal lengths of cameras, image widths.
const FOCAL: std::ops::RangeInclusive<f64> = 0.2..=20.0;
/// Silhouettes and depth of fewer pixels are not compared.
const FEWEST_PIXELS: usize = 100;
/// Largest share of a silhouette farther than a pixel from the model's.
const SILHOUETTE_MISFIT: f64 = 0.02;
/// Median distance of the measured depth from the model's: constant and part that grows with z², metres. Twice what
/// depth cameras err at most (Nguyen et al. 2012) and a few millimetres for annotation by hand.
const DEPTH_MISFIT: [f64; 2] = [0.008, 0.01];
/// Depth samples of an instance that enter the statistics.
const SAMPLES: usize = 400;

/// An image with everything the set says about it.
pub(super) struct ImageUnderCheck<'a> {
    pub place: String,
    pub frame: &'a RgbdFrame,
    pub gt: &'a [GtRecord],
    pub info: &'a [GtInfoRecord],
    /// Whole silhouettes; empty where the set has none.
    pub masks: Vec<Mask>,
    pub visible: Vec<Mask>,
    /// Instances that training skips; only their poses are looked at.
    pub skipped: Vec<usize>,
}

impl ImageUnderCheck<'_> {
    /// What is wrong with the image; its distributions go to `statistics`.
    pub fn check(&self, models: &Models, statistics: &mut Statistics) -> Vec<Finding> {
        let mut findings = self.camera();
        self.appearance(statistics);
        findings.extend(self.overlaps());
        for i in 0..self.gt.len() {
            let wrong = self.instance(i, models, statistics);
            let place = format!("{}, instance {i} (object {})", self.place, self.gt[i].obj_id);
            findings.extend(wrong.into_iter().map(|what| Finding::new(&place, what)));
        }
        findings
    }

    fn camera(&self) -> Vec<Finding> {
        let (k, frame) = (&self.frame.intrinsics, self.frame);
        let (width, height) = (f64::from(frame.width()), f64::from(frame.height()));
        let mut findings = Vec::new();
        let mut add = |what: String| findings.push(Finding::new(&self.place, what));
        if !FOCAL.contains(&(k.fx / width)) || (k.fx / k.fy - 1.0).abs() > 0.2 {
            add(format!("focal lengths are {:.1} and {:.1} pixels in an image {width} wide", k.fx, k.fy));
        }
        if !(0.0..width).contains(&k.cx) || !(0.0..height).contains(&k.cy) {
            add(format!("principal point is ({:.1}, {:.1}), outside the image", k.cx, k.cy));
        }
        if frame.depth.data.iter().all(|&z| z <= 0.0) {
            add("no pixel has a depth".into());
        }
        findings
    }

    fn appearance(&self, statistics: &mut Statistics) {
        let pixels = self.frame.rgb.pixels().len().max(1) as f64;
        let (mut sum, mut squares, mut color) = (0.0, 0.0, 0.0);
        for p in self.frame.rgb.pixels() {
            let [r, g, b] = p.0.map(|c| f64::from(c) / 255.0);
            let y = 0.299 * r + 0.587 * g + 0.114 * b;
            (sum, squares) = (sum + y, squares + y * y);
            color += r.max(g).max(b) - r.min(g).min(b);
        }
        let mean = sum / pixels;
        statistics.brightness.add(mean);
        statistics.contrast.add((squares / pixels - mean * mean).max(0.0).sqrt());
        statistics.colorfulness.add(color / pixels);
        let holes = self.frame.depth.data.iter().filter(|z| **z <= 0.0).count();
        statistics.image_holes.add(holes as f64 / pixels);
        statistics.instances.add(self.gt.len() as f64);
    }

    fn overlaps(&self) -> Option<Finding> {
        let mut owner: Vec<Option<usize>> = vec![None; self.frame.depth.data.len()];
        for (i, mask) in self.visible.iter().enumerate() {
            for (slot, _) in owner.iter_mut().zip(&mask.data).filter(|(_, set)| **set) {
                if let Some(other) = slot.replace(i) {
                    return Some(Finding::new(
                        &self.place,
                        format!("visible masks of instances {other} and {i} overlap"),
                    ));
                }
            }
        }
        None
    }

    fn instance(&self, i: usize, models: &Models, statistics: &mut Statistics) -> Vec<String> {
        let (info, visible) = (&self.info[i], &self.visible[i]);
        let pose = match self.gt[i].pose("pose") {
            Ok(pose) => pose,
            Err(error) => return vec![error.to_string()],
        };
        let is_skipped = self.skipped.contains(&i);
        let mut wrong = match is_skipped {
            true => Vec::new(),
            false => counts(info, self.masks.get(i), visible, &self.frame.depth),
        };
        if let Some(problem) = units::distance_problem(pose.translation.norm()) {
            wrong.push(problem);
            return wrong;
        }
        if is_skipped {
            return wrong;
        }
        statistics.distance.add(pose.translation.z);
        statistics.visib_fract.add(info.visib_fract);
        let seen = visible.count();
        if seen > 0 {
            statistics.area.add(seen as f64 / visible.data.len() as f64);
        }
        if seen >= FEWEST_PIXELS {
            let holes =
                visible.data.iter().zip(&self.frame.depth.data).filter(|(m, z)| **m && **z <= 0.0).count();
            statistics.holes.add(holes as f64 / seen as f64);
        }
        match models.mesh(self.gt[i].obj_id) {
            Some(mesh) => wrong.extend(self.redraw(i, &pose, &mesh, statistics)),
            None => {
                let diameter = models.infos.get(&self.gt[i].obj_id).map_or(1.0, |m| m.diameter);
                wrong.extend(self.depth_near(visible, &pose, diameter));
            }
        }
        wrong
    }

    /// Without a model: the measured points of an object lie around its origin.
    fn depth_near(&self, visible: &Mask, pose: &Pose, diameter: f64) -> Option<String> {
        let median = self.frame.median_depth(visible, FEWEST_PIXELS)?;
        let z = pose.translation.z;
        ((median - z).abs() > diameter + depth_misfit(z)).then(|| {
            format!("median depth in the mask is {median:.3} m, but the pose puts the object at {z:.3} m")
        })
    }

    /// With a model: its drawing agrees with silhouette and depth.
    fn redraw(&self, i: usize, pose: &Pose, mesh: &TriangleMesh, statistics: &mut Statistics) -> Vec<String> {
        let mut wrong = Vec::new();
        let (width, height) = (self.frame.width(), self.frame.height());
        let drawn = render_depth(mesh, pose, &self.frame.intrinsics, width, height);
        let silhouette = Mask {
            width,
            height,
            data: drawn.to_depth_map(width, height).data.iter().map(|z| *z > 0.0).collect(),
        };
        if let Some(mask) = self.masks.get(i).filter(|m| m.count().max(silhouette.count()) >= FEWEST_PIXELS) {
            let iou = mask.iou(&silhouette);
            statistics.silhouette_iou.add(iou);
            let misfit = misfit(mask, &silhouette);
            if misfit > SILHOUETTE_MISFIT {
                wrong.push(format!(
                    "mask and posed model differ: {:.1} % of the pixels lie more than a pixel off (IoU {iou:.3})",
                    misfit * 100.0
                ));
            }
        }
        let mut errors = self.depth_errors(&self.visible[i], &drawn);
        if errors.len() >= FEWEST_PIXELS {
            for (error, z) in errors.iter().step_by(errors.len().div_ceil(SAMPLES)) {
                statistics.depth_error.add(*error);
                statistics.depth_error_per_z2.add(error / (z * z));
            }
            let middle = errors.len() / 2;
            let (error, z) = *errors.select_nth_unstable_by(middle, |a, b| a.0.total_cmp(&b.0)).1;
            if error > depth_misfit(z) {
                wrong.push(format!(
                    "depth and posed model differ by {:.1} mm (median over {} pixels)",
                    error * 1000.0,
                    errors.len()
                ));
            }
        }
        wrong
    }

    /// |measured - drawn| and drawn depth at visible pixels.
    fn depth_errors(&self, visible: &Mask, drawn: &DepthWindow) -> Vec<(f64, f64)> {
        measured(visible, &self.frame.depth)
            .filter_map(|(at, z)| {
                let model = drawn.get(at as u32 % visible.width, at as u32 / visible.width);
                (model > 0.0).then(|| (f64::from((z - model).abs()), f64::from(model)))
            })
            .collect()
    }
}

/// Largest [`DEPTH_MISFIT`] of an object at depth `z`, which is the pose's: a measured depth in the wrong unit would allow
/// its own error.
fn depth_misfit(z: f64) -> f64 {
    DEPTH_MISFIT[0] + DEPTH_MISFIT[1] * z * z
}

/// Pixel numbers and depths of a mask's measured pixels.
fn measured<'a>(mask: &'a Mask, depth: &'a DepthMap) -> impl Iterator<Item = (usize, f32)> + 'a {
    let pixels = mask.data.iter().zip(&depth.data).enumerate();
    pixels.filter_map(|(at, (&set, &z))| (set && z > 0.0).then_some((at, z)))
}

/// The numbers of `gt_info` against the masks.
fn counts(info: &GtInfoRecord, mask: Option<&Mask>, visible: &Mask, depth: &DepthMap) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut equal = |field: &str, said: u32, found: usize| {
        if said as usize != found {
            wrong.push(format!("{field} is {said}, but there are {found} such pixels"));
        }
    };
    equal("px_count_visib", info.px_count_visib, visible.count());
    if let Some(mask) = mask {
        let with_depth = mask.data.iter().zip(&depth.data).filter(|(m, z)| **m && **z > 0.0).count();
        equal("px_count_valid", info.px_count_valid, with_depth);
        if mask.count() > info.px_count_all as usize {
            wrong.push(format!("px_count_all is {}, but the mask has {}", info.px_count_all, mask.count()));
        }
        if visible.data.iter().zip(&mask.data).any(|(v, m)| *v && !*m) {
            wrong.push("visible pixels lie outside the mask".into());
        }
    }
    let fract = f64::from(info.px_count_visib) / f64::from(info.px_count_all.max(1));
    if (info.visib_fract - fract).abs() > 1e-3 {
        let (visib, all) = (info.px_count_visib, info.px_count_all);
        wrong.push(format!("visib_fract is {}, but {visib} of {all} pixels are visible", info.visib_fract));
    }
    if let Some(b) = visible.bounding_box() {
        let found =
            [b.col_min, b.row_min, b.col_max - b.col_min - 1, b.row_max - b.row_min - 1].map(|x| x as i32);
        // Some writers count pixels instead of distances.
        let near = (0..4).all(|k| (info.bbox_visib[k] - found[k]).abs() <= 1);
        if !near && info.bbox_visib != [0; 4] {
            wrong.push(format!("bbox_visib is {:?}, but the visible mask has {found:?}", info.bbox_visib));
        }
    }
    wrong
}

/// Share of the union of two masks that is more than a pixel away from the other one.
fn misfit(a: &Mask, b: &Mask) -> f64 {
    let off = |from: &Mask, to: &Mask| {
        let near = |col: u32, row: u32| {
            let rows = row.saturating_sub(1)..(row + 2).min(to.height);
            rows.into_iter().any(|r| (col.saturating_sub(1)..(col + 2).min(to.width)).any(|c| to.get(c, r)))
        };
        from.pixels().filter(|&(col, row)| !to.get(col, row) && !near(col, row)).count()
    };
    let union = a.data.iter().zip(&b.data).filter(|(x, y)| **x || **y).count();
    (off(a, b) + off(b, a)) as f64 / union.max(1) as f64
}
