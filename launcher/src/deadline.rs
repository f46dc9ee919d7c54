//! Which cycles take longer than they may, and which stage is charged with it.

use messages::Header;

/// Cycles of a chain that are remembered.
const CYCLES_REMEMBERED: usize = 1024;

/// The cycles of one chain of stages: each begins with a sample of the chain's first wire, and goes on with one of each wire
/// behind it.
#[derive(Debug)]
pub struct Cycles {
    deadline_ns: u64,
    begun: Vec<Cycle>,
}

#[derive(Clone, Copy, Debug)]
struct Cycle {
    sequence: u64,
    begun_ns: u64,
    missed: bool,
}

impl Cycles {
    /// Cycles that are to end within a time after they have begun.
    #[must_use]
    pub fn new(deadline_ns: u64) -> Self {
        let none = Cycle {
            sequence: u64::MAX,
            begun_ns: 0,
            missed: true,
        };
        Self {
            deadline_ns,
            begun: vec![none; CYCLES_REMEMBERED],
        }
    }

    /// Takes in a sample of the chain's first wire: a cycle begins.
    pub fn begin(&mut self, header: &Header) {
        *self.place(header.sequence) = Cycle {
            sequence: header.sequence,
            begun_ns: header.published_ns,
            missed: false,
        };
    }

    /// Takes in a stage's sample: how old its cycle is [ns], if that is too old and was not before. A cycle that is not
    /// remembered is charged to nobody.
    pub fn miss(&mut self, header: &Header) -> Option<u64> {
        let deadline_ns = self.deadline_ns;
        let cycle = self.place(header.sequence);
        let age_ns = header.published_ns.saturating_sub(cycle.begun_ns);
        let missed = cycle.sequence == header.sequence && !cycle.missed && age_ns > deadline_ns;
        cycle.missed |= missed;
        missed.then_some(age_ns)
    }

    fn place(&mut self, sequence: u64) -> &mut Cycle {
        let place = usize::try_from(sequence % CYCLES_REMEMBERED as u64).unwrap_or(0);
        &mut self.begun[place]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(sequence: u64, published_ns: u64) -> Header {
        Header {
            sequence,
            published_ns,
            ..Header::default()
        }
    }

    /// How old a cycle is at each stage that is charged, if it begins at 1000 and may take 50.
    fn charged(published_ns: &[u64]) -> Vec<Option<u64>> {
        let mut cycles = Cycles::new(50);
        cycles.begin(&sample(7, 1000));
        published_ns.iter().map(|at| cycles.miss(&sample(7, *at))).collect()
    }

    #[test]
    fn a_cycle_within_its_deadline_is_charged_to_nobody() {
        assert_eq!(charged(&[1010, 1049, 1050]), [None, None, None]);
    }

    #[test]
    fn a_late_cycle_is_charged_once_to_the_stage_at_which_it_became_late() {
        assert_eq!(charged(&[1051, 1052, 1053]), [Some(51), None, None]);
        assert_eq!(charged(&[1010, 2000, 2001]), [None, Some(1000), None]);
        assert_eq!(charged(&[1010, 1020, 1051]), [None, None, Some(51)]);
    }

    #[test]
    fn each_cycle_has_a_deadline_of_its_own() {
        let mut cycles = Cycles::new(50);
        for sequence in 0..3 {
            cycles.begin(&sample(sequence, 10 * sequence));
        }
        let charged = [0, 1, 2].map(|sequence| cycles.miss(&sample(sequence, 60)));
        assert_eq!(charged, [Some(60), None, None]);
    }

    #[test]
    fn a_cycle_whose_beginning_was_not_seen_or_is_forgotten_is_charged_to_nobody() {
        let mut cycles = Cycles::new(50);
        assert_eq!(cycles.miss(&sample(0, 1_000_000)), None);
        assert_eq!(cycles.miss(&sample(u64::MAX, 1_000_000)), None);
        for sequence in 0..=CYCLES_REMEMBERED as u64 {
            cycles.begin(&sample(sequence, 0));
        }
        assert_eq!(cycles.miss(&sample(0, 1_000_000)), None);
        assert_eq!(cycles.miss(&sample(1, 1_000_000)), Some(1_000_000));
    }

    #[test]
    fn a_source_that_numbers_anew_begins_its_cycles_anew() {
        let mut cycles = Cycles::new(50);
        cycles.begin(&sample(3, 100));
        assert_eq!(cycles.miss(&sample(3, 200)), Some(100));
        cycles.begin(&sample(3, 10_000));
        assert_eq!(cycles.miss(&sample(3, 10_020)), None);
        assert_eq!(cycles.miss(&sample(3, 10_060)), Some(60));
    }

    #[test]
    fn stamps_that_go_backwards_are_no_miss() {
        assert_eq!(charged(&[10]), [None]);
    }
}
