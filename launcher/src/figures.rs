//! The files of a replay's figures: reads its CSVs and the traverse's truth, and writes SVGs beside the CSVs.

use crate::plots::{self, SinkageRow, SoilRow, SoilTruth};
use camera::PictureReader;
use messages::Frame;
use shell::Error;
use sinkage::profile;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use traverse::{FrameRows, Table};
use zerocopy::FromZeros;

/// The figure of cohesion and friction angle.
pub const SOIL: &str = "soil.svg";

/// The figure of sinkage on either side.
pub const SINKAGE: &str = "sinkage.svg";

/// The figure of what one picture's sinkage rests on.
pub const INTERFACE: &str = "interface.svg";

/// Draws `soil.svg` from `soil.csv`; `None` where that has no rows.
///
/// # Errors
/// A file cannot be read or written.
pub fn soil(traverse: &Path, out: &Path) -> Result<Option<PathBuf>, Error> {
    let columns = [
        "taken_s",
        "cohesion_pa",
        "cohesion_sigma_pa",
        "friction_rad",
        "friction_sigma_rad",
        "resets",
    ];
    let mut rows = Vec::new();
    read(&out.join("soil.csv"), columns, |values, status| {
        let [
            taken_s,
            cohesion_pa,
            cohesion_sigma_pa,
            friction_rad,
            friction_sigma_rad,
            resets,
        ] = values;
        rows.push(SoilRow {
            taken_s,
            cohesion_pa,
            cohesion_sigma_pa,
            friction_rad,
            friction_sigma_rad,
            resets,
            ok: status == "ok",
        });
    })?;
    if rows.is_empty() {
        return Ok(None);
    }
    let mut truth = Vec::new();
    let columns = ["taken_s", "cohesion_pa", "friction_rad"];
    read(&traverse.join("truth.csv"), columns, |values, _| {
        let [taken_s, cohesion_pa, friction_rad] = values;
        truth.push(SoilTruth {
            taken_s,
            cohesion_pa,
            friction_rad,
        });
    })?;
    let svg = plots::soil(&rows, &truth).map_err(|error| Error::internal(format!("{SOIL}: {error}")))?;
    write(out.join(SOIL), &svg)
}

fn write(path: PathBuf, svg: &str) -> Result<Option<PathBuf>, Error> {
    fs::write(&path, svg).map_err(|error| Error::data(format!("{}: {error}", path.display())))?;
    Ok(Some(path))
}

/// Draws `sinkage.svg` from `sinkage.csv`; `None` where that has no rows. Truth has a row for each picture.
///
/// # Errors
/// A file cannot be read or written.
pub fn sinkage(traverse: &Path, out: &Path) -> Result<Option<PathBuf>, Error> {
    let columns = ["taken_s", "left_rad", "left_sigma_rad", "right_rad", "right_sigma_rad"];
    let mut rows = Vec::new();
    read(&out.join("sinkage.csv"), columns, |values, status| {
        let [taken_s, left_rad, left_sigma_rad, right_rad, right_sigma_rad] = values;
        rows.push(SinkageRow {
            taken_s,
            angles_rad: [left_rad, right_rad],
            sigmas_rad: [left_sigma_rad, right_sigma_rad],
            ok: status == "ok",
        });
    })?;
    if rows.is_empty() {
        return Ok(None);
    }
    let mut truth = Vec::new();
    read(&traverse.join("truth.csv"), ["left_rad", "right_rad"], |values, _| {
        truth.push(values);
    })?;
    let svg = plots::sinkage(&rows, &truth).map_err(|error| Error::internal(format!("{SINKAGE}: {error}")))?;
    write(out.join(SINKAGE), &svg)
}

/// Draws `interface.svg` of the picture in the middle of those with the status ok, or of all; `None` where no picture
/// shows a rim.
///
/// # Errors
/// A file cannot be read or written.
pub fn interface(traverse: &Path, out: &Path) -> Result<Option<PathBuf>, Error> {
    let mut answers = Vec::new();
    let columns = ["sequence", "left_rad", "right_rad"];
    read(
        &out.join("sinkage.csv"),
        columns,
        |[sequence, left_rad, right_rad], status| {
            answers.push((status == "ok", sequence as u64, [left_rad, right_rad]));
        },
    )?;
    let sure = answers.iter().filter(|answer| answer.0).count();
    let mut candidates = answers.iter().filter(|answer| answer.0 || sure == 0);
    let middle = if sure == 0 { answers.len() } else { sure } / 2;
    let Some(&(_, sequence, angles_rad)) = candidates.nth(middle) else {
        return Ok(None);
    };
    let table = traverse.join("frames.csv");
    if !table.is_file() {
        return Ok(None);
    }
    let failed = |path: &Path, error: &dyn std::fmt::Display| Error::data(format!("{}: {error}", path.display()));
    let bytes = fs::read(&table).map_err(|error| failed(&table, &error))?;
    let rows = FrameRows::open("frames.csv", Box::new(Cursor::new(bytes))).map_err(|error| failed(traverse, &error))?;
    for row in rows {
        let row = row.map_err(|error| failed(traverse, &error))?;
        if row.sequence != sequence {
            continue;
        }
        let picture = traverse.join(&row.file);
        // The camera has said what is wrong with a picture that cannot be read.
        let Ok(png) = fs::read(&picture) else {
            return Ok(None);
        };
        let mut frame = Frame::new_box_zeroed().map_err(|_| Error::internal("no memory for a picture"))?;
        if PictureReader::default().fill(&row, &png, &mut frame).is_err() {
            return Ok(None);
        }
        let Some(profiles) = profile::profiles(&frame) else {
            return Ok(None);
        };
        let svg = plots::interface(&row.file, &profiles, angles_rad);
        let svg = svg.map_err(|error| Error::internal(format!("{INTERFACE}: {error}")))?;
        let path = out.join(INTERFACE);
        fs::write(&path, svg).map_err(|error| failed(&path, &error))?;
        return Ok(Some(path));
    }
    Ok(None)
}

