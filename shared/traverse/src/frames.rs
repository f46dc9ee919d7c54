//! `frames.csv`: which picture was taken when, and where the wheel is in it.

use crate::{Input, InputError, Table};

/// The columns of `frames.csv`. The last nine, the homography, are all there or none.
pub const FRAME_COLUMNS: [&str; 16] = [
    "file",
    "taken_s",
    "center_x_px",
    "center_y_px",
    "rim_radius_px",
    "wheel_radius_px",
    "pitch_rad",
    "h11",
    "h12",
    "h13",
    "h21",
    "h22",
    "h23",
    "h31",
    "h32",
    "h33",
];
const POSE_COLUMNS: usize = 7;

/// One row: a picture, its instant and the wheel's pose in it.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameRow {
    /// The line of `frames.csv`, for errors.
    pub line: u64,
    /// Number of the row, the first being 0.
    pub sequence: u64,
    /// The PNG or JPEG file, relative to the folder.
    pub file: String,
    /// Instant [ns].
    pub taken_ns: u64,
    /// Wheel centre, column.
    pub center_x_px: f64,
    /// Wheel centre, row.
    pub center_y_px: f64,
    /// Radius of the bright rim's inner edge.
    pub rim_radius_px: f64,
    /// Radius of the wheel's outer edge.
    pub wheel_radius_px: f64,
    /// Pitch: `v_down = (sin pitch, cos pitch)` in the picture.
    pub pitch_rad: f64,
    /// Wheel-face plane to picture, row by row, where it is known.
    pub homography: Option<[f64; 9]>,
}

/// The rows of `frames.csv`, in the file's order, their instants increasing.
pub struct FrameRows {
    table: Table,
    last_ns: Option<u64>,
}

impl FrameRows {
    /// Reads the header. `file` is the name that errors give.
    ///
    /// # Errors
    /// Where a column is unknown or missing.
    pub fn open(file: &str, input: Input) -> Result<Self, InputError> {
        let mut table = Table::open(file, input)?;
        let has_homography = table
            .names()
            .iter()
            .any(|name| FRAME_COLUMNS[POSE_COLUMNS..].contains(&name.as_str()));
        let (required, optional) = FRAME_COLUMNS.split_at(POSE_COLUMNS);
        if has_homography {
            table.bind(&FRAME_COLUMNS, &[])?;
        } else {
            table.bind(required, optional)?;
        }
        Ok(Self { table, last_ns: None })
    }

    fn next_row(&mut self) -> Result<Option<FrameRow>, InputError> {
        const RADIUS_PX: std::ops::RangeInclusive<f64> = 1.0..=1e5;
        let table = &mut self.table;
        if !table.next_row()? {
            return Ok(None);
        }
        let file = table.text(0).to_owned();
        if file.is_empty() || file.starts_with('/') || file.split('/').any(|part| part == "..") || file.contains('\0') {
            return Err(table.cell_fault(0, "must be the name of a PNG or JPEG file inside this folder"));
        }
        let taken_ns = table.taken_ns(1)?;
        if self.last_ns == Some(taken_ns) {
            return Err(table.cell_fault(1, "is the instant of the row above; each frame needs its own"));
        }
        self.last_ns = Some(taken_ns);
        let mut homography = [f64::NAN; 9];
        for (index, value) in homography.iter_mut().enumerate() {
            *value = table.number(POSE_COLUMNS + index, -1e9..=1e9)?;
        }
        let missing = homography.iter().filter(|value| value.is_nan()).count();
        if missing != 0 && missing != homography.len() {
            return Err(table.fault("h11 to h33: some are empty; give all nine, or none"));
        }
        Ok(Some(FrameRow {
            line: table.line(),
            sequence: table.row(),
            file,
            taken_ns,
            center_x_px: table.required(2, -1e5..=1e5)?,
            center_y_px: table.required(3, -1e5..=1e5)?,
            rim_radius_px: table.required(4, RADIUS_PX)?,
            wheel_radius_px: table.required(5, RADIUS_PX)?,
            pitch_rad: table.required(6, -3.2..=3.2)?,
            homography: (missing == 0).then_some(homography),
        }))
    }
}

impl Iterator for FrameRows {
    type Item = Result<FrameRow, InputError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_row().transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: &str = "file,taken_s,center_x_px,center_y_px,rim_radius_px,wheel_radius_px,pitch_rad";

    fn read(text: String) -> Result<Vec<FrameRow>, InputError> {
        FrameRows::open("frames.csv", Box::new(std::io::Cursor::new(text)))?.collect()
    }

    #[test]
    fn a_row_is_read_with_and_without_its_homography() {
        let circle = read(format!("{POSE}\n000.png,0.5,320,200,130,163,0.04\n")).unwrap();
        assert_eq!(
            circle,
            [FrameRow {
                line: 2,
                sequence: 0,
                file: "000.png".into(),
                taken_ns: 500_000_000,
                center_x_px: 320.0,
                center_y_px: 200.0,
                rim_radius_px: 130.0,
                wheel_radius_px: 163.0,
                pitch_rad: 0.04,
                homography: None,
            }]
        );
        let header = format!("{POSE},h11,h12,h13,h21,h22,h23,h31,h32,h33");
        let rows = read(format!(
            "{header}\na.png,0,1,2,3,4,0,1,2,3,4,5,6,7,8,9\nb.png,1,1,2,3,4,0,,,,,,,,,\n"
        ))
        .unwrap();
        assert_eq!(rows[0].homography, Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]));
        assert_eq!(rows[1].homography, None);
    }

    #[test]
    fn impossible_rows_are_refused() {
        for (row, expected) in [
            (
                "../a.png,0,1,2,3,4,0",
                "frames.csv:2: file: \"../a.png\" must be the name of a PNG or JPEG file inside this folder",
            ),
            (
                "a.png,0,abc,2,3,4,0",
                "frames.csv:2: center_x_px: \"abc\" is not a number; write one like -1.25e3; here it may not be missing",
            ),
            (
                "a.png,0,,2,3,4,0",
                "frames.csv:2: center_x_px: \"\" is not a number; write one like -1.25e3; here it may not be missing",
            ),
            (
                "a.png,0,1,2,3,-4,0",
                "frames.csv:2: wheel_radius_px: \"-4\" is out of range; it must lie in 1.0 to 100000.0",
            ),
            (
                "a.png,0,1,2,3,4,12",
                "frames.csv:2: pitch_rad: \"12\" is out of range; it must lie in -3.2 to 3.2",
            ),
            (
                "a.png,1,1,2,3,4,0\nb.png,1,1,2,3,4,0",
                "frames.csv:3: taken_s: \"1\" is the instant of the row above; each frame needs its own",
            ),
        ] {
            assert_eq!(read(format!("{POSE}\n{row}\n")).unwrap_err().to_string(), expected);
        }
        let partial = read(format!("{POSE},h11\na.png,0,1,2,3,4,0,1\n"))
            .unwrap_err()
            .to_string();
        assert!(
            partial.starts_with("frames.csv:1: column \"h12\" is missing"),
            "{partial}"
        );
    }
}
