//! The objects of a set: procedural ones and meshes from a folder.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use unopose_core::{config::SynthConfig, geometry::Pose};
use unopose_dataset::{
    formats::{ModelInfo, ObjectSymmetries, SymmetryAxis},
    mesh::TriangleMesh,
    render::Finish,
};

use super::{
    SynthError,
    collision::{collision_hull, convex_parts},
    mesh_folder::MeshFolder,
    photographs::Photographs,
    random::{Domain, Draw, stream},
    shapes::{self, Family, Symmetry},
    texture::{self, Look},
};

/// An object ready to be dropped and rendered.
#[derive(Clone, Debug)]
pub(super) struct SynthObject {
    /// 1-based.
    pub obj_id: u32,
    /// Family or mesh file, with the id: `mug_000007`.
    pub name: String,
    /// Metres, centred, with its texture.
    pub mesh: Arc<TriangleMesh>,
    /// How its surface reflects light.
    pub finish: Finish,
    /// Symmetries that colour and shape share.
    pub symmetries: ObjectSymmetries,
    /// What the shape alone leaves open.
    pub left_open: LeftOpen,
    /// Corners of its convex hull, metres.
    pub hull: Vec<Point3<f32>>,
    /// Convex parts to collide with; empty where the hull is good enough.
    pub parts: Vec<Vec<Point3<f32>>>,
}

/// Rotations that map a shape onto itself while its colours tell them apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum LeftOpen {
    /// No rotation.
    #[default]
    None,
    /// Some.
    Flip,
    /// All about an axis.
    Axis,
}

impl LeftOpen {
    fn of(shape: &Symmetry, with_colors: &Symmetry) -> Self {
        match (shape, with_colors) {
            (_, colors) if !colors.is_none() => Self::None,
            (shape, _) if shape.continuous => Self::Axis,
            (shape, _) if !shape.is_none() => Self::Flip,
            _ => Self::None,
        }
    }
}

impl SynthObject {
    fn new(
        obj_id: u32,
        name: String,
        mesh: TriangleMesh,
        finish: Finish,
        symmetries: ObjectSymmetries,
    ) -> Self {
        let hull = collision_hull(&mesh.vertices);
        let parts = convex_parts(&mesh, &hull);
        let left_open = LeftOpen::None;
        Self { obj_id, name, mesh: Arc::new(mesh), finish, symmetries, left_open, hull, parts }
    }

    /// Its entry in `models_info.json`.
    pub fn info(&self) -> ModelInfo {
        let bounds = self.mesh.bounds();
        ModelInfo {
            diameter: self.mesh.diameter().into(),
            min: Vector3::from(bounds.min).cast(),
            size: Vector3::from(bounds.size()).cast(),
            symmetries: self.symmetries.clone(),
        }
    }
}

/// Source of all objects of a set; an object depends only on the configuration and its id.
#[derive(Clone, Debug)]
pub(super) struct ObjectLibrary {
    config: SynthConfig,
    folder: MeshFolder,
    /// For prints.
    photographs: Photographs,
    tried: Arc<Mutex<Tried>>,
}

/// What became of the mesh files so far.
#[derive(Debug, Default)]
struct Tried {
    /// Whether any could be used.
    usable: bool,
    /// Files that could not be used, with the reason.
    broken: BTreeMap<PathBuf, String>,
    /// Ids of objects whose mesh file could not be used.
    replaced: BTreeSet<u32>,
}

impl ObjectLibrary {
    /// Opens `synth.mesh_folder` where one is configured.
    pub fn new(config: &SynthConfig) -> Result<Self, SynthError> {
        let (folder, photographs) = (MeshFolder::open(config)?, Photographs::open(&config.texture_folder)?);
        Ok(Self { config: config.clone(), folder, photographs, tried: Arc::default() })
    }

    /// Object `obj_id` (1-based). A mesh file that cannot be used is reported and replaced by a procedural object.
    pub fn build(&self, obj_id: u32) -> SynthObject {
        let mut shape_rng = stream(self.config.seed, Domain::Shape, obj_id.into());
        let [low, high] = self.config.diameter;
        let diameter = shape_rng.log_between(low, high);
        if !self.folder.is_empty() && shape_rng.chance(self.config.mesh_share) {
            // Every file is used before one comes again.
            let file = self.folder.file(obj_id as usize);
            match self.load_file(obj_id, file, diameter) {
                Ok(object) => {
                    self.tried().usable = true;
                    return object;
                }
                Err(error) => {
                    tracing::warn!("object {obj_id}: {error}; a procedural object takes its place");
                    let mut tried = self.tried();
                    tried.broken.insert(file.to_owned(), error.to_string());
                    tried.replaced.insert(obj_id);
                }
            }
        }
        self.procedural(obj_id, diameter, &mut shape_rng)
    }

