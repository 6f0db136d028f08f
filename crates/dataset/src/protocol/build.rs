//! From annotated instances to lists.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::Arc,
};

use rayon::prelude::*;

use super::{
    Protocol, ProtocolError, VisibleSurface,
    choice::{Candidate, drawn},
    instances::{AnnotatedInstance, annotated_instances, target_instances},
};
use crate::{
    formats::{BopSplit, FormatError, ModelInfo, ReferenceTarget, Target},
    mesh::TriangleMesh,
};

/// What lists are made of.
pub struct ListInput<'a> {
    /// Split of the targets.
    pub split: &'a BopSplit,
    /// Split of the reference views.
    pub reference_split: &'a BopSplit,
    /// Diameters and symmetries by object id; every target's object is there.
    pub infos: &'a BTreeMap<u32, ModelInfo>,
    /// Meshes by object id, metres. They serve the overlap ratio; without an object's mesh its entries have none.
    pub meshes: &'a HashMap<u32, Arc<TriangleMesh>>,
    /// `None`: all instances that are visible enough and have a reference in another scene at most 50 degrees away.
    pub targets: Option<&'a [Target]>,
}

/// A list of references.
#[derive(Clone, Debug)]
pub struct BuiltList {
    /// How the references were chosen.
    pub protocol: Protocol,
    /// Targets with their references, in the order of the targets.
    pub entries: Vec<ReferenceTarget>,
    /// Targets that have no such reference.
    pub without_reference: usize,
}

/// The lists with the targets they are about, one instance each.
#[derive(Clone, Debug)]
pub struct BuiltLists {
    /// Those given, in their order; or those found, by scene and image.
    pub targets: Vec<Target>,
    /// In the order of the protocols asked for.
    pub lists: Vec<BuiltList>,
}

/// A target and its reference, as numbers of instances.
type Pair = (usize, usize);

/// Makes the lists of several protocols. References come from images without targets where an object has such ones.
pub fn build_lists(
    input: &ListInput,
    protocols: &[Protocol],
    seed: u64,
) -> Result<BuiltLists, ProtocolError> {
    let mut references = annotated_instances(input.reference_split)?;
    references.retain(AnnotatedInstance::can_be_reference);
    let mut targets = match input.targets {
        Some(targets) => target_instances(input.split, targets)?,
        None => {
            let mut instances = annotated_instances(input.split)?;
            instances.retain(AnnotatedInstance::can_be_target);
            instances
        }
    };
    let views = views_of_objects(&references, &targets);
    let candidates = |target: &AnnotatedInstance| candidates(input, target, &references, &views);
    let mut offers: Vec<Vec<Candidate>> =
        targets.par_iter().map(candidates).collect::<Result<_, FormatError>>()?;
    if input.targets.is_none() {
        let main = |offer: &Vec<Candidate>| Protocol::CrossScene.choose(offer, &[], seed, 0).is_some();
        let mut keep = offers.iter().map(main).collect::<Vec<_>>().into_iter();
        targets.retain(|_| keep.next().unwrap_or(false));
        offers.retain(main);
    }
    let draws: BTreeMap<u32, Vec<usize>> =
        views.iter().map(|(&id, views)| (id, drawn(views, seed, id))).collect();
    let choose = |protocol: &Protocol| -> Vec<Pair> {
        let chosen = targets.iter().zip(&offers).enumerate().filter_map(|(t, (target, offer))| {
            let drawn = draws.get(&target.obj_id).map_or(&[][..], Vec::as_slice);
            Some((t, protocol.choose(offer, drawn, seed, t as u64)?))
        });
        chosen.collect()
    };
    let pairs: Vec<Vec<Pair>> = protocols.iter().map(choose).collect();
    let overlaps = overlaps(input, &targets, &references, &pairs)?;
    let degrees = |(t, r): Pair| offers[t].iter().find(|c| c.view == r).map(|c| c.degrees);
    let entry = |&pair: &Pair| -> ReferenceTarget {
        let (target, reference) = (&targets[pair.0], &references[pair.1]);
        ReferenceTarget {
            scene_id: target.scene_id,
            im_id: target.im_id,
            obj_id: target.obj_id,
            ref_scene_id: reference.scene_id,
            ref_im_id: reference.im_id,
            rot_deg: degrees(pair),
            overlap: overlaps.get(&pair).copied(),
        }
    };
    let list = |(&protocol, pairs): (&Protocol, &Vec<Pair>)| BuiltList {
        protocol,
        entries: pairs.iter().map(entry).collect(),
        without_reference: targets.len() - pairs.len(),
    };
    let lists = protocols.iter().zip(&pairs).map(list).collect();
    let target = |s: &AnnotatedInstance| Target {
        scene_id: s.scene_id,
        im_id: s.im_id,
        obj_id: s.obj_id,
        inst_count: 1,
    };
    Ok(BuiltLists { targets: targets.iter().map(target).collect(), lists })
}

