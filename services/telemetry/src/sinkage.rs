//! `sinkage.csv`: entry and exit angles measured without a camera, row by row.

use messages::{Header, Sinkage, Status};
use std::f64::consts::PI;
use traverse::{Input, InputError, Rolls, SINKAGE_COLUMNS, Table, Traverse};

/// Standard deviation of a measured angle where `traverse.toml` gives none.
const ANGLE_SIGMA_RAD: f64 = 0.02;

/// An angle beyond half a turn is a spike of the sensor, and one beyond this is not in radians.
const ANGLE_MAX_RAD: f64 = 10.0;
/// On hard ground, noise may put the entry angle behind an exit angle up to this; one beyond it has the wrong sign.
const EXIT_NOISE_RAD: f64 = 0.1;

/// The rows of `sinkage.csv`.
pub(crate) struct SinkageRows {
    table: Table,
    radius_m: f64,
    rolls: Rolls,
    sigma_rad: f64,
}

impl SinkageRows {
    pub(crate) fn open(file: &str, input: Input, traverse: &Traverse) -> Result<Self, InputError> {
        let mut table = Table::open(file, input)?;
        table.bind(&SINKAGE_COLUMNS, &[])?;
        let Some(wheel) = &traverse.wheel else {
            let what = "needs [wheel] radius_m and width_m in traverse.toml: angles become a sinkage by the radius";
            return Err(InputError::new(file, 0, what));
        };
        Ok(Self {
            table,
            radius_m: wheel.radius_m,
            rolls: wheel.rolls,
            sigma_rad: traverse.sensors.entry_sigma_rad.unwrap_or(ANGLE_SIGMA_RAD),
        })
    }

    pub(crate) fn next_row(&mut self) -> Result<Option<Sinkage>, InputError> {
        let table = &mut self.table;
        if !table.next_row()? {
            return Ok(None);
        }
        let header = Header {
            taken_ns: table.taken_ns(0)?,
            sequence: table.row(),
            ..Header::default()
        };
        let entry_rad = table.number(1, -ANGLE_MAX_RAD..=ANGLE_MAX_RAD)?;
        let exit_rad = table.number(2, -ANGLE_MAX_RAD..=ANGLE_MAX_RAD)?;
        if exit_rad > entry_rad && exit_rad > EXIT_NOISE_RAD {
            return Err(table.cell_fault(
                2,
                "lies in front of entry_rad; angles are negative behind straight down",
            ));
        }
        let is_impossible = exit_rad > entry_rad || entry_rad.abs() > PI || exit_rad.abs() > PI;
        if is_impossible {
            return Ok(Some(Sinkage::unknown(header.answer(Status::SENSOR_FAULT))));
        }
        Ok(Some(self.sample(header, entry_rad, exit_rad)))
    }

    fn sample(&self, header: Header, entry_rad: f64, exit_rad: f64) -> Sinkage {
        let known = |angle: f64| if angle.is_nan() { f64::NAN } else { self.sigma_rad };
        let mut sample = Sinkage::unknown(header);
        (sample.entry_rad, sample.entry_sigma_rad) = (entry_rad, known(entry_rad));
        (sample.exit_rad, sample.exit_sigma_rad) = (exit_rad, known(exit_rad));
        let (front, back) = match self.rolls {
            Rolls::Right => (&mut sample.right_rad, &mut sample.left_rad),
            Rolls::Left => (&mut sample.left_rad, &mut sample.right_rad),
        };
        (*front, *back) = (entry_rad, -exit_rad);
        sample.left_sigma_rad = known(sample.left_rad);
        sample.right_sigma_rad = known(sample.right_rad);
        // z = r (1 - cos θ1), and to the second order of σ its variance.
        let (sin, cos) = entry_rad.sin_cos();
        sample.sinkage_m = self.radius_m * (1.0 - cos);
        sample.sinkage_sigma_m =
            self.radius_m * (sin * self.sigma_rad).hypot(cos * self.sigma_rad.powi(2) / 2_f64.sqrt());
        let missing = entry_rad.is_nan() || exit_rad.is_nan();
        sample.header.status = if missing { Status::INCOMPLETE } else { Status::OK };
        sample.confidence = 1.0;
        sample
    }
}
