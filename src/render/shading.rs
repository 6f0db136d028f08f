//! Reflection: Lambert + GGX microfacets (Walter et al. 2007, Schlick's approximations), ambient from a two-tone sky.

use nalgebra::Vector3;

use super::scene::Finish;

/// A surface point as the lights see it. Directions are unit vectors.
pub(super) struct Shaded<'a> {
    pub normal: &'a Vector3<f32>,
    /// Towards the camera.
    pub view: &'a Vector3<f32>,
    /// Linear light.
    pub albedo: [f32; 3],
    pub finish: Finish,
}

impl Shaded<'_> {
    fn base_reflectance(&self) -> [f32; 3] {
        let m = self.finish.metallic;
        self.albedo.map(|a| 0.04 * (1.0 - m) + a * m)
    }

    /// Radiance towards the camera for unit irradiance from direction `light`: (diffuse, specular).
    pub fn reflect(&self, light: &Vector3<f32>) -> Option<([f32; 3], [f32; 3])> {
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
        let fresnel = (1.0 - v_h).powi(5);
        let scale = 0.25 * distribution * geometry * n_l;
        let specular = self.base_reflectance().map(|f0| (f0 + (1.0 - f0) * fresnel) * scale);
        let keep = (1.0 - self.finish.metallic) * n_l / std::f32::consts::PI;
        Some((self.albedo.map(|a| a * keep), specular))
    }

    /// Light from the surroundings; `open` is the unoccluded share of the sky.
    pub fn ambient(&self, sky: &[f32; 3], ground: &[f32; 3], open: f32) -> [f32; 3] {
        let up = 0.5 + 0.5 * self.normal.z;
        let mirror = self.normal * (2.0 * self.normal.dot(self.view)) - self.view;
        // A rough surface mixes the two halves of the sky, a smooth one sees a horizon.
        let sharp = 1.0 + 6.0 * (1.0 - self.finish.roughness);
        let mirror_up = (0.5 + 0.5 * mirror.z * sharp).clamp(0.0, 1.0);
        let fresnel = (1.0 - self.normal.dot(self.view).max(0.0)).powi(5) * (1.0 - self.finish.roughness);
        let f0 = self.base_reflectance();
        std::array::from_fn(|k| {
            let diffuse =
                self.albedo[k] * (1.0 - self.finish.metallic) * (sky[k] * up + ground[k] * (1.0 - up));
            let seen = sky[k] * mirror_up + ground[k] * (1.0 - mirror_up);
            (diffuse + (f0[k] + (1.0 - f0[k]) * fresnel) * seen) * open
        })
    }
}
