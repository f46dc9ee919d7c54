//! How far a candidate's answers agree with the incumbent's, cycle by cycle. Pure.

use messages::{Field, Header, Kind, Status};
use serde::{Deserialize, Serialize};
use shell::Port;
use std::collections::BTreeMap;

/// Answers of one side that wait for those of the other at the most.
const WAITING_MAX: usize = 1024;

/// The comparison of two writers of one wire.
#[derive(Debug)]
pub struct Comparison {
    fields: Vec<(&'static Field, Difference)>,
    incumbent: BTreeMap<u64, Vec<u8>>,
    candidate: BTreeMap<u64, Vec<u8>>,
    /// The candidate's first and latest cycle.
    answered: Option<(u64, u64)>,
    counts: Counts,
}

/// What was counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Cycles that both have answered.
    pub cycles: u64,
    /// Of these, those in which both say the same status.
    pub same_status: u64,
    /// Cycles that the incumbent has answered and the candidate has left out.
    pub missed: u64,
    /// Answers of the candidate that came twice or out of order.
    pub unordered: u64,
    /// Answers of the candidate with a status that has no meaning.
    pub bad: u64,
}

/// One field of the answers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// Cycles in which both have a value.
    pub cycles: u64,
    /// Mean of the incumbent's values.
    pub incumbent_mean: f64,
    /// Mean of the candidate's values.
    pub candidate_mean: f64,
    /// Root of the mean squared difference.
    pub rms: f64,
    /// Greatest difference.
    pub largest: f64,
}

impl Comparison {
    /// Of samples that travel through `port`.
    #[must_use]
    pub fn new(port: Port) -> Self {
        let is_number = |field: &&Field| field.count == 1 && matches!(field.kind, Kind::F64 | Kind::F32 | Kind::U32);
        Self {
            fields: port
                .fields()
                .iter()
                .filter(is_number)
                .map(|field| (field, Difference::default()))
                .collect(),
            incumbent: BTreeMap::new(),
            candidate: BTreeMap::new(),
            answered: None,
            counts: Counts::default(),
        }
    }

    /// What was counted so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// What was found so far, by the fields' names.
    #[must_use]
    pub fn differences(&self) -> Vec<(String, Difference)> {
        let finished = |difference: &Difference| {
            let count = difference.cycles.max(1) as f64;
            Difference {
                incumbent_mean: difference.incumbent_mean / count,
                candidate_mean: difference.candidate_mean / count,
                rms: (difference.rms / count).sqrt(),
                ..*difference
            }
        };
        self.fields
            .iter()
            .map(|(field, difference)| (field.name.to_owned(), finished(difference)))
            .collect()
    }

    /// Takes in an answer of the incumbent.
    pub fn see_incumbent(&mut self, header: &Header, bytes: &[u8]) {
        match self.candidate.remove(&header.sequence) {
            Some(candidate) => self.compare(bytes, &candidate),
            None => keep(&mut self.incumbent, header, bytes),
        }
    }

    /// Takes in an answer of the candidate.
    pub fn see_candidate(&mut self, header: &Header, bytes: &[u8]) {
        let (first, last) = self.answered.unwrap_or((header.sequence, header.sequence));
        self.counts.bad += u64::from(header.status.word().is_none());
        if self.answered.is_some() && header.sequence <= last {
            self.counts.unordered += 1;
            return;
        }
        self.answered = Some((first, header.sequence));
        // It answers in order: what lies before this answer will not be answered any more.
        let later = self.incumbent.split_off(&header.sequence);
        self.counts.missed += self.incumbent.range(first..).count() as u64;
        self.incumbent = later;
        match self.incumbent.remove(&header.sequence) {
            Some(incumbent) => self.compare(&incumbent, bytes),
            None => keep(&mut self.candidate, header, bytes),
        }
    }

