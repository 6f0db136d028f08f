//! Target lists of a test set: what is to be found, and which view of the object is the reference.
//!
//! Protocols of the paper: a random reference from another scene at most 50 degrees away (main experiments), up to 90
//! degrees in nine bins (section on the rotation distance), one reference for all targets of an object ("one reference
//! for a category") and a few references per object (supplement), each list with angle and overlap ratio.

use std::collections::{BTreeMap, HashMap};

use rayon::prelude::*;

use super::{
    SynthError,
    object::SynthObject,
    overlap::SeenSurface,
    random::{Domain, Draw, stream},
};
use crate::{
    config::SynthConfig,
    formats::{
        BopDataset, ModelInfo, ReferenceTarget, Target,
        bop::BopSplit,
        detections::{Detection, write_detections},
        rle::Rle,
        targets::write_targets,
    },
    geometry::Pose,
};

/// Targets: at least this visible share, and this many pixels in an image 640 pixels wide.
const TARGET: (f64, f64) = (0.1, 150.0);
/// The same for references.
const REFERENCE: (f64, f64) = (0.7, 900.0);
/// Largest angle between target and reference view of the main protocol, degrees.
const MAIN_DEG: f64 = 50.0;
/// Width and number of the bins.
const BIN_DEG: f64 = 10.0;
const BINS: usize = 9;
/// References per object.
const REFERENCE_COUNTS: [usize; 5] = [8, 12, 16, 32, 42];

/// An instance of the finished set.
struct Seen {
    scene_id: u32,
    im_id: u32,
    instance: usize,
    obj_id: u32,
    t_camera_object: Pose,
    visib_fract: f64,
    px_count_visib: f64,
    bbox_visib: [i32; 4],
    /// The silhouette does not touch the border.
    whole: bool,
}

/// A target and one possible reference, as indices into the instances.
type Pair = (usize, usize);

/// Writes target list, reference lists and exact detections of all targets.
pub(super) fn write_lists(
    config: &SynthConfig,
    out: &std::path::Path,
    objects: &[SynthObject],
    infos: &BTreeMap<u32, ModelInfo>,
) -> Result<(), SynthError> {
    let split = BopDataset::open(out)?.split("test")?;
    let seen = seen_instances(config, &split)?;
    let scale = (f64::from(config.width) / 640.0).powi(2);
    let passes =
        |s: &Seen, limit: (f64, f64)| s.visib_fract >= limit.0 && s.px_count_visib >= limit.1 * scale;
    let mut of_object: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (i, s) in seen.iter().enumerate().filter(|(_, s)| s.whole && passes(s, REFERENCE)) {
        of_object.entry(s.obj_id).or_default().push(i);
    }
    let angle = |t: usize, r: usize| {
        let info = infos.get(&seen[t].obj_id);
        info.map_or(180.0, |m| {
            m.symmetries.rotation_distance_deg(&seen[t].t_camera_object, &seen[r].t_camera_object)
        })
    };
    let mut rng = stream(config.seed, Domain::Pool, u64::MAX);
    let mut lists: BTreeMap<String, Vec<Pair>> = BTreeMap::new();
    let mut targets = Vec::new();
    // The few references per object are drawn before the targets are looked at.
    let few: BTreeMap<u32, Vec<usize>> =
        of_object.iter().map(|(&id, views)| (id, shuffled(views, &mut rng))).collect();
    for (t, target) in seen.iter().enumerate().filter(|(_, s)| passes(s, TARGET)) {
        let Some(views) = of_object.get(&target.obj_id) else { continue };
        let elsewhere: Vec<(usize, f64)> = views
            .iter()
            .filter(|&&r| seen[r].scene_id != target.scene_id)
            .map(|&r| (r, angle(t, r)))
            .collect();
        let within = |low: f64, high: f64| -> Vec<usize> {
            elsewhere.iter().filter(|(_, d)| *d >= low && *d < high).map(|(r, _)| *r).collect()
        };
        let main = within(0.0, MAIN_DEG);
        if main.is_empty() {
            continue;
        }
        targets.push(t);
        let mut add = |name: String, r: usize| lists.entry(name).or_default().push((t, r));
        add("crossscene_rot50".into(), *rng.pick(&main));
        let bins: Vec<(usize, Vec<usize>)> = (0..BINS)
            .map(|b| (b, within(b as f64 * BIN_DEG, (b + 1) as f64 * BIN_DEG)))
            .filter(|(_, views)| !views.is_empty())
            .collect();
        for (b, views) in &bins {
            add(format!("crossscene_rot{:02}-{:02}", b * 10, (b + 1) * 10), *rng.pick(views));
        }
        let bin = rng.pick(&bins);
        add("crossscene_rot90".into(), *rng.pick(&bin.1));
        let any: Vec<usize> = views
            .iter()
            .copied()
            .filter(|&r| (seen[r].scene_id, seen[r].im_id) != (target.scene_id, target.im_id))
            .filter(|&r| angle(t, r) < MAIN_DEG)
            .collect();
        add("rot50".into(), *rng.pick(&any));
        let drawn = &few[&target.obj_id];
        let own = |r: &&usize| (seen[**r].scene_id, seen[**r].im_id) == (target.scene_id, target.im_id);
        if let Some(&r) = drawn.first().filter(|r| !own(r)) {
            add("one_per_object".into(), r);
        }
        for count in REFERENCE_COUNTS {
            let some: Vec<usize> = drawn.iter().take(count).filter(|r| !own(r)).copied().collect();
            let near: Vec<usize> = some.iter().copied().filter(|&r| angle(t, r) < MAIN_DEG).collect();
            let nearest = some.iter().copied().min_by(|&a, &b| angle(t, a).total_cmp(&angle(t, b)));
            if let Some(r) = if near.is_empty() { nearest } else { Some(*rng.pick(&near)) } {
                add(format!("{count}_per_object"), r);
            }
        }
    }
    write_targets(&out.join("test_targets_bop19.json"), &target_list(&seen, &targets))?;
    let surfaces = surfaces(&split, &seen, objects, &lists)?;
    for (name, pairs) in &lists {
        let entries: Vec<ReferenceTarget> = pairs
            .iter()
            .map(|&(t, r)| {
                let diameter = infos.get(&seen[t].obj_id).map_or(0.0, |m| m.diameter) as f32;
                let overlap = surfaces.get(&t).zip(surfaces.get(&r)).map(|(a, b)| a.share_in(b, diameter));
                reference_target(&seen[t], &seen[r], angle(t, r), overlap)
            })
            .collect();
        write_targets(&out.join(format!("test_ref_targets_{name}.json")), &entries)?;
    }
    Ok(write_detections(&out.join("dets_gt.json"), &detections(&split, &seen, &targets)?)?)
}

