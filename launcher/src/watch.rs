//! What the launcher sees on one wire: how fast it is, what is missing, how long an answer took.

use hdrhistogram::Histogram;
use messages::{Header, Status};
use std::collections::VecDeque;

/// Cycles whose instants are remembered, to find the sample that triggered an answer.
const CYCLES_REMEMBERED: usize = 1024;
/// Latencies the percentiles are taken over.
const LATENCIES_REMEMBERED: usize = 1024;
/// Longer latencies count as this one [ns].
pub const LATENCY_MAX_NS: u64 = 3_600_000_000_000;
/// Time the rate is taken over [ns].
const RATE_SPAN_NS: u64 = 2_000_000_000;

/// A number follows another if it is greater by no more.
const FOLLOWING_MAX: u64 = CYCLES_REMEMBERED as u64;

/// The counters of one wire.
#[derive(Debug)]
pub struct Watch {
    /// Samples seen.
    pub published: u64,
    /// Cycles missing between the first and the last sample, as their numbers tell.
    pub lost: u64,
    /// Samples that answer an input which could not be used.
    pub bad: u64,
    /// Cycles that were later than their deadline with a sample of this wire, and not before; see [`crate::deadline`].
    pub missed: u64,
    /// The recording is over.
    pub ended: bool,
    /// When the last sample was sent; 0 before the first.
    pub last_ns: u64,
    /// The start of its writer, as the last sample tells.
    pub generation: u32,
    /// When the first sample was sent that nobody has answered yet, by the answering wire's watch; see [`Watch::answered`].
    sent: Vec<(u64, u64)>,
    arrivals: VecDeque<u64>,
    latencies: VecDeque<u64>,
    /// The greatest number so far, the last one, and the newest that is believed; see [`Watch::newest`].
    sequence: Option<u64>,
    last: Option<u64>,
    newest: Option<u64>,
}

impl Default for Watch {
    fn default() -> Self {
        Self {
            published: 0,
            lost: 0,
            bad: 0,
            missed: 0,
            ended: false,
            last_ns: 0,
            generation: 0,
            sent: vec![(u64::MAX, 0); CYCLES_REMEMBERED],
            arrivals: VecDeque::with_capacity(CYCLES_REMEMBERED),
            latencies: VecDeque::with_capacity(LATENCIES_REMEMBERED),
            sequence: None,
            last: None,
            newest: None,
        }
    }
}

impl Watch {
    /// Counts a sample; `trigger` is the watch of the wire that triggered it.
    pub fn see(&mut self, header: &Header, trigger: Option<&Self>) {
        if header.status == Status::ENDED {
            self.ended = true;
            return;
        }
        self.published += 1;
        self.bad += u64::from(header.status == Status::INPUT_REJECTED || header.status == Status::BAD_SAMPLE);
        if let Some(last) = self.sequence {
            self.lost += header
                .sequence
                .saturating_sub(last)
                .saturating_sub(1)
                .min(u64::from(u32::MAX));
        }
        self.sequence = Some(self.sequence.unwrap_or(0).max(header.sequence));
        let follows = |before: u64| (1..=FOLLOWING_MAX).contains(&header.sequence.wrapping_sub(before));
        if self.newest.is_none_or(follows) || self.last.is_some_and(follows) {
            self.newest = Some(header.sequence);
        }
        self.last = Some(header.sequence);
        self.last_ns = header.published_ns;
        self.generation = header.generation;
        self.sent[place(header.sequence)] = (header.sequence, header.published_ns);
        if self.arrivals.len() == CYCLES_REMEMBERED {
            self.arrivals.pop_front();
        }
        self.arrivals.push_back(header.published_ns);
        if let Some(sent_ns) = trigger.and_then(|trigger| trigger.sent_ns(header.sequence)) {
            if self.latencies.len() == LATENCIES_REMEMBERED {
                self.latencies.pop_front();
            }
            self.latencies.push_back(header.published_ns.saturating_sub(sent_ns));
        }
    }

    /// The newest number that follows the one before, or the newest before it: anybody may write one number that leads
    /// nowhere, and a source may number anew.
    #[must_use]
    pub fn newest(&self) -> Option<u64> {
        self.newest
    }

    /// When the sample of this number was sent, if it is remembered.
    #[must_use]
    pub fn sent_ns(&self, sequence: u64) -> Option<u64> {
        let (remembered, sent_ns) = self.sent[place(sequence)];
        (remembered == sequence).then_some(sent_ns)
    }

