//! Orthogonal-distance regression of the soil's parameters over a window of rows, kept up row by row.
//!
//! Load, torque, entry angle and slip are all measured with error: least squares on the measured entry angle and slip would be
//! biased, so each row has latent ones. Blocks of rows keep the sum of their linearised costs. Every step adds the newest row,
//! linearises a few blocks anew at the present parameters, and solves: so the solution converges to that of the whole window, at
//! constant cost per step, and there is no filter to start or to diverge.

use crate::Row;
use crate::cost::{Cost, Matrix, Posterior};
use crate::model::{Model, Prior};
use crate::orthogonal_distance::Tracked;
use crate::stresses::{Contact, STIFFNESS, TORQUE_OFFSET};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Rows whose costs are kept as one sum.
pub(crate) const BLOCK_ROWS: u64 = 8;
/// Blocks in the window. An older one is no longer linearised anew, and fades.
const BLOCKS_MAX: u64 = 64;
/// Rows in the window.
const ROWS_MAX: u64 = BLOCK_ROWS * BLOCKS_MAX;
/// At least so many rows are linearised anew in each step.
const ROWS_RELINEARIZED: u64 = 16;
/// What a block that leaves the window takes from the weight of those before it.
const FADING: f64 = 0.98;
/// A row farther off than this, as a squared distance with two degrees of freedom, counts less …
const DISTANCE_HUBER: f64 = 9.0;
/// … and beyond this not at all, once there are enough rows to say what is far.
const DISTANCE_MAX: f64 = 25.0;
const ROWS_FOR_REJECTION: u64 = 24;
/// The measured scatter is averaged with this many degrees of freedom of the expected one.
const SCATTER_PRIOR: f64 = 60.0;
/// No count ever gets here: a thousand rows a second for a million years.
pub(crate) const COUNT_MAX: u64 = 1 << 55;
/// Earlier soils that are remembered: the wheel may come back to one, or a fault of a sensor may only have looked like another.
pub(crate) const EARLIER_MAX: usize = 3;
/// An earlier soil with fewer rows tells nothing.
const EARLIER_ROWS_MIN: f64 = 24.0;
/// One row alone is linearised so often: then nothing changes any more.
const ITERATIONS_ALONE: usize = 6;

/// The window and its solution.
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct Regression {
    rows: [Tracked; ROWS_MAX as usize],
    blocks: [Cost; BLOCKS_MAX as usize],
    /// What has left the window.
    past: Cost,
    /// Soils driven over before, the latest first.
    earlier: [Cost; EARLIER_MAX],
    pub(crate) solution: Posterior,
    /// Measured over expected variance, at least 1.
    pub(crate) scatter: f64,
    /// Squared distance of all rows from the solution, in units of the expected variance.
    pub(crate) misfit: f64,
    /// Numbers of the first row in the window and of the next one; the first is a multiple of [`BLOCK_ROWS`].
    first: u64,
    next: u64,
    /// Block to be linearised anew next.
    cursor: u64,
    /// Soils before this one.
    soils_before: u64,
}

/// How a new row compares with what was predicted, before it is added.
pub(crate) struct Innovation {
    pub(crate) tracked: Tracked,
    pub(crate) cost: Cost,
    /// Squared distance in units of the predicted variance; two degrees of freedom.
    pub(crate) distance: f64,
}

impl Regression {
    /// Starts with the first soil: no rows, and what is expected.
    pub(crate) fn start(&mut self, model: &Model) {
        self.solution.parameters = model.first.mean;
        self.clear(model);
    }

    /// Forgets everything for another soil.
    pub(crate) fn start_over(&mut self, model: &Model) {
        self.remember(&self.sum());
        self.soils_before += 1;
        self.solution.parameters = model.later.mean;
        self.clear(model);
    }

    fn clear(&mut self, model: &Model) {
        self.first = self.next.next_multiple_of(BLOCK_ROWS);
        self.next = self.first;
        self.cursor = self.first / BLOCK_ROWS;
        self.past = Cost::default();
        self.scatter = 1.0;
        self.solve(model);
    }

    /// Whether the counts can be those of a window.
    pub(crate) fn is_sound(&self) -> bool {
        let is_window = self.first <= self.next && self.next - self.first <= ROWS_MAX;
        let counts = [self.next, self.cursor, self.soils_before];
        is_window && counts.iter().all(|count| *count < COUNT_MAX) && self.scatter >= 1.0
    }

