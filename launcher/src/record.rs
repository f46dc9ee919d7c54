//! Recorded wires: one CSV a wire, one row a sample, the columns being the message's field names.
//!
//! Only what two replays have in common is written: no instants of publishing, no generations.

use messages::{CLASSES_MAX, Field, Header, Kind, Soil, Status, TerrainClass, label_text};
use shell::{Error, Port};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use zerocopy::FromBytes;

/// Rows that wait for the first one that names the classes, at the most; then the header is written without them.
const UNLABELLED_MAX: usize = 100_000;

/// The CSV of one wire. It takes its name only when it is complete.
#[derive(Debug)]
pub struct Recording {
    file: BufWriter<File>,
    partial: PathBuf,
    path: PathBuf,
    port: Port,
    header_written: bool,
    waiting: Vec<String>,
    classes: usize,
    /// Rows so far.
    pub rows: u64,
}

impl Recording {
    /// Begins `<folder>/<name>.csv`.
    ///
    /// # Errors
    /// The file cannot be made.
    pub fn create(folder: &Path, name: &str, port: Port) -> Result<Self, Error> {
        let path = folder.join(format!("{name}.csv"));
        let partial = folder.join(format!(".{name}.csv.partial"));
        let file = File::create(&partial).map_err(|error| Error::data(format!("{}: {error}", partial.display())))?;
        let file = BufWriter::new(file);
        Ok(Self {
            file,
            partial,
            path,
            port,
            header_written: false,
            waiting: Vec::new(),
            classes: 0,
            rows: 0,
        })
    }

    /// Adds a sample.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn add(&mut self, header: &Header, bytes: &[u8]) -> Result<(), Error> {
        if header.status == Status::ENDED {
            return Ok(());
        }
        self.rows += 1;
        let class = TerrainClass::ref_from_bytes(bytes)
            .ok()
            .filter(|_| self.port == Port::Class);
        if let (Some(sample), false) = (class, self.header_written) {
            if sample.class_count == 0 && self.waiting.len() < UNLABELLED_MAX {
                self.waiting.push(self.row(header, bytes, None));
                return Ok(());
            }
            self.classes = (sample.class_count as usize).min(CLASSES_MAX);
        }
        if !self.header_written {
            self.begin(class)?;
        }
        let row = self.row(header, bytes, class);
        self.line(&row)
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<(), Error> {
        if !self.header_written {
            self.begin(None)?;
        }
        let failed = |error: std::io::Error| Error::data(format!("{}: {error}", self.path.display()));
        self.file.flush().map_err(failed)?;
        std::fs::rename(&self.partial, &self.path).map_err(failed)
    }

    fn begin(&mut self, class: Option<&TerrainClass>) -> Result<(), Error> {
        self.header_written = true;
        let mut names = vec!["taken_s".to_owned(), "sequence".into(), "status".into()];
        for field in columns(self.port) {
            names.extend(column_names(field));
        }
        if let Some(sample) = class {
            names.extend((0..self.classes).map(|class| format!("probability_{}", label_text(&sample.labels[class]))));
        }
        self.line(&names.iter().map(|name| cell(name)).collect::<Vec<_>>().join(","))?;
        for row in std::mem::take(&mut self.waiting) {
            // Rows from before the first that names the classes have no probabilities.
            self.line(&format!("{row}{}", ",".repeat(self.classes)))?;
        }
        Ok(())
    }

    fn row(&self, header: &Header, bytes: &[u8], class: Option<&TerrainClass>) -> String {
        let status = header
            .status
            .word()
            .map_or_else(|| header.status.0.to_string(), str::to_owned);
        let mut row = format!("{},{},{status}", seconds(header.taken_ns), header.sequence);
        for field in columns(self.port) {
            match (field.name, class) {
                ("class", _) if self.port == Port::Class => {
                    let sample = TerrainClass::ref_from_bytes(bytes).map_or("", |sample| sample.class_text());
                    row += &format!(",{}", cell(sample));
                }
                _ => (0..field.count).for_each(|index| write_value(&mut row, field, index, bytes)),
            }
        }
        for probability in class.iter().flat_map(|sample| &sample.probability[..self.classes]) {
            write_float(&mut row, *probability);
        }
        row
    }

    fn line(&mut self, text: &str) -> Result<(), Error> {
        let written = self
            .file
            .write_all(text.as_bytes())
            .and_then(|()| self.file.write_all(b"\n"));
        written.map_err(|error| Error::data(format!("{}: {error}", self.partial.display())))
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        // Gone already where the recording is complete.
        let _ = std::fs::remove_file(&self.partial);
    }
}

