//! Reflection: Lambert + GGX microfacets (Walter et al. 2007, Schlick's approximations), ambient from a two-tone sky.
//!
//! All of it is linear in the albedo, so that the samples of a pixel that lie on one surface share its lights and shadows
//! and differ in their colour only.

use nalgebra::Vector3;

use super::scene::Finish;

/// Reflectance of dielectrics seen straight on.
const DIELECTRIC: f32 = 0.04;

/// A surface point as the lights see it. Directions are unit vectors.
pub(super) struct ShadingPoint<'a> {
    pub normal: &'a Vector3<f32>,
    /// Towards the camera.
    pub view: &'a Vector3<f32>,
    pub finish: Finish,
}

/// Radiance towards the camera per channel: `slope * albedo + gloss`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reflection {
    slope: Vector3<f32>,
    gloss: Vector3<f32>,
}

impl Reflection {
    /// Radiance of a surface of this colour (linear light).
    pub fn of(&self, albedo: &[f32; 3]) -> [f32; 3] {
        std::array::from_fn(|k| self.slope[k] * albedo[k] + self.gloss[k])
    }

    /// Adds the reflection of a light.
    pub fn add(&mut self, light: &Vector3<f32>, (slope, gloss): (f32, f32)) {
        self.slope += light * slope;
        self.gloss += light * gloss;
    }
}

impl ShadingPoint<'_> {
    /// Part per albedo and part on its own of what is reflected under a Fresnel term.
    fn mirrored(&self, fresnel: f32) -> (f32, f32) {
        let m = self.finish.metallic;
        (m * (1.0 - fresnel), DIELECTRIC * (1.0 - m) * (1.0 - fresnel) + fresnel)
    }

    /// Radiance towards the camera for unit irradiance from direction `light`, per albedo and on its own; `None` from
    /// behind.
    pub fn reflect(&self, light: &Vector3<f32>) -> Option<(f32, f32)> {
        let n_l = self.normal.dot(light);
        if n_l <= 0.0 {
            return None;
        }
        let n_v = self.normal.dot(self.view).max(1e-3);
        let half = (light + self.view).normalize();
        let n_h = self.normal.dot(&half).max(0.0);
        let v_h = self.view.dot(&half).max(0.0);
        let alpha = (self.finish.roughness * self.finish.roughness).max(0.02);
        let a2 = alpha * alpha;
        let denominator = n_h * n_h * (a2 - 1.0) + 1.0;
        let distribution = a2 / (std::f32::consts::PI * denominator * denominator);
        let k = (self.finish.roughness + 1.0).powi(2) / 8.0;
        let geometry = 1.0 / ((n_l * (1.0 - k) + k) * (n_v * (1.0 - k) + k));
        let scale = 0.25 * distribution * geometry * n_l;
        let (slope, gloss) = self.mirrored((1.0 - v_h).powi(5));
        let diffuse = (1.0 - self.finish.metallic) * n_l / std::f32::consts::PI;
        Some((diffuse + slope * scale, gloss * scale))
    }

    /// Light from the surroundings; `open` is the unoccluded share of the sky.
    pub fn ambient(&self, sky: &Vector3<f32>, ground: &Vector3<f32>, open: f32) -> Reflection {
        let up = 0.5 + 0.5 * self.normal.z;
        let mirror = self.normal * (2.0 * self.normal.dot(self.view)) - self.view;
        // A rough surface mixes the two halves of the sky, a smooth one sees a horizon.
        let sharp = 1.0 + 6.0 * (1.0 - self.finish.roughness);
        let mirror_up = (0.5 + 0.5 * mirror.z * sharp).clamp(0.0, 1.0);
        let fresnel = (1.0 - self.normal.dot(self.view).max(0.0)).powi(5) * (1.0 - self.finish.roughness);
        let (slope, gloss) = self.mirrored(fresnel);
        let seen = (sky * mirror_up + ground * (1.0 - mirror_up)) * open;
        let diffuse = (sky * up + ground * (1.0 - up)) * ((1.0 - self.finish.metallic) * open);
        Reflection { slope: diffuse + seen * slope, gloss: seen * gloss }
    }
}
