//! A folder of recordings: `recordings.csv` (file, class, run), and a table or a sound file each.

use hound::{SampleFormat, WavReader};
use shell::Error;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use traverse::{SOUND_CHANNELS, Table, sampling_period_ns};
use vibration::classifier::SPEED_CHANNEL;
use vibration::recording::Recording;

/// Largest amount of a sample.
const SAMPLE_MAX: f64 = 1e9;
/// How far sampling rates may differ, relative to them: windows are cut by the common one.
pub const RATE_TOLERANCE: f64 = 0.05;

/// What was read of a folder.
pub struct Recordings {
    /// The classes' names: those that were given, then others in alphabetical order.
    pub labels: Vec<String>,
    /// The channels' names.
    pub channels: Vec<String>,
    /// Sampling rate, rounded to four digits.
    pub rate_hz: f64,
    /// The recordings in the order of the list.
    pub all: Vec<Recording>,
}

/// A row of `recordings.csv`.
struct Listed {
    file: String,
    class: String,
    run: String,
    /// Of a sound file: what full scale means, in the channels' unit.
    scale: f64,
    /// Of a sound file: the channels' names.
    channels: Vec<String>,
}

/// Columns of one file.
struct Columns {
    names: Vec<String>,
    taken_ns: Vec<u64>,
    samples: Vec<Vec<f64>>,
}

/// Reads the recordings of a folder. `channels` chooses some: names, or beginnings of names with a `*` behind; none are
/// all but the speed. `labels` come first among the classes.
pub fn read(
    folder: &Path,
    channels: &[String],
    labels: &[String],
    progress: &mut dyn FnMut(&'static str, f64),
) -> Result<Recordings, Error> {
    let list = read_list(folder)?;
    let mut labels = labels.to_vec();
    let mut others: Vec<&String> = list.iter().map(|row| &row.class).collect();
    others.sort_unstable();
    others.dedup();
    others.retain(|class| !labels.contains(class));
    let others: Vec<String> = others.into_iter().cloned().collect();
    labels.extend(others);
    let mut chosen: Vec<String> = Vec::new();
    let (mut all, mut rates) = (Vec::new(), Vec::new());
    for (index, row) in list.iter().enumerate() {
        progress("reading", index as f64 / list.len() as f64);
        let columns = read_file(folder, row)?;
        if chosen.is_empty() {
            chosen = choose(&columns.names, channels).map_err(|what| fault(folder, &row.file, &what))?;
        }
        if let Some(period_ns) = sampling_period_ns(&columns.taken_ns) {
            rates.push((1e9 / period_ns, row.file.clone()));
        }
        all.push(recording(row, &labels, &chosen, columns).map_err(|what| fault(folder, &row.file, &what))?);
    }
    let rate_hz = common_rate(rates).map_err(|what| fault(folder, "recordings.csv", &what))?;
    Ok(Recordings {
        labels,
        channels: chosen,
        rate_hz,
        all,
    })
}

fn fault(folder: &Path, file: &str, what: &str) -> Error {
    Error::data(format!("{}: {what}", folder.join(file).display()))
}

fn open(path: &Path) -> Result<Table, Error> {
    let name = path.display().to_string();
    let file = File::open(path).map_err(|error| {
        let what = "recordings.csv must list the folder's recordings, one a row: file,class,run";
        Error::data(format!("{name}: {error}; {what}"))
    })?;
    Table::open(&name, Box::new(file)).map_err(|error| Error::data(error.to_string()))
}

fn read_list(folder: &Path) -> Result<Vec<Listed>, Error> {
    let mut table = open(&folder.join("recordings.csv"))?;
    let column = |name: &str| table.names().iter().position(|other| other == name);
    let needed = |name: &str| {
        let what = format!("column {name:?} is missing; the columns are file,class,run[,scale,channels]");
        column(name).ok_or_else(|| Error::data(table.fault(what).to_string()))
    };
    let (file, class, run) = (needed("file")?, needed("class")?, needed("run")?);
    let (scale, channels) = (column("scale"), column("channels"));
    let data = |error: traverse::InputError| Error::data(error.to_string());
    let mut list = Vec::new();
    while table.next_row().map_err(data)? {
        let text = |column: usize| table.text(column).to_owned();
        for (column, name) in [(file, "file"), (class, "class"), (run, "run")] {
            if text(column).is_empty() {
                return Err(data(table.fault(format!("{name} is empty"))));
            }
        }
        let scale = match scale {
            Some(column) => table.number(column, 1e-12..=SAMPLE_MAX).map_err(data)?,
            None => f64::NAN,
        };
        list.push(Listed {
            file: text(file),
            class: text(class),
            run: text(run),
            scale: if scale.is_nan() { 1.0 } else { scale },
            channels: channels
                .map(|column| text(column).split_whitespace().map(str::to_owned).collect())
                .unwrap_or_default(),
        });
    }
    Ok(list)
}

/// The channels to use, of those that a file offers.
fn choose(offered: &[String], wanted: &[String]) -> Result<Vec<String>, String> {
    if wanted.is_empty() {
        return Ok(offered.iter().filter(|name| *name != SPEED_CHANNEL).cloned().collect());
    }
    let mut chosen: Vec<String> = Vec::new();
    for pattern in wanted {
        let fits = |name: &String| match pattern.strip_suffix('*') {
            Some(beginning) => name.starts_with(beginning),
            None => name == pattern,
        };
        let fitting: Vec<String> = offered.iter().filter(|name| fits(name)).cloned().collect();
        if fitting.is_empty() {
            return Err(format!("no channel {pattern}; there are {}", offered.join(", ")));
        }
        for name in fitting {
            if !chosen.contains(&name) {
                chosen.push(name);
            }
        }
    }
    Ok(chosen)
}

fn recording(row: &Listed, labels: &[String], chosen: &[String], mut columns: Columns) -> Result<Recording, String> {
    let mut channels = Vec::new();
    for name in chosen {
        let Some(place) = columns.names.iter().position(|other| other == name) else {
            return Err(format!(
                "no channel {name}, which other recordings have; there are {}",
                columns.names.join(", ")
            ));
        };
        channels.push(columns.samples[place].clone());
    }
    let speed = columns.names.iter().position(|name| name == SPEED_CHANNEL);
    Ok(Recording {
        run: row.run.clone(),
        class: labels
            .iter()
            .position(|label| *label == row.class)
            .unwrap_or(labels.len()),
        channels,
        speed_m_s: speed
            .map(|place| std::mem::take(&mut columns.samples[place]))
            .unwrap_or_default(),
        taken_ns: columns.taken_ns,
    })
}

fn read_file(folder: &Path, row: &Listed) -> Result<Columns, Error> {
    let path = folder.join(&row.file);
    if row.file.to_ascii_lowercase().ends_with(".wav") {
        read_sound(&path, row).map_err(|what| fault(folder, &row.file, &what))
    } else {
        read_table(&path)
    }
}

fn read_table(path: &Path) -> Result<Columns, Error> {
    let mut table = open(path)?;
    let data = |error: traverse::InputError| Error::data(error.to_string());
    let Some(time) = table.names().iter().position(|name| name == "taken_s") else {
        let what = "column \"taken_s\" is missing; the others are the channels, unit in the name";
        return Err(data(table.fault(what)));
    };
    let places: Vec<usize> = (0..table.names().len()).filter(|place| *place != time).collect();
    let mut columns = Columns {
        names: places.iter().map(|place| table.names()[*place].clone()).collect(),
        taken_ns: Vec::new(),
        samples: vec![Vec::new(); places.len()],
    };
    while table.next_row().map_err(data)? {
        columns.taken_ns.push(table.taken_ns(time).map_err(data)?);
        for (samples, place) in columns.samples.iter_mut().zip(&places) {
            samples.push(table.number(*place, -SAMPLE_MAX..=SAMPLE_MAX).map_err(data)?);
        }
    }
    Ok(columns)
}

fn read_sound(path: &Path, row: &Listed) -> Result<Columns, String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let reader = WavReader::new(BufReader::new(file))
        .map_err(|error| format!("not a sound WAV file: {error}; write it as PCM or float"))?;
    let spec = reader.spec();
    let count = usize::from(spec.channels);
    let names = match (&row.channels, count) {
        (names, _) if !names.is_empty() => names.clone(),
        (_, 1) => vec![SOUND_CHANNELS[2].into()],
        (_, 3 | 6) => SOUND_CHANNELS[..count].iter().map(|name| (*name).into()).collect(),
        _ => Vec::new(),
    };
    if names.len() != count || spec.sample_rate == 0 {
        return Err(format!(
            "has {count} channels at {} Hz; name the channels in recordings.csv, column channels, blanks between them",
            spec.sample_rate
        ));
    }
    let damaged = |error: hound::Error| format!("is damaged: {error}; copy it again from its source");
    let values: Result<Vec<f64>, hound::Error> = match spec.sample_format {
        SampleFormat::Float => reader.into_samples::<f32>().map(|value| value.map(f64::from)).collect(),
        SampleFormat::Int => {
            let full_scale = 2_f64.powi(i32::from(spec.bits_per_sample) - 1);
            let samples = reader.into_samples::<i32>();
            samples
                .map(|value| value.map(|value| f64::from(value) / full_scale))
                .collect()
        }
    };
    let values = values.map_err(damaged)?;
    let rows = values.len() / count;
    let period_ns = 1e9 / f64::from(spec.sample_rate);
    let channel = |place: usize| values.iter().skip(place).step_by(count).map(|value| value * row.scale);
    Ok(Columns {
        taken_ns: (0..rows)
            .map(|index| (index as f64 * period_ns).round() as u64)
            .collect(),
        samples: (0..count).map(|place| channel(place).take(rows).collect()).collect(),
        names,
    })
}

