//! The camera of a recorded traverse.

use crate::PictureReader;
use messages::{Frame, Header, Status};
use std::io::Cursor;
use traverse::{FrameRow, FrameRows, InputError};

/// The camera of a recorded traverse: a frame for each row of `frames.csv`.
pub struct RecordedCamera {
    folder: String,
    table: String,
    rows: FrameRows,
    pictures: PictureReader,
    last_ns: u64,
}

impl RecordedCamera {
    /// From the bytes of the folder's `frames.csv`.
    ///
    /// # Errors
    /// Where its header is not what it must be.
    pub fn open(folder: &str, table: Vec<u8>) -> Result<Self, InputError> {
        let name = format!("{folder}/frames.csv");
        Ok(Self {
            folder: folder.into(),
            rows: FrameRows::open(&name, Box::new(Cursor::new(table)))?,
            table: name,
            pictures: PictureReader::default(),
            last_ns: 0,
        })
    }

    /// The next row; `None` behind the last one.
    ///
    /// # Errors
    /// Where the row is not what it must be.
    pub fn next_row(&mut self) -> Result<Option<FrameRow>, InputError> {
        let row = self.rows.next().transpose()?;
        self.last_ns = row.as_ref().map_or(self.last_ns, |row| row.taken_ns);
        Ok(row)
    }

    /// The file that a row names.
    #[must_use]
    pub fn path(&self, row: &FrameRow) -> String {
        format!("{}/{}", self.folder, row.file)
    }

    /// Fills the frame of a row from the bytes of the file that it names, or from what was wrong with reading them.
    ///
    /// # Errors
    /// Where there are no bytes, or they are no sound picture. The frame is then without a picture, and says so: `NO_DATA`
    /// where there is no file, `INPUT_REJECTED` where there is a broken one.
    pub fn fill(&mut self, row: &FrameRow, png: Result<&[u8], String>, frame: &mut Frame) -> Result<(), InputError> {
        let missing = png.is_err();
        let filled = png.and_then(|png| {
            self.pictures
                .fill(row, png, frame)
                .map_err(|what| format!("{}: {what}", row.file))
        });
        filled.map_err(|what| {
            frame.header = Header {
                taken_ns: row.taken_ns,
                sequence: row.sequence,
                status: if missing {
                    Status::NO_DATA
                } else {
                    Status::INPUT_REJECTED
                },
                ..Header::default()
            };
            (frame.width, frame.height) = (0, 0);
            (frame.crop_x_px, frame.crop_y_px) = (0, 0);
            (frame.center_x_px, frame.center_y_px) = (row.center_x_px, row.center_y_px);
            (frame.rim_radius_px, frame.wheel_radius_px) = (row.rim_radius_px, row.wheel_radius_px);
            frame.pitch_rad = row.pitch_rad;
            frame.homography = [f64::NAN; 9];
            InputError::new(&self.table, row.line, what)
        })
    }

    /// Instant of the last row that was read.
    #[must_use]
    pub fn last_ns(&self) -> u64 {
        self.last_ns
    }
}
