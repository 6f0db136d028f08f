//! Depth along the optical axis, metres; 0 where there is no measurement.

/// Row-major `[height, width]` depth in metres, 0 = no measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Depth of every pixel, `width * height` values.
    pub data: Vec<f32>,
}

impl DepthMap {
    /// A map without any measurement.
    pub fn zeros(width: u32, height: u32) -> Self {
        Self { width, height, data: vec![0.0; width as usize * height as usize] }
    }

    /// Depth at (column, row), metres.
    pub fn get(&self, col: u32, row: u32) -> f32 {
        self.data[row as usize * self.width as usize + col as usize]
    }
}
