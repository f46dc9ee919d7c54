//! Mean gray value of the rim along rows of constant height, left and right of straight down.

use crate::rim::Rim;

/// Rows from the height of the wheel's centre down to its lowest point.
pub const ROWS: usize = 160;

/// One side of the lower half of the annulus: sums over rows of constant Z. Row `k` holds `k <= ROWS * Z < k + 1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Side {
    /// Sum of the gray values of each row.
    pub sums: [f64; ROWS],
    /// Pixels of each row.
    pub counts: [f64; ROWS],
}

impl Side {
    /// A side without a pixel.
    pub const EMPTY: Self = Self {
        sums: [0.0; ROWS],
        counts: [0.0; ROWS],
    };

    /// Pixels of all rows.
    #[must_use]
    pub fn pixels(&self) -> f64 {
        self.counts.iter().sum()
    }
}

/// Sums the picture's rows: `[left, right]`. `image` holds rows of `width` pixels without gaps.
pub fn accumulate(image: &[u8], width: usize, rim: &Rim, sides: &mut [Side; 2]) {
    *sides = [Side::EMPTY; 2];
    let [a, b, c, d, e, f, g, h, i] = rim.plane;
    let (inner, outer) = (rim.inner * rim.inner, rim.outer * rim.outer);
    let lines = image.chunks_exact(width.max(1)).enumerate();
    for (row, line) in lines.take(rim.rows.end).skip(rim.rows.start) {
        let y = row as f64;
        let x = rim.columns.start as f64;
        let (mut right, mut down, mut scale) = (a * x + b * y + c, d * x + e * y + f, g * x + h * y + i);
        for &gray in line.get(rim.columns.clone()).unwrap_or(&[]) {
            let (radius, unit) = (right * right + down * down, scale * scale);
            if radius >= inner * unit && radius < outer * unit && down >= 0.0 && scale > 0.0 {
                // At most ROWS - 1, since Z is below `outer`; `min` for what rounding may add.
                let k = ((down / scale * ROWS as f64) as usize).min(ROWS - 1);
                let side = &mut sides[usize::from(right >= 0.0)];
                side.sums[k] += f64::from(gray);
                side.counts[k] += 1.0;
            }
            right += a;
            down += d;
            scale += g;
        }
    }
}
