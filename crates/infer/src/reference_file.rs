//! References in files: what queries need of a reference view, so that it is prepared and encoded once for good.
//!
//! A safetensors file holds the sampled cloud, its colour features and positional encoding, and all measured points (for
//! refinement and drawing). The structure embedding is made anew from the stored distances and angles, which take a
//! small part of its size, and so are the stages' first layers. The metadata name the network; a file is refused by any
//! other.

use std::{collections::BTreeMap, ops::RangeInclusive, path::Path, sync::OnceLock};

use burn::tensor::{Tensor, TensorData};
use unopose_core::geometry::{Intrinsics, StructureIndices};
use unopose_nn::{
    checkpoint::TensorFile,
    model::{EncodedCloud, SparseRows, StructureTensors},
};
use unopose_pairs::{appearance::AppearanceView, data::CloudInput};

use super::{InferError, PoseEstimator, Reference};

/// What the metadata entry `kind` says.
const KIND: &str = "unopose reference 2";
/// Bound of coordinates and distances in radii of the object or in sigma_d. A cloud that is not centred lies up to some
/// hundred radii from the camera.
const IN_RADII: f32 = 1e4;
/// Bound of coordinates in metres, beyond any depth camera's range.
const IN_METRES: f32 = 1e3;

impl PoseEstimator {
    /// Writes a reference of this estimator to `path`, atomically.
    pub fn save_reference(&self, reference: &Reference, path: &Path) -> Result<(), InferError> {
        let cloud = &reference.cloud;
        let (n, m) = (cloud.points.len(), cloud.sparse.len());
        let side = self.config().image_size;
        let StructureIndices { size, k, distances, angles } = &cloud.structure;
        let host = |values: Vec<f32>, shape: &[usize]| TensorData::new(values, shape.to_vec());
        let indices = |values: &[u32]| values.iter().map(|&i| i as f32).collect::<Vec<f32>>();
        let read = |tensor: Tensor<3>, what| {
            tensor.try_into_data().map(|data| data.convert::<f32>()).map_err(InferError::readback(what))
        };
        let mut tensors = BTreeMap::from([
            ("radius".to_owned(), host(vec![reference.radius], &[1])),
            ("center".to_owned(), host(cloud.center.to_vec(), &[3])),
            ("measured".to_owned(), host(reference.points.concat(), &[reference.points.len(), 3])),
            ("rgb".to_owned(), host(cloud.rgb.clone(), &[3, side, side])),
            ("choose".to_owned(), host(indices(&cloud.choose), &[n])),
            ("points".to_owned(), host(cloud.points.concat(), &[n, 3])),
            ("sparse".to_owned(), host(indices(&cloud.sparse), &[m])),
            ("distances".to_owned(), host(distances.clone(), &[*size, *size])),
            ("angles".to_owned(), host(angles.clone(), &[*size, *size, *k])),
            ("features".to_owned(), read(reference.encoded.dense.clone(), "colour features")?),
        ]);
        if let Some(view) = &cloud.view {
            let (width, cells) = (view.width(), view.depth().len());
            let Intrinsics { fx, fy, cx, cy } = *view.camera();
            let object = view.object().iter().map(|&object| f32::from(u8::from(object))).collect();
            tensors.extend([
                ("view.camera".to_owned(), host([fx, fy, cx, cy].map(|x| x as f32).to_vec(), &[4])),
                ("view.depth".to_owned(), host(view.depth().to_vec(), &[cells / width.max(1), width])),
                ("view.object".to_owned(), host(object, &[cells])),
                ("view.colors".to_owned(), host(view.colors().concat(), &[cells, 3])),
            ]);
        }
        if let Some(position) = &reference.encoded.position {
            tensors.insert("position".to_owned(), read(position.clone(), "positional encoding")?);
        }
        let metadata = BTreeMap::from([
            ("kind".to_owned(), KIND.to_owned()),
            ("network".to_owned(), self.network()?.to_owned()),
            ("source".to_owned(), self.source().to_owned()),
        ]);
        Ok(TensorFile { tensors, metadata }.write(path)?)
    }