    fn procedural(&self, obj_id: u32, diameter: f32, shape_rng: &mut ChaCha8Rng) -> SynthObject {
        // Families take turns, so that small sets have all of them.
        let turn = obj_id as usize * 7 + self.config.seed as usize;
        let mut print_rng = stream(self.config.seed, Domain::Print, obj_id.into());
        let printed = print_rng.chance(self.config.printed);
        let families: &[Family] = if printed { &Family::PACKAGES } else { &Family::ALL };
        let family = families[turn % families.len()];
        let solid = shapes::build(family, diameter, shape_rng);
        let (size, revolved) = (solid.mesh.bounds().size(), solid.symmetry.continuous);
        let look = if printed {
            Look::package(size, revolved, &self.photographs, &mut print_rng)
        } else {
            let mut look_rng = stream(self.config.seed, Domain::Look, obj_id.into());
            Look::draw(size, self.config.textureless, revolved, &mut look_rng)
        };
        let mesh = texture::textured(&solid, &look, self.config.texture_size);
        // A print or a coarse pattern tells the sides apart.
        let remaining = look.remaining_symmetry(solid.symmetry, &solid.parts);
        let symmetries = object_symmetries(&remaining);
        let name = format!("{}_{obj_id:06}", family.name());
        SynthObject {
            left_open: LeftOpen::of(&solid.symmetry, &remaining),
            ..SynthObject::new(obj_id, name, mesh, look.finish, symmetries)
        }
    }

    fn load_file(&self, obj_id: u32, file: &Path, diameter: f32) -> Result<SynthObject, SynthError> {
        let mesh = self.folder.load(file, &self.config, diameter)?;
        let finish = Finish { roughness: 0.6, metallic: 0.0 };
        let name = format!("{}_{obj_id:06}", self.folder.name(file));
        Ok(SynthObject::new(obj_id, name, mesh, finish, ObjectSymmetries::default()))
    }

    /// How many objects had to be made up because their mesh file could not be used.
    pub fn replaced(&self) -> usize {
        self.tried().replaced.len()
    }

    /// Refuses a folder in which no mesh can be used, once that is to be feared: the files that no object has yet are
    /// tried where all others were broken.
    pub fn check_meshes(&self) -> Result<(), SynthError> {
        let mut tried = self.tried();
        if tried.usable || tried.broken.is_empty() {
            return Ok(());
        }
        for file in self.folder.files() {
            if tried.broken.contains_key(file) {
                continue;
            }
            if let Err(error) = self.folder.load(file, &self.config, self.config.diameter[0]) {
                tried.broken.insert(file.clone(), error.to_string());
            } else {
                tried.usable = true;
                return Ok(());
            }
        }
        let reason = tried.broken.values().next().cloned().unwrap_or_default();
        let (folder, files) = (self.config.mesh_folder.clone(), self.folder.files().len());
        Err(SynthError::NoUsableMesh { folder, files, reason })
    }

    fn tried(&self) -> MutexGuard<'_, Tried> {
        self.tried.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn object_symmetries(symmetry: &Symmetry) -> ObjectSymmetries {
    let rotation = |m: Matrix3<f64>| Pose::new(m, Vector3::zeros());
    let about_z = |angle: f64| *Rotation3::from_axis_angle(&Vector3::z_axis(), angle).matrix();
    let folds = if symmetry.continuous { 1 } else { symmetry.folds.max(1) };
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let mut discrete = Vec::new();
    for fold in 0..folds {
        let turn = about_z(std::f64::consts::TAU * f64::from(fold) / f64::from(folds));
        if fold > 0 {
            discrete.push(rotation(turn));
        }
        if symmetry.flip {
            discrete.push(rotation(turn * flip));
        }
    }
    let axis = SymmetryAxis { axis: Vector3::z(), offset: Vector3::zeros() };
    ObjectSymmetries { discrete, continuous: if symmetry.continuous { vec![axis] } else { Vec::new() } }
}