/// Hands on these columns of each row and its status, if it has one. No file, a file without rows, and a file without
/// these columns have nothing to hand on.
fn read<const N: usize>(path: &Path, columns: [&str; N], mut row: impl FnMut([f64; N], &str)) -> Result<(), Error> {
    let shown = path.display().to_string();
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(Error::data(format!("{shown}: {error}"))),
    };
    let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    if lines.count() < 2 {
        return Ok(());
    }
    let failed = |error: traverse::InputError| Error::data(error.to_string());
    let mut table = Table::open(&shown, Box::new(Cursor::new(bytes))).map_err(failed)?;
    let place = |name: &str| table.names().iter().position(|other| other == name);
    let places = columns.map(place);
    let status = place("status").unwrap_or(usize::MAX);
    if places.contains(&None) {
        return Ok(());
    }
    while table.next_row().map_err(failed)? {
        let mut values = [f64::NAN; N];
        for (value, place) in values.iter_mut().zip(places.into_iter().flatten()) {
            *value = table.number(place, f64::MIN..=f64::MAX).map_err(failed)?;
        }
        row(values, table.text(status));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOIL_CSV: &str = "taken_s,sequence,status,cohesion_pa,cohesion_sigma_pa,friction_rad,friction_sigma_rad,resets\n\
                            1,0,warming_up,,,,,0\n1.1,1,ok,800,90,0.5,0.02,0\n1.2,2,ok,810,80,0.5,0.02,1\n";

    /// What `soil` draws for these files; an empty text stands for no file.
    fn drawn(soil_csv: &str, truth_csv: &str) -> Result<Option<String>, String> {
        let folder = tempfile::tempdir().unwrap();
        for (file, text) in [("soil.csv", soil_csv), ("truth.csv", truth_csv)] {
            if !text.is_empty() {
                fs::write(folder.path().join(file), text).unwrap();
            }
        }
        let path = soil(folder.path(), folder.path()).map_err(|error| error.to_string())?;
        Ok(path.map(|path| fs::read_to_string(path).unwrap()))
    }

    #[test]
    fn a_figure_is_drawn_of_the_rows_and_of_the_truth_if_it_names_the_soil() {
        let known = "file,taken_s,soil,cohesion_pa,friction_rad\na.png,1,sand,850,0.5\nb.png,2,sand,850,0.5\n";
        assert!(drawn(SOIL_CSV, known).unwrap().unwrap().contains("truth"));
        for unknown in ["", "taken_s,sinkage_m\n1,0.02\n", "taken_s,cohesion_pa,friction_rad\n"] {
            let svg = drawn(SOIL_CSV, unknown).unwrap().unwrap();
            assert!(svg.contains("change of soil") && !svg.contains("truth"), "{unknown}");
        }
    }

    #[test]
    fn without_rows_nothing_is_drawn() {
        assert_eq!(drawn("", ""), Ok(None));
        assert_eq!(drawn(SOIL_CSV.lines().next().unwrap(), ""), Ok(None));
    }

    #[test]
    fn sinkage_is_drawn_with_the_truth_of_its_pictures() {
        let folder = tempfile::tempdir().unwrap();
        let csv = "taken_s,sequence,status,left_rad,left_sigma_rad,right_rad,right_sigma_rad\n\
                   1,0,ok,0.5,0.01,0.6,0.01\n1.5,1,uncertain,0.6,0.1,,\n";
        fs::write(folder.path().join("sinkage.csv"), csv).unwrap();
        fs::write(
            folder.path().join("truth.csv"),
            "file,left_rad,right_rad\na,0.5,0.6\nb,0.6,0.7\n",
        )
        .unwrap();
        let path = sinkage(folder.path(), folder.path()).unwrap().unwrap();
        let svg = fs::read_to_string(path).unwrap();
        assert!(svg.contains("truth") && svg.contains("sinkage on the left"));
    }

    #[test]
    fn a_broken_truth_is_named_with_its_line() {
        let error = drawn(SOIL_CSV, "taken_s,cohesion_pa,friction_rad\n1,high,0.5\n").unwrap_err();
        assert!(error.contains("truth.csv:2: cohesion_pa: \"high\""), "{error}");
    }
}