    /// Reads a reference that [`Self::save_reference`] wrote for the same network.
    pub fn load_reference(&self, path: &Path) -> Result<Reference, InferError> {
        let mut file = Fields { file: TensorFile::read(path)?, path };
        file.check("kind", KIND)?;
        file.check("network", self.network()?)?;
        let config = self.config();
        let (n, m, side) = (config.fine_points, config.coarse_points, config.image_size);
        let (size, k) = (1 + m, config.geo_embedding.angle_k);
        let measured = file.file.tensors.get("measured").map_or(0, |data| data.shape()[0]);
        let choose = file.indices("choose", n, side * side)?;
        let sparse = file.indices("sparse", m, n)?;
        let largest_angle = 1.001 * 180.0 / config.geo_embedding.sigma_a;
        let cloud = CloudInput {
            rgb: file.take("rgb", &[3, side, side])?,
            choose,
            points: rows(&file.within("points", &[n, 3], -IN_RADII..=IN_RADII)?),
            sparse,
            structure: StructureIndices {
                size,
                k,
                distances: file.within("distances", &[size, size], 0.0..=IN_RADII)?,
                angles: file.within("angles", &[size, size, k], 0.0..=largest_angle)?,
            },
            center: rows(&file.within("center", &[3], -IN_METRES..=IN_METRES)?)[0],
            view: config.hypotheses.uses_appearance().then(|| file.view()).transpose()?,
        };
        let radius = file.within("radius", &[1], 1e-4..=IN_METRES)?[0];
        let points = rows(&file.within("measured", &[measured, 3], -IN_METRES..=IN_METRES)?);
        let features = file.take("features", &[1, n, config.color.out_dim()])?;
        let width = config.fine.matching.hidden_dim;
        let position = config.use_fine.then(|| file.take("position", &[1, n, width])).transpose()?;
        let position = position.map(|position| self.tensor(position, [1, n, width]));
        let structure = StructureTensors::new(&[&cloud], &self.device);
        let rows = SparseRows::new(&[&cloud], config, &self.device);
        let colors = self.tensor(features, [1, n, config.color.out_dim()]);
        let encoded = self.model.encode_structure(&structure, &rows, colors);
        let encoded = self.model.with_self_attention(EncodedCloud { position, ..encoded });
        Ok(Reference {
            cloud,
            radius,
            encoded,
            points,
            surface: OnceLock::new(),
            features: OnceLock::new(),
            seconds: 0.0,
        })
    }
}

/// A file whose tensors are taken out one by one.
struct Fields<'a> {
    file: TensorFile,
    path: &'a Path,
}

impl Fields<'_> {
    fn error(&self, field: &str, value: impl ToString, expected: impl ToString) -> InferError {
        InferError::ReferenceFile {
            path: self.path.to_owned(),
            field: field.to_owned(),
            value: value.to_string(),
            expected: expected.to_string(),
        }
    }

    fn check(&self, field: &str, expected: &str) -> Result<(), InferError> {
        match self.file.metadata.get(field).map(String::as_str) {
            Some(value) if value == expected => Ok(()),
            value => Err(self.error(field, value.unwrap_or("absent"), expected)),
        }
    }

    /// The values of a tensor of this shape.
    fn take(&mut self, field: &str, shape: &[usize]) -> Result<Vec<f32>, InferError> {
        let expected = format!("a tensor {shape:?}");
        let data = self.file.tensors.remove(field).ok_or_else(|| self.error(field, "absent", &expected))?;
        if data.shape()[..] != *shape {
            return Err(self.error(field, format!("{:?}", data.shape()), expected));
        }
        data.try_into_vec::<f32>().map_err(|e| self.error(field, format!("{e:?}"), expected))
    }

    /// [`Self::take`] with all values in `range`.
    fn within(
        &mut self,
        field: &str,
        shape: &[usize],
        range: RangeInclusive<f32>,
    ) -> Result<Vec<f32>, InferError> {
        let values = self.take(field, shape)?;
        match values.iter().find(|&&value| !range.contains(&value)) {
            Some(value) => {
                let expected = format!("values from {} to {}", range.start(), range.end());
                Err(self.error(field, value, expected))
            }
            None => Ok(values),
        }
    }

    /// The map of the view.
    fn view(&mut self) -> Result<AppearanceView, InferError> {
        let shape = self.file.tensors.get("view.depth").map(|data| data.shape().to_vec());
        let Some([height, width]) = shape.as_deref().and_then(|shape| <[usize; 2]>::try_from(shape).ok())
        else {
            return Err(self.error(
                "view.depth",
                "absent or of another rank",
                "a tensor of rows and columns",
            ));
        };
        let depth = self.within("view.depth", &[height, width], 0.0..=IN_METRES)?;
        let object = self.within("view.object", &[depth.len()], 0.0..=1.0)?;
        let colors = rows(&self.within("view.colors", &[depth.len(), 3], -1.0..=1.0)?);
        let camera = self.within("view.camera", &[4], -1e6..=1e6)?;
        if let Some(focal) = camera[..2].iter().find(|&&focal| focal < 1.0) {
            return Err(self.error("view.camera", focal, "focal lengths of at least 1 cell"));
        }
        let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|i| f64::from(camera[i]));
        let object = object.into_iter().map(|object| object == 1.0).collect();
        Ok(AppearanceView::from_maps(Intrinsics { fx, fy, cx, cy }, width, depth, object, colors))
    }

    /// Whole numbers below `limit`.
    fn indices(&mut self, field: &str, count: usize, limit: usize) -> Result<Vec<u32>, InferError> {
        let values = self.take(field, &[count])?;
        match values.iter().find(|&&v| v.fract() != 0.0 || !(0.0..limit as f32).contains(&v)) {
            Some(value) => Err(self.error(field, value, format!("whole numbers below {limit}"))),
            None => Ok(values.into_iter().map(|v| v as u32).collect()),
        }
    }
}

fn rows(values: &[f32]) -> Vec<[f32; 3]> {
    values.as_chunks::<3>().0.to_vec()
}
