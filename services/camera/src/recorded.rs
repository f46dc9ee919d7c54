//! The camera of a recorded traverse.

use crate::PictureReader;
use messages::Frame;
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

    /// Where a row stands, for errors.
    #[must_use]
    pub fn place(&self, row: &FrameRow) -> String {
        format!("{}:{}", self.table, row.line)
    }

    /// Fills the frame of a row from the bytes of the file that it names.
    ///
    /// # Errors
    /// Where the bytes are no sound picture, or show no wheel. The frame is then not to be used.
    pub fn fill(&mut self, row: &FrameRow, png: &[u8], frame: &mut Frame) -> Result<(), InputError> {
        let filled = self.pictures.fill(row, png, frame);
        filled.map_err(|what| InputError::new(&self.table, row.line, format!("{}: {what}", row.file)))
    }

    /// Instant of the last row that was read.
    #[must_use]
    pub fn last_ns(&self) -> u64 {
        self.last_ns
    }
}
