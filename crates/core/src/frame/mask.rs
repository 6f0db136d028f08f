//! Binary masks.

/// Row-major `[height, width]` mask.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Whether a pixel belongs to the object, `width * height` values.
    pub data: Vec<bool>,
}

/// Tight box of a mask, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoundingBox {
    /// Leftmost column.
    pub col_min: u32,
    /// Topmost row.
    pub row_min: u32,
    /// One more than the rightmost column.
    pub col_max: u32,
    /// One more than the bottom row.
    pub row_max: u32,
}

impl Mask {
    /// A mask without any set pixel.
    pub fn empty(width: u32, height: u32) -> Self {
        Self { width, height, data: vec![false; width as usize * height as usize] }
    }

    /// Mask value at (column, row).
    pub fn get(&self, col: u32, row: u32) -> bool {
        self.data[row as usize * self.width as usize + col as usize]
    }

    /// Number of set pixels.
    pub fn count(&self) -> usize {
        self.data.iter().filter(|&&m| m).count()
    }

    /// Whether every pixel is set.
    pub fn is_full(&self) -> bool {
        self.data.iter().all(|&m| m)
    }

    /// Set pixels in row-major order as (column, row).
    pub fn pixels(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let width = self.width as usize;
        self.data
            .iter()
            .enumerate()
            .filter_map(move |(i, &m)| m.then_some(((i % width) as u32, (i / width) as u32)))
    }

    /// Tight box around the set pixels, `None` for an empty mask.
    pub fn bounding_box(&self) -> Option<BoundingBox> {
        self.pixels().fold(None, |bounds: Option<BoundingBox>, (col, row)| {
            let b = bounds.unwrap_or(BoundingBox {
                col_min: col,
                row_min: row,
                col_max: col + 1,
                row_max: row + 1,
            });
            Some(BoundingBox {
                col_min: b.col_min.min(col),
                row_min: b.row_min.min(row),
                col_max: b.col_max.max(col + 1),
                row_max: b.row_max.max(row + 1),
            })
        })
    }

    /// Intersection over union with a mask of the same size; 0 when both are empty.
    pub fn iou(&self, other: &Self) -> f64 {
        let (mut both, mut either) = (0usize, 0usize);
        for (&a, &b) in self.data.iter().zip(&other.data) {
            both += usize::from(a && b);
            either += usize::from(a || b);
        }
        if either == 0 { 0.0 } else { both as f64 / either as f64 }
    }
}