/// The rate of all recordings: the median, rounded to four digits.
fn common_rate(mut rates: Vec<(f64, String)>) -> Result<f64, String> {
    rates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (Some(first), Some(last)) = (rates.first(), rates.last()) else {
        return Err("no recording has two samples".into());
    };
    let median_hz = rates[rates.len() / 2].0;
    for (rate_hz, file) in [first, last] {
        if (rate_hz - median_hz).abs() > RATE_TOLERANCE * median_hz {
            return Err(format!(
                "{file} was sampled at {rate_hz:.3} Hz, other recordings at {median_hz:.3} Hz; resample them to one rate"
            ));
        }
    }
    Ok(format!("{median_hz:.3e}").parse().unwrap_or(median_hz))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_chosen_by_name_or_by_how_they_begin() {
        let names = [
            "acceleration_x_m_s2",
            "acceleration_z_m_s2",
            "motor_current_a",
            SPEED_CHANNEL,
        ]
        .map(str::to_owned);
        let chosen = |wanted: &[&str]| {
            choose(
                &names,
                &wanted.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>(),
            )
        };
        assert_eq!(chosen(&[]), Ok(names[..3].to_vec()));
        assert_eq!(
            chosen(&["acceleration_*", "acceleration_z_m_s2"]),
            Ok(names[..2].to_vec())
        );
        assert_eq!(chosen(&[SPEED_CHANNEL]), Ok(names[3..].to_vec()));
        assert!(chosen(&["sound_pa"]).is_err());
    }
}