/// The fields that become columns: no bulk data, no text that stands elsewhere.
fn columns(port: Port) -> impl Iterator<Item = &'static Field> {
    port.fields().iter().filter(move |field| {
        let class_only = port == Port::Class && ["class_count", "probability", "labels"].contains(&field.name);
        let bulk = field.count > 9 || (matches!(field.kind, Kind::Text(_)) && field.count > 1);
        field.kind != Kind::Header && !class_only && !bulk
    })
}

fn column_names(field: &Field) -> Vec<String> {
    if field.name == "homography" {
        return (1..=3)
            .flat_map(|row| (1..=3).map(move |column| format!("h{row}{column}")))
            .collect();
    }
    match field.name.strip_suffix("_ns") {
        Some(name) => vec![format!("{name}_s")],
        None => vec![field.name.to_owned()],
    }
}

fn write_value(row: &mut String, field: &Field, index: usize, bytes: &[u8]) {
    let start = field.offset + index * field.kind.size();
    let value = bytes.get(start..start + field.kind.size()).unwrap_or(&[]);
    let number = |bytes: &[u8]| {
        bytes
            .iter()
            .rev()
            .fold(0_u64, |number, byte| number << 8 | u64::from(*byte))
    };
    let integer = number(value);
    match field.kind {
        Kind::F64 => return write_float(row, f64::from_bits(integer)),
        Kind::F32 => return write_float(row, f64::from(f32::from_bits(integer as u32))),
        _ => row.push(','),
    }
    match field.kind {
        Kind::Status => row.push_str(Status(integer as u32).word().unwrap_or("unknown_status")),
        Kind::Text(_) => row.push_str(&cell(label_text(value))),
        // An age that never was.
        Kind::U64 if field.name.ends_with("_ns") && integer == u64::MAX => {}
        Kind::U64 if field.name.ends_with("_ns") => row.push_str(&seconds(integer)),
        _ if field.name == "reason" => row.push_str(Soil::reason_word(integer as u32).unwrap_or("unknown_reason")),
        _ => {
            let _ = write!(row, "{integer}");
        }
    }
}

/// A float as the shortest text that reads back as the same float; nothing where it is missing.
fn write_float(row: &mut String, value: f64) {
    row.push(',');
    if !value.is_nan() {
        let _ = write!(row, "{value}");
    }
}

/// Nanoseconds as seconds, exactly.
fn seconds(ns: u64) -> String {
    let text = format!("{}.{:09}", ns / 1_000_000_000, ns % 1_000_000_000);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A cell of a CSV file: quoted where it must be.
pub(crate) fn cell(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Sinkage, label};
    use zerocopy::IntoBytes;

    fn record(port: Port, samples: &[(&Header, &[u8])]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let mut recording = Recording::create(folder.path(), "wire", port).unwrap();
        for (header, bytes) in samples {
            recording.add(header, bytes).unwrap();
        }
        recording.finish().unwrap();
        std::fs::read_to_string(folder.path().join("wire.csv")).unwrap()
    }

    #[test]
    fn a_row_has_the_fields_by_name_and_missing_values_are_empty() {
        let header = Header {
            taken_ns: 1_250_000_000,
            sequence: 7,
            ..Header::default()
        };
        let mut sample = Sinkage::unknown(header.answer(Status::UNCERTAIN));
        sample.left_rad = 0.25;
        let text = record(Port::Sinkage, &[(&sample.header, sample.as_bytes())]);
        let mut lines = text.lines();
        assert!(
            lines
                .next()
                .unwrap()
                .starts_with("taken_s,sequence,status,left_rad,left_sigma_rad,right_rad")
        );
        assert_eq!(lines.next().unwrap(), "1.25,7,uncertain,0.25,,,,,,,,,,,,");
    }

    #[test]
    fn classes_are_columns_by_their_names_also_for_rows_that_came_before_them() {
        let early = TerrainClass::undecided(Header {
            status: Status::WARMING_UP,
            ..Header::default()
        });
        let mut later = TerrainClass::undecided(Header {
            taken_ns: 1_000_000_000,
            sequence: 1,
            ..Header::default()
        });
        later.class_count = 2;
        later.class = 1;
        later.unknown = 0;
        later.metric = -0.5;
        (later.labels[0], later.labels[1]) = (label("sand"), label("rock, wet"));
        (later.probability[0], later.probability[1]) = (0.25, 0.75);
        let samples: [(&Header, &[u8]); 2] = [(&early.header, early.as_bytes()), (&later.header, later.as_bytes())];
        let text = record(Port::Class, &samples);
        assert_eq!(
            text,
            "taken_s,sequence,status,start_s,window_s,class,unknown,windows,metric,probability_sand,\"probability_rock, wet\"\n\
             0,0,warming_up,0,0,,1,0,,,\n\
             1,1,ok,0,0,\"rock, wet\",0,0,-0.5,0.25,0.75\n"
        );
    }

    #[test]
    fn a_recording_that_is_not_finished_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        drop(Recording::create(folder.path(), "wire", Port::Soil).unwrap());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
