//! Has the soil changed? Two soils against one, by the evidence of the rows in the window.

use crate::cost::Cost;
use crate::model::Prior;
use crate::regression::{BLOCK_ROWS, EARLIER_MAX, Regression};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Logarithm of the odds at which two soils are believed rather than one.
const LN_ODDS_MIN: f64 = 12.0;
/// Logarithm of the odds at which this soil is believed to be an earlier one, and the rows that it takes.
const LN_ODDS_SAME: f64 = 5.0;
const RECALL_ROWS_MIN: f64 = 24.0;
/// Blocks on either side of a change that is looked for.
const BLOCKS_BEFORE_MIN: u64 = 2;
const BLOCKS_AFTER_MIN: u64 = 2;
const BLOCKS_AFTER_MAX: u64 = 8;
/// Of this many newest rows …
const HISTORY_ROWS: u32 = 20;
/// … so many must be far off for the soil to have changed under the estimate at once.
const FAR_OFF_MIN: u32 = 14;

/// What the detection remembers from row to row.
#[derive(Clone, Copy, Debug, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct ChangeDetector {
    /// One bit a row, the newest lowest: was it far off?
    history: u64,
    /// Which split of the window is looked at next.
    candidate: u64,
}

impl ChangeDetector {
    /// Notes whether a row was far off; true if by now most are.
    pub(crate) fn note(&mut self, far_off: bool) -> bool {
        self.history = (self.history << 1 | u64::from(far_off)) & ((1 << HISTORY_ROWS) - 1);
        self.history.count_ones() >= FAR_OFF_MIN
    }

    /// Forgets the rows noted.
    pub(crate) fn forget(&mut self) {
        self.history = 0;
    }

    /// The block from which on the rows are of another soil. One split is looked at a step.
    pub(crate) fn split(&mut self, regression: &Regression, prior: &Prior) -> Option<u64> {
        let blocks = regression.blocks();
        self.candidate = self.candidate.wrapping_add(1) % (BLOCKS_AFTER_MAX - BLOCKS_AFTER_MIN + 1);
        let split = blocks.end.checked_sub(BLOCKS_AFTER_MIN + self.candidate)?;
        if split < blocks.start + BLOCKS_BEFORE_MIN {
            return None;
        }
        let (before, after) = regression.split(split);
        if after.rows < ((BLOCKS_AFTER_MIN - 1) * BLOCK_ROWS) as f64 {
            return None;
        }
        (ln_odds(&before, &after, regression.scatter, prior)? > LN_ODDS_MIN).then_some(split)
    }

    /// Which earlier soil the present one is, if the rows say so. One is looked at a step.
    pub(crate) fn earlier(&self, regression: &Regression, prior: &Prior) -> Option<usize> {
        let which = self.candidate as usize % EARLIER_MAX;
        let earlier = regression.earlier(which)?;
        let present = regression.sum();
        let is_enough = present.rows >= RECALL_ROWS_MIN;
        (is_enough && ln_odds(earlier, &present, regression.scatter, prior)? < -LN_ODDS_SAME).then_some(which)
    }
}

/// Logarithm of the odds of two soils against one, for rows before and after: the ratio of the integrals of the likelihood
/// over the parameters, which are Gaussian in the linearised model.
fn ln_odds(before: &Cost, after: &Cost, scatter: f64, prior: &Prior) -> Option<f64> {
    let mut all = *before;
    all.add(after);
    let ln_evidence = |rows: &Cost| {
        let mut cost = rows.scaled(1.0 / scatter);
        cost.add(&prior.cost);
        let (least, ln_determinant) = cost.least()?;
        Some(-0.5 * (least + ln_determinant))
    };
    Some(ln_evidence(before)? + ln_evidence(after)? - ln_evidence(&all)? - prior.ln_volume())
}
