//! `wheel.csv`: load, torque and motion, row by row.

use messages::{Header, Status, Wheel};
use traverse::{Input, InputError, Table, WHEEL_COLUMNS};

/// The rows of `wheel.csv`.
pub(crate) struct WheelRows(Table);

impl WheelRows {
    pub(crate) fn open(file: &str, input: Input) -> Result<Self, InputError> {
        let mut table = Table::open(file, input)?;
        let (required, optional) = WHEEL_COLUMNS.split_at(5);
        table.bind(required, optional)?;
        Ok(Self(table))
    }

    pub(crate) fn next_row(&mut self) -> Result<Option<Wheel>, InputError> {
        let table = &mut self.0;
        if !table.next_row()? {
            return Ok(None);
        }
        let header = Header {
            taken_ns: table.taken_ns(0)?,
            sequence: table.row(),
            ..Header::default()
        };
        let mut wheel = unknown(header);
        wheel.load_n = table.number(1, -1e6..=1e6)?;
        wheel.torque_nm = table.number(2, -1e6..=1e6)?;
        wheel.angular_velocity_rad_s = table.number(3, -1e4..=1e4)?;
        wheel.linear_velocity_m_s = table.number(4, -1e4..=1e4)?;
        wheel.slip = table.number(5, -1e3..=1e3)?;
        let measured = [
            wheel.load_n,
            wheel.torque_nm,
            wheel.angular_velocity_rad_s,
            wheel.linear_velocity_m_s,
        ];
        wheel.header.status = match measured.iter().any(|value| value.is_nan()) {
            true => Status::INCOMPLETE,
            false => Status::OK,
        };
        Ok(Some(wheel))
    }
}

/// A sample that knows nothing: `header`, and NaN everywhere else.
pub(crate) fn unknown(header: Header) -> Wheel {
    Wheel {
        header,
        load_n: f64::NAN,
        torque_nm: f64::NAN,
        angular_velocity_rad_s: f64::NAN,
        linear_velocity_m_s: f64::NAN,
        slip: f64::NAN,
    }
}