fn shuffled(views: &[usize], rng: &mut rand_chacha::ChaCha8Rng) -> Vec<usize> {
    rand::seq::index::sample(rng, views.len(), views.len()).iter().map(|i| views[i]).collect()
}

fn target_list(seen: &[Seen], targets: &[usize]) -> Vec<Target> {
    let mut list: Vec<Target> = targets
        .iter()
        .map(|&t| &seen[t])
        .map(|s| Target { scene_id: s.scene_id, im_id: s.im_id, obj_id: s.obj_id, inst_count: 1 })
        .collect();
    list.sort_unstable();
    list
}

fn reference_target(target: &Seen, reference: &Seen, degrees: f64, overlap: Option<f64>) -> ReferenceTarget {
    ReferenceTarget {
        scene_id: target.scene_id,
        im_id: target.im_id,
        obj_id: target.obj_id,
        ref_scene_id: reference.scene_id,
        ref_im_id: reference.im_id,
        rot_deg: Some(degrees),
        overlap,
    }
}

/// Visible surfaces of all instances that the lists name.
fn surfaces(
    split: &BopSplit,
    seen: &[Seen],
    objects: &[SynthObject],
    lists: &BTreeMap<String, Vec<Pair>>,
) -> Result<HashMap<usize, SeenSurface>, SynthError> {
    let mut wanted: Vec<usize> = lists.values().flatten().flat_map(|&(t, r)| [t, r]).collect();
    wanted.sort_unstable();
    wanted.dedup();
    let meshes: HashMap<u32, &SynthObject> = objects.iter().map(|o| (o.obj_id, o)).collect();
    let made = wanted.into_par_iter().filter_map(|i| {
        let s = &seen[i];
        let object = meshes.get(&s.obj_id)?;
        let surface = || -> Result<SeenSurface, SynthError> {
            let scene = split.scene(s.scene_id)?;
            let visible = scene.mask_visib(s.im_id, s.instance)?;
            let camera = scene.camera(s.im_id)?.intrinsics;
            Ok(SeenSurface::new(&object.mesh, &s.t_camera_object, &camera, &visible))
        };
        Some(surface().map(|surface| (i, surface)))
    });
    made.collect()
}

fn detections(split: &BopSplit, seen: &[Seen], targets: &[usize]) -> Result<Vec<Detection>, SynthError> {
    let detection = |&t: &usize| -> Result<Detection, SynthError> {
        let s = &seen[t];
        let mask = split.scene(s.scene_id)?.mask_visib(s.im_id, s.instance)?;
        Ok(Detection {
            scene_id: s.scene_id,
            image_id: s.im_id,
            category_id: s.obj_id,
            bbox: s.bbox_visib.map(f64::from),
            score: 1.0,
            time: 0.0,
            segmentation: Rle::encode_compressed(&mask),
        })
    };
    targets.iter().map(detection).collect()
}

fn seen_instances(config: &SynthConfig, split: &BopSplit) -> Result<Vec<Seen>, SynthError> {
    let (width, height) = (config.width as i32, config.height as i32);
    let mut seen = Vec::new();
    for &scene_id in split.scene_ids() {
        let scene = split.scene(scene_id)?;
        for im_id in scene.image_ids() {
            for (instance, (gt, info)) in scene.gt(im_id)?.iter().zip(scene.gt_info(im_id)?).enumerate() {
                let [x, y, w, h] = info.bbox_obj;
                seen.push(Seen {
                    scene_id,
                    im_id,
                    instance,
                    obj_id: gt.obj_id,
                    t_camera_object: gt.pose(&format!("scene {scene_id}, image {im_id}"))?,
                    visib_fract: info.visib_fract,
                    px_count_visib: info.px_count_visib.into(),
                    bbox_visib: info.bbox_visib,
                    whole: x > 0 && y > 0 && x + w < width - 1 && y + h < height - 1,
                });
            }
        }
    }
    Ok(seen)
}