    /// What is expected of this soil.
    pub(crate) fn prior<'a>(&self, model: &'a Model) -> &'a Prior {
        if self.soils_before == 0 {
            &model.first
        } else {
            &model.later
        }
    }

    /// Rows in the window.
    pub(crate) fn rows(&self) -> u64 {
        self.next - self.first
    }

    /// The rows in the window, oldest first.
    pub(crate) fn tracked(&self) -> impl Iterator<Item = &Tracked> {
        (self.first..self.next).map(|number| &self.rows[slot(number)])
    }

    /// What one row alone tells beyond what is expected of the soil, and the row.
    pub(crate) fn alone(&self, row: &Row, model: &Model) -> (Posterior, Tracked) {
        let prior = self.prior(model);
        let mut posterior = Posterior {
            parameters: prior.mean,
            ..Posterior::default()
        };
        posterior.parameters[STIFFNESS] += stiffness_error(row, &posterior, model);
        let mut tracked = Tracked::new(row);
        for _ in 0..ITERATIONS_ALONE {
            let linear = tracked.linearize(&posterior.parameters, model);
            let mut cost = linear.cost(1.0, &posterior.parameters);
            cost.add(&prior.cost);
            posterior.descend(&cost);
        }
        (posterior, tracked)
    }

    /// Compares a row with what the solution so far predicts.
    pub(crate) fn compare(&mut self, row: &Row, model: &Model) -> Innovation {
        if self.rows() == 0 && self.past.rows == 0.0 {
            // From here on the steps are small.
            self.solution.parameters[STIFFNESS] += stiffness_error(row, &self.solution, model);
        }
        let parameters = &self.solution.parameters;
        let mut tracked = Tracked::new(row);
        tracked.linearize(parameters, model);
        let linear = tracked.linearize(parameters, model);
        tracked.weight = self.weight(tracked.distance);
        let covariance = Matrix::from(self.solution.covariance);
        let predicted = linear.variance * self.scatter + linear.by * covariance * linear.by.transpose();
        let distance = match predicted.try_inverse() {
            Some(inverse) => linear.residual.dot(&(inverse * linear.residual)),
            None => f64::INFINITY,
        };
        Innovation {
            cost: linear.cost(tracked.weight, parameters),
            tracked,
            distance,
        }
    }

    /// Adds a row, linearises some of the older ones anew, and solves.
    pub(crate) fn push(&mut self, innovation: &Innovation, model: &Model) {
        if self.rows() == ROWS_MAX {
            self.past = self.past.scaled(FADING);
            self.past.add(&self.blocks[block_slot(self.first / BLOCK_ROWS)]);
            self.first += BLOCK_ROWS;
        }
        let block = block_slot(self.next / BLOCK_ROWS);
        if self.next.is_multiple_of(BLOCK_ROWS) {
            self.blocks[block] = Cost::default();
        }
        self.rows[slot(self.next)] = innovation.tracked;
        self.blocks[block].add(&innovation.cost);
        self.next += 1;
        self.improve(model);
    }

    /// Linearises some rows anew, a block at a time and all blocks in turn, and solves.
    pub(crate) fn improve(&mut self, model: &Model) {
        let blocks = self.blocks();
        let mut rows = 0;
        while rows < ROWS_RELINEARIZED && !blocks.is_empty() {
            if !blocks.contains(&self.cursor) {
                self.cursor = blocks.start;
            }
            rows += self.linearize_block(self.cursor, model);
            self.cursor += 1;
            if self.cursor == blocks.end {
                self.solve(model);
            }
        }
        self.solve(model);
    }

    /// The cost of the rows before the block and from it on.
    pub(crate) fn split(&self, block: u64) -> (Cost, Cost) {
        let (mut before, mut after) = (self.past, Cost::default());
        for number in self.blocks() {
            let side = if number < block { &mut before } else { &mut after };
            side.add(&self.blocks[block_slot(number)]);
        }
        (before, after)
    }

    /// Takes the newest rows out again.
    pub(crate) fn discard_newest(&mut self, rows: u64, model: &Model) {
        self.next -= rows.min(self.rows());
        if !self.next.is_multiple_of(BLOCK_ROWS) {
            self.linearize_block(self.next / BLOCK_ROWS, model);
        }
        self.solve(model);
    }

    /// Numbers of the blocks in the window.
    pub(crate) fn blocks(&self) -> std::ops::Range<u64> {
        self.first / BLOCK_ROWS..self.next.div_ceil(BLOCK_ROWS)
    }

    /// Forgets what came before the block: it was another soil.
    pub(crate) fn forget_before(&mut self, block: u64, model: &Model) {
        self.remember(&self.split(block).0);
        self.first = (block * BLOCK_ROWS).clamp(self.first, self.next);
        self.past = Cost::default();
        self.scatter = 1.0;
        self.soils_before += 1;
        self.solve(model);
    }

    /// The cost of all rows of this soil.
    pub(crate) fn sum(&self) -> Cost {
        let (mut sum, window) = self.split(0);
        sum.add(&window);
        sum
    }

    /// An earlier soil, if it is remembered.
    pub(crate) fn earlier(&self, which: usize) -> Option<&Cost> {
        self.earlier.get(which).filter(|cost| cost.rows > 0.0)
    }

    /// This soil is that earlier one: what was known of it counts again.
    pub(crate) fn recall(&mut self, which: usize, model: &Model) {
        let known = std::mem::take(&mut self.earlier[which]);
        self.past.add(&known);
        self.solve(model);
    }

    fn remember(&mut self, soil: &Cost) {
        if soil.rows >= EARLIER_ROWS_MIN {
            self.earlier.rotate_right(1);
            self.earlier[0] = *soil;
        }
    }

    /// Linearises the rows of a block anew; their number.
    fn linearize_block(&mut self, block: u64, model: &Model) -> u64 {
        let mut sum = Cost::default();
        let rows = (block * BLOCK_ROWS).max(self.first)..(block * BLOCK_ROWS + BLOCK_ROWS).min(self.next);
        for number in rows.clone() {
            let mut tracked = self.rows[slot(number)];
            let linear = tracked.linearize(&self.solution.parameters, model);
            tracked.weight = self.weight(tracked.distance);
            sum.add(&linear.cost(tracked.weight, &self.solution.parameters));
            self.rows[slot(number)] = tracked;
        }
        self.blocks[block_slot(block)] = sum;
        rows.end - rows.start
    }

    /// How much a row counts at a squared distance. At first no row is refused: a wrong start makes good rows look bad.
    fn weight(&self, distance: f64) -> f64 {
        let distance = distance / self.scatter;
        if distance <= DISTANCE_HUBER {
            1.0
        } else if distance > DISTANCE_MAX && self.rows() > ROWS_FOR_REJECTION {
            0.0
        } else {
            (DISTANCE_HUBER / distance).sqrt()
        }
    }

    /// Moves the solution to the least cost of prior and rows.
    fn solve(&mut self, model: &Model) {
        let rows = self.sum();
        let mut total = rows.scaled(1.0 / self.scatter);
        let prior = self.prior(model);
        total.add(&prior.cost);
        let offset = self.solution.parameters[TORQUE_OFFSET];
        total.matrix[TORQUE_OFFSET][TORQUE_OFFSET] += prior.looser_for_offset(offset);
        if let Some(best) = self.solution.descend(&total) {
            self.misfit = rows.at(&best).max(0.0);
            self.scatter = ((self.misfit + SCATTER_PRIOR) / (2.0 * rows.rows + SCATTER_PRIOR)).max(1.0);
        }
    }
}

/// By how much the logarithm of the stiffness is wrong, if the row's load is carried at its entry angle.
fn stiffness_error(row: &Row, soil: &Posterior, model: &Model) -> f64 {
    let contact = Contact {
        entry_rad: row.entry_rad,
        exit_rad: row.exit_rad,
        slip: row.slip,
    };
    let mut parameters = soil.parameters;
    for _ in 0..4 {
        let load_n = model.rim.forces(&contact, &parameters).values[0];
        parameters[STIFFNESS] += (row.load_n / load_n).ln().clamp(-2.0, 2.0);
    }
    parameters[STIFFNESS] - soil.parameters[STIFFNESS]
}

/// Slot of a row in the window.
fn slot(number: u64) -> usize {
    (number % ROWS_MAX) as usize
}

/// Slot of a block in the window.
fn block_slot(block: u64) -> usize {
    (block % BLOCKS_MAX) as usize
}