/// Numbers of the usable references of every object.
fn views_of_objects(
    references: &[AnnotatedInstance],
    targets: &[AnnotatedInstance],
) -> BTreeMap<u32, Vec<usize>> {
    let of_targets: BTreeSet<_> = targets.iter().map(AnnotatedInstance::image).collect();
    let mut views: BTreeMap<u32, [Vec<usize>; 2]> = BTreeMap::new();
    for (r, reference) in references.iter().enumerate() {
        let outside = usize::from(!of_targets.contains(&reference.image()));
        views.entry(reference.obj_id).or_default()[outside].push(r);
    }
    let preferred = |[inside, outside]: [Vec<usize>; 2]| if outside.is_empty() { inside } else { outside };
    views.into_iter().map(|(id, views)| (id, preferred(views))).collect()
}

fn candidates(
    input: &ListInput,
    target: &AnnotatedInstance,
    references: &[AnnotatedInstance],
    views: &BTreeMap<u32, Vec<usize>>,
) -> Result<Vec<Candidate>, FormatError> {
    let Some(views) = views.get(&target.obj_id) else { return Ok(Vec::new()) };
    let info = input.infos.get(&target.obj_id).ok_or_else(|| {
        FormatError::missing("models_info.json", format!("object {}", target.obj_id), "a target")
    })?;
    let others = views.iter().filter(|&&r| !references[r].in_image_of(target));
    let candidate = |&view: &usize| {
        let reference = &references[view];
        let (a, b) = (&target.t_camera_object, &reference.t_camera_object);
        let degrees = info.symmetries.rotation_distance_deg(a, b);
        Candidate { view, degrees, other_scene: !reference.in_scene_of(target) }
    };
    Ok(others.map(candidate).collect())
}

/// Overlap ratio of every pair whose object has a mesh. The surfaces of one object are in memory at a time.
fn overlaps(
    input: &ListInput,
    targets: &[AnnotatedInstance],
    references: &[AnnotatedInstance],
    lists: &[Vec<Pair>],
) -> Result<HashMap<Pair, f64>, FormatError> {
    let mut by_object: BTreeMap<u32, BTreeSet<Pair>> = BTreeMap::new();
    for &pair in lists.iter().flatten() {
        by_object.entry(targets[pair.0].obj_id).or_default().insert(pair);
    }
    let mut overlaps = HashMap::new();
    for (obj_id, pairs) in by_object {
        let (Some(mesh), Some(info)) = (input.meshes.get(&obj_id), input.infos.get(&obj_id)) else {
            continue;
        };
        let surfaces = |split: &BopSplit, instances: &[AnnotatedInstance], wanted: BTreeSet<usize>| {
            let wanted: Vec<usize> = wanted.into_iter().collect();
            let made = wanted.into_par_iter().map(|i| Ok((i, surface(split, &instances[i], mesh)?)));
            made.collect::<Result<HashMap<usize, VisibleSurface>, FormatError>>()
        };
        let of_targets = surfaces(input.split, targets, pairs.iter().map(|p| p.0).collect())?;
        let of_references = surfaces(input.reference_split, references, pairs.iter().map(|p| p.1).collect())?;
        let diameter = info.diameter as f32;
        let share = |pair: Pair| {
            let (a, b) = (of_targets.get(&pair.0)?, of_references.get(&pair.1)?);
            Some((pair, a.overlap_with(b, diameter)))
        };
        overlaps.extend(pairs.into_iter().filter_map(share));
    }
    Ok(overlaps)
}

fn surface(
    split: &BopSplit,
    instance: &AnnotatedInstance,
    mesh: &TriangleMesh,
) -> Result<VisibleSurface, FormatError> {
    let scene = split.scene(instance.scene_id)?;
    let visible = scene.mask_visib(instance.im_id, instance.instance)?;
    let camera = scene.camera(instance.im_id)?.intrinsics;
    Ok(VisibleSurface::new(mesh, &instance.t_camera_object, &camera, &visible))
}