    fn compare(&mut self, incumbent: &[u8], candidate: &[u8]) {
        self.counts.cycles += 1;
        let status = |bytes| number(bytes, STATUS);
        self.counts.same_status += u64::from(status(incumbent) == status(candidate));
        for (field, difference) in &mut self.fields {
            let (Some(a), Some(b)) = (number(incumbent, field), number(candidate, field)) else {
                continue;
            };
            if a.is_finite() && b.is_finite() {
                difference.cycles += 1;
                difference.incumbent_mean += a;
                difference.candidate_mean += b;
                difference.rms += (a - b) * (a - b);
                difference.largest = difference.largest.max((a - b).abs());
            }
        }
    }
}

/// Where a header's status is.
const STATUS: &Field = &Field::new("status", std::mem::offset_of!(Header, status), Kind::U32);

fn keep(waiting: &mut BTreeMap<u64, Vec<u8>>, header: &Header, bytes: &[u8]) {
    if header.status == Status::ENDED {
        return;
    }
    if waiting.len() == WAITING_MAX {
        waiting.pop_first();
    }
    waiting.insert(header.sequence, bytes.to_vec());
}

fn number(bytes: &[u8], field: &Field) -> Option<f64> {
    let bytes = bytes.get(field.offset..field.offset + field.kind.size())?;
    match field.kind {
        Kind::F64 => bytes.try_into().ok().map(f64::from_ne_bytes),
        Kind::F32 => bytes.try_into().ok().map(|bytes| f64::from(f32::from_ne_bytes(bytes))),
        Kind::U32 => bytes.try_into().ok().map(|bytes| f64::from(u32::from_ne_bytes(bytes))),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Message, Sinkage};
    use zerocopy::IntoBytes;

    fn sinkage(sequence: u64, left_rad: f64) -> Sinkage {
        let mut sample = Sinkage::unknown(Header {
            sequence,
            status: Status::OK,
            ..Header::default()
        });
        sample.left_rad = left_rad;
        sample
    }

    fn compared(incumbent: &[(u64, f64)], candidate: &[(u64, f64)]) -> Comparison {
        let mut comparison = Comparison::new(Port::Sinkage);
        for (sequence, left_rad) in incumbent {
            let sample = sinkage(*sequence, *left_rad);
            comparison.see_incumbent(sample.header(), sample.as_bytes());
        }
        for (sequence, left_rad) in candidate {
            let sample = sinkage(*sequence, *left_rad);
            comparison.see_candidate(sample.header(), sample.as_bytes());
        }
        comparison
    }

    #[test]
    fn fields_are_compared_cycle_by_cycle() {
        let comparison = compared(&[(1, 0.5), (2, 0.5), (3, 0.5)], &[(2, 0.8), (3, 0.9), (4, 0.1)]);
        assert_eq!(
            comparison.counts(),
            Counts {
                cycles: 2,
                same_status: 2,
                ..Counts::default()
            }
        );
        let differences = comparison.differences();
        let (_, left) = differences.iter().find(|(name, _)| name == "left_rad").unwrap();
        assert!((left.rms - ((0.09_f64 + 0.16) / 2.0).sqrt()).abs() < 1e-12 && (left.largest - 0.4).abs() < 1e-12);
        assert!((left.candidate_mean - 0.85).abs() < 1e-12);
        let (_, right) = differences.iter().find(|(name, _)| name == "right_rad").unwrap();
        assert_eq!(right.cycles, 0, "nobody has a value");
    }

    #[test]
    fn what_the_candidate_leaves_out_or_says_twice_is_counted() {
        let incumbent: Vec<(u64, f64)> = (1..=6).map(|sequence| (sequence, 0.0)).collect();
        let counts = compared(&incumbent, &[(2, 0.0), (5, 0.0), (5, 0.0), (4, 0.0), (6, 0.0)]).counts();
        assert_eq!((counts.cycles, counts.missed, counts.unordered), (3, 2, 2));
    }
}
