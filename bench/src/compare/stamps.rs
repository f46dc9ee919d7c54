//! When each sample was published, by cycle, as each process has noted it.

use crate::Outcome;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// Where a stamp is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Point {
    /// The picture is complete where the middleware sends from.
    Frame,
    /// The sinkage is about to be sent.
    Sinkage,
    /// The soil is.
    Soil,
    /// The terrain is.
    Terrain,
}

impl Point {
    const ALL: [Self; 4] = [Self::Frame, Self::Sinkage, Self::Soil, Self::Terrain];
}

/// What is timed: its name, from where, to where.
pub const SPANS: [(&str, Point, Point); 4] = [
    ("frame to terrain", Point::Frame, Point::Terrain),
    ("frame to sinkage", Point::Frame, Point::Sinkage),
    ("sinkage to soil", Point::Sinkage, Point::Soil),
    ("soil to terrain", Point::Soil, Point::Terrain),
];

/// The stamps of a run.
#[derive(Clone, Debug, Default)]
pub struct Stamps {
    points: [BTreeMap<u64, u64>; 4],
}

impl Stamps {
    /// Notes when [ns] the sample of this number was published.
    pub fn note(&mut self, point: Point, sequence: u64, published_ns: u64) {
        self.points[point as usize].insert(sequence, published_ns);
    }

    /// The cycles whose frame was counted.
    #[must_use]
    pub fn cycles(&self) -> usize {
        self.points[Point::Frame as usize].len()
    }

    /// Those without a terrain.
    #[must_use]
    pub fn lost(&self) -> usize {
        let [frames, .., terrain] = &self.points;
        frames.keys().filter(|cycle| !terrain.contains_key(cycle)).count()
    }

    /// How long each counted cycle took from one point to the other [ns].
    pub fn times_ns(&self, from: Point, to: Point) -> impl Iterator<Item = u64> {
        let counted = self.points[Point::Frame as usize].keys();
        counted.filter_map(move |cycle| {
            let at = |point: Point| self.points[point as usize].get(cycle);
            Some(at(to)?.saturating_sub(*at(from)?))
        })
    }

    /// Writes them; the file is there as a whole or not at all.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write(&self, path: &Path) -> Outcome<()> {
        let mut text = String::new();
        for (point, stamps) in self.points.iter().enumerate() {
            for (sequence, published_ns) in stamps {
                writeln!(text, "{point} {sequence} {published_ns}")?;
            }
        }
        let unfinished = path.with_extension("unfinished");
        std::fs::write(&unfinished, text)?;
        Ok(std::fs::rename(unfinished, path)?)
    }

    /// Adds what another process has written.
    ///
    /// # Errors
    /// There is no such file, or it holds something else.
    pub fn read(&mut self, path: &Path) -> Outcome<()> {
        let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
        for line in text.lines() {
            let numbers: Vec<u64> = line.split(' ').map(str::parse).collect::<Result<_, _>>()?;
            let [point, sequence, published_ns] = numbers[..] else {
                return Err(format!("{}: {line}: is no stamp", path.display()).into());
            };
            let point = Point::ALL.get(usize::try_from(point)?).ok_or("no such point")?;
            self.note(*point, sequence, published_ns);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_put_together_from_what_each_process_has_noted() {
        let folder = tempfile::tempdir().unwrap();
        let (mut source, mut stage, mut all) = (Stamps::default(), Stamps::default(), Stamps::default());
        for cycle in 1..=3 {
            source.note(Point::Frame, cycle, 1000 * cycle);
            stage.note(Point::Sinkage, cycle - 1, 1000 * (cycle - 1) + 300);
        }
        source.note(Point::Terrain, 1, 1900);
        source.note(Point::Terrain, 3, 3800);
        source.write(&folder.path().join("source")).unwrap();
        stage.write(&folder.path().join("stage")).unwrap();
        all.read(&folder.path().join("source")).unwrap();
        all.read(&folder.path().join("stage")).unwrap();
        assert_eq!((all.cycles(), all.lost()), (3, 1));
        let times = |from, to| all.times_ns(from, to).collect::<Vec<_>>();
        assert_eq!(times(Point::Frame, Point::Terrain), [900, 800]);
        assert_eq!(times(Point::Frame, Point::Sinkage), [300, 300]);
    }
}
