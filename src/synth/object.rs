//! The objects of a set: procedural ones and meshes from a folder.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
use parry3d::transformation::try_convex_hull;
use rand_chacha::ChaCha8Rng;

use super::{
    SynthError,
    random::{Domain, Draw, stream},
    shapes::{self, Family, Symmetry},
    texture::{self, Look},
};
use crate::{
    config::SynthConfig,
    formats::{ModelInfo, ObjectSymmetries, SymmetryAxis},
    geometry::Pose,
    mesh::{self, TriangleMesh},
    render::Finish,
};

/// An object ready to be dropped and rendered.
#[derive(Clone, Debug)]
pub struct SynthObject {
    /// 1-based.
    pub obj_id: u32,
    pub name: String,
    pub mesh: Arc<TriangleMesh>,
    pub finish: Finish,
    /// Symmetries that colour and shape share.
    pub symmetries: ObjectSymmetries,
    /// Collision hull.
    pub hull: Vec<Point3<f32>>,
}

/// Directions in which the collision hull touches the mesh at least.
const HULL_DIRECTIONS: usize = 100;
/// Vertices that stick out of the hull by more than this become part of it, metres.
const HULL_TOLERANCE: f32 = 3e-4;

impl SynthObject {
    fn new(
        obj_id: u32,
        name: String,
        mesh: TriangleMesh,
        finish: Finish,
        symmetries: ObjectSymmetries,
    ) -> Self {
        let hull = collision_hull(&mesh);
        Self { obj_id, name, mesh: Arc::new(mesh), finish, symmetries, hull }
    }

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
pub struct ObjectLibrary {
    config: SynthConfig,
    files: Vec<PathBuf>,
}

impl ObjectLibrary {
    pub fn new(config: &SynthConfig) -> Result<Self, SynthError> {
        let mut files = Vec::new();
        if !config.mesh_folder.as_os_str().is_empty() {
            collect_meshes(&config.mesh_folder, &mut files)?;
            if files.is_empty() {
                return Err(SynthError::NoMeshes { folder: config.mesh_folder.clone() });
            }
            files.sort();
        }
        Ok(Self { config: config.clone(), files })
    }

    /// Object `obj_id` (1-based). A mesh file that cannot be used is reported and replaced by a procedural object.
    pub fn build(&self, obj_id: u32) -> SynthObject {
        let mut shape_rng = stream(self.config.seed, Domain::Shape, obj_id.into());
        let [low, high] = self.config.diameter;
        let diameter = shape_rng.log_between(low, high);
        if !self.files.is_empty() && shape_rng.chance(self.config.mesh_share) {
            // Every file is used before one comes again.
            let file = &self.files[obj_id as usize % self.files.len()];
            match self.load_file(obj_id, file, diameter) {
                Ok(object) => return object,
                Err(error) => tracing::warn!("object {obj_id}: {error}; a procedural object takes its place"),
            }
        }
        self.procedural(obj_id, diameter, &mut shape_rng)
    }

    fn procedural(&self, obj_id: u32, diameter: f32, shape_rng: &mut ChaCha8Rng) -> SynthObject {
        // Families take turns, so that small sets have all of them.
        let family = Family::ALL[(obj_id as usize * 7 + self.config.seed as usize) % Family::ALL.len()];
        let solid = shapes::build(family, diameter, shape_rng);
        let mut look_rng = stream(self.config.seed, Domain::Look, obj_id.into());
        let size = solid.mesh.bounds().size();
        let look = Look::draw(size, self.config.textureless, solid.symmetry.continuous, &mut look_rng);
        let mesh = texture::textured(&solid, &look, self.config.texture_size);
        // A print or a coarse pattern tells the sides apart.
        let symmetries = object_symmetries(&look.keep(solid.symmetry, &solid.parts));
        SynthObject::new(obj_id, format!("{}_{obj_id:06}", family.name()), mesh, look.finish, symmetries)
    }

    fn load_file(&self, obj_id: u32, file: &Path, diameter: f32) -> Result<SynthObject, SynthError> {
        let mut mesh = mesh::load(file, self.config.mesh_scale)?;
        mesh.center_on_bounds();
        let own = mesh.diameter();
        if !(0.02..=0.6).contains(&own) {
            mesh.scale(diameter / own);
        }
        if mesh.texture.is_none() && mesh.colors.is_empty() {
            mesh.colors = vec![[176; 3]; mesh.vertices.len()];
        }
        let stem = file.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let finish = Finish { roughness: 0.6, metallic: 0.0 };
        Ok(SynthObject::new(obj_id, format!("{stem}_{obj_id:06}"), mesh, finish, ObjectSymmetries::default()))
    }
}

fn collect_meshes(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), SynthError> {
    let error = |source| SynthError::Io { path: folder.to_owned(), source };
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        if path.is_dir() {
            collect_meshes(&path, found)?;
            continue;
        }
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        if ["ply", "obj", "stl", "glb", "gltf"].contains(&extension.as_str()) {
            found.push(path);
        }
    }
    Ok(())
}

/// Convex hull that lies at most about [`HULL_TOLERANCE`] inside the mesh's own: vertices farthest out in evenly spread
/// directions, then along the normals of the faces found so far.
fn collision_hull(mesh: &TriangleMesh) -> Vec<Point3<f32>> {
    let reach = |v: &[f32; 3], d: &Vector3<f32>| Vector3::from(*v).dot(d);
    let farthest = |d: &Vector3<f32>| {
        let by_reach = |a: &&[f32; 3], b: &&[f32; 3]| reach(a, d).total_cmp(&reach(b, d));
        mesh.vertices.iter().max_by(by_reach).copied()
    };
    let mut points: Vec<[f32; 3]> = (0..HULL_DIRECTIONS)
        .filter_map(|i| {
            // Fibonacci sphere.
            let z = 1.0 - (2.0 * i as f32 + 1.0) / HULL_DIRECTIONS as f32;
            let (s, c) = (i as f32 * 2.399_963_2).sin_cos();
            let r = (1.0 - z * z).sqrt();
            farthest(&Vector3::new(r * c, r * s, z))
        })
        .collect();
    for _ in 0..3 {
        points.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
        points.dedup();
        let cloud: Vec<Point3<f32>> = points.iter().map(|p| Point3::from(*p)).collect();
        let Ok((corners, faces)) = try_convex_hull(&cloud) else { return cloud };
        let before = points.len();
        for face in faces {
            let [a, b, c] = face.map(|i| corners[i as usize]);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
            points.extend(
                farthest(&normal).filter(|v| reach(v, &normal) > a.coords.dot(&normal) + HULL_TOLERANCE),
            );
        }
        if points.len() == before {
            return corners;
        }
    }
    let cloud: Vec<Point3<f32>> = points.into_iter().map(Point3::from).collect();
    try_convex_hull(&cloud).map_or(cloud, |(corners, _)| corners)
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