    /// The first instant after `since_ns` at which a sample was sent: since then an answer has been due.
    #[must_use]
    pub fn first_after(&self, since_ns: u64) -> Option<u64> {
        let later = self.arrivals.partition_point(|at| *at <= since_ns);
        self.arrivals.get(later).copied()
    }

    /// Samples per second over the last two seconds.
    #[must_use]
    pub fn rate_hz(&self, now_ns: u64) -> f64 {
        let first = self
            .arrivals
            .partition_point(|at| now_ns.saturating_sub(*at) > RATE_SPAN_NS);
        let recent = self.arrivals.len() - first;
        let Some(oldest) = self.arrivals.get(first) else {
            return 0.0;
        };
        let span_s = now_ns.saturating_sub(*oldest) as f64 * 1e-9;
        if recent < 2 || span_s <= 0.0 {
            0.0
        } else {
            (recent - 1) as f64 / span_s
        }
    }

    /// The latencies of the last cycles [ns], from the triggering sample to the answer.
    #[must_use]
    pub fn latencies(&self) -> Histogram<u64> {
        let mut histogram =
            Histogram::new_with_bounds(1, LATENCY_MAX_NS, 3).unwrap_or_else(|_| unreachable!("the bounds are right"));
        for latency in &self.latencies {
            histogram.saturating_record((*latency).max(1));
        }
        histogram
    }
}

fn place(sequence: u64) -> usize {
    usize::try_from(sequence % CYCLES_REMEMBERED as u64).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(sequence: u64, published_ns: u64) -> Header {
        Header {
            sequence,
            published_ns,
            ..Header::default()
        }
    }

    #[test]
    fn a_gap_in_the_numbers_is_lost_cycles() {
        let mut watch = Watch::default();
        for sequence in [0, 1, 4, 5] {
            watch.see(&header(sequence, sequence), None);
        }
        assert_eq!((watch.published, watch.lost), (4, 2));
    }

    #[test]
    fn the_newest_number_is_one_that_leads_on() {
        let newest = |sequences: &[u64]| {
            let mut watch = Watch::default();
            for sequence in sequences {
                watch.see(&header(*sequence, 0), None);
            }
            watch.newest()
        };
        assert_eq!(newest(&[]), None);
        assert_eq!(newest(&[7]), Some(7));
        assert_eq!(newest(&[7, 8, 11, 10]), Some(11), "cycles left out, and one overtaken");
        assert_eq!(newest(&[7, 8, u64::MAX - 1]), Some(8), "a number from nowhere");
        assert_eq!(newest(&[7, 8, u64::MAX - 1, 9]), Some(9));
        assert_eq!(newest(&[u64::MAX - 1, 7, 8]), Some(8), "the first one as well");
        assert_eq!(newest(&[7, 8, u64::MAX - 1, u64::MAX, 9, 10]), Some(10), "and two");
        assert_eq!(newest(&[70_000, 70_001, 0, 1]), Some(1), "numbered anew");
        assert_eq!(newest(&[7, 8, 70_000, 70_001]), Some(70_001), "after a long pause");
    }

    #[test]
    fn latency_is_from_the_trigger_to_the_answer_of_the_same_number() {
        let (mut frames, mut sinkage) = (Watch::default(), Watch::default());
        for sequence in 0..100 {
            frames.see(&header(sequence, 1000 * sequence), None);
            sinkage.see(&header(sequence, 1000 * sequence + 5 + sequence), Some(&frames));
        }
        assert_eq!(sinkage.latencies().max(), 104);
        assert_eq!(sinkage.latencies().min(), 5);
    }

    #[test]
    fn an_answer_is_due_from_the_first_input_after_the_last_answer() {
        let mut frames = Watch::default();
        for sequence in 0..10 {
            frames.see(&header(sequence, 100 * sequence), None);
        }
        assert_eq!(frames.first_after(350), Some(400));
        assert_eq!(frames.first_after(900), None);
    }

    #[test]
    fn the_rate_is_over_the_last_two_seconds() {
        let mut watch = Watch::default();
        for sequence in 0..300 {
            watch.see(&header(sequence, sequence * 100_000_000), None);
        }
        assert!((watch.rate_hz(29_900_000_000) - 10.0).abs() < 0.5);
        assert_eq!(watch.rate_hz(99_000_000_000), 0.0);
    }
}
