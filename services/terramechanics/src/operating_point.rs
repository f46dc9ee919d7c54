//! The operating point: measurements averaged while load, entry angle and slip stay the same.

use crate::Row;
use crate::model::Model;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The mean has the weight of at most this many rows, so that it follows a slow drift.
const ROWS_MAX: f64 = 512.0;
/// A row so many standard deviations off does not count, …
const SIGMAS_MAX: f64 = 4.0;
/// … and so many in succession are another operating point, …
const FAR_OFF_MAX: f64 = 3.0;
/// … as are recent rows whose mean deviation, in standard deviations of a row, is larger than this.
const DRIFT_MAX: f64 = 1.5;
const DRIFT_SHARE: f64 = 0.2;

/// The mean of the rows since the operating point was last another.
#[derive(Clone, Copy, Debug, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct OperatingPoint {
    mean: Row,
    pub(crate) rows: f64,
    /// Rows far off, in succession.
    far_off: f64,
    /// Recent mean deviation of load, entry angle and slip, in standard deviations of a row.
    drift: [f64; 3],
}

impl OperatingPoint {
    /// Takes in a row.
    pub(crate) fn add(&mut self, row: &Row, model: &Model) {
        let mean = &self.mean;
        let spread = (1.0 + 1.0 / self.rows).sqrt();
        let of_readings = spread * row.variance_share.sqrt();
        let off = [
            (row.load_n - mean.load_n) / (mean.load_n * model.load_sigma * of_readings),
            (row.entry_rad - mean.entry_rad) / (row.entry_sigma_rad * spread),
            (row.slip - mean.slip) / (model.slip_sigma * of_readings),
        ];
        for (drift, off) in self.drift.iter_mut().zip(off) {
            *drift += (off.clamp(-SIGMAS_MAX, SIGMAS_MAX) - *drift) * DRIFT_SHARE;
        }
        let is_far_off = off.iter().any(|off| off.abs() > SIGMAS_MAX);
        self.far_off = if is_far_off { self.far_off + 1.0 } else { 0.0 };
        let has_drifted = self.drift.iter().any(|drift| drift.abs() > DRIFT_MAX);
        if self.rows == 0.0 || self.far_off >= FAR_OFF_MAX || has_drifted {
            *self = Self {
                mean: *row,
                rows: 1.0,
                ..Self::default()
            };
            return;
        }
        if is_far_off {
            return;
        }
        let mean = &mut self.mean;
        self.rows = (self.rows + 1.0).min(ROWS_MAX);
        for (mean, value) in [
            (&mut mean.load_n, row.load_n),
            (&mut mean.torque_nm, row.torque_nm),
            (&mut mean.entry_rad, row.entry_rad),
            (&mut mean.exit_rad, row.exit_rad),
            (&mut mean.slip, row.slip),
            (&mut mean.entry_sigma_rad, row.entry_sigma_rad),
            (&mut mean.variance_share, row.variance_share),
        ] {
            *mean += (value - *mean) / self.rows;
        }
    }

    /// The mean as one row, with the variance of a mean.
    pub(crate) fn as_row(&self) -> Row {
        Row {
            entry_sigma_rad: self.mean.entry_sigma_rad / self.rows.sqrt(),
            variance_share: self.mean.variance_share / self.rows,
            ..self.mean
        }
    }
}
