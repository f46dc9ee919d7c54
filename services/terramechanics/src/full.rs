//! The estimator on the full stresses: which rows are let in, which soil they belong to, and what is known of it.

use crate::Row;
use crate::change::ChangeDetector;
use crate::cost::Posterior;
use crate::model::Model;
use crate::observability;
use crate::operating_point::OperatingPoint;
use crate::orthogonal_distance::Tracked;
use crate::regression::{COUNT_MAX, Innovation, Regression};
use crate::stresses::{COHESION, COHESION_UNIT_PA, EXPONENT, SHEAR_MODULUS, TANGENT};
use messages::{Soil, Status};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A row this far from its prediction, as a squared distance with two degrees of freedom, is left out; …
const GATE: f64 = 18.0;
/// … in the first rows only if it is much farther off: the linear prediction is then still rough.
const GATE_EARLY: f64 = 80.0;
const ROWS_EARLY: u64 = 16;
/// Newest rows that were left out; a new soil starts with them.
const SUSPECTS_MAX: usize = 16;
/// An angle equal in so many rows, while load or slip moved by so many of their standard deviations, is stuck.
const STUCK_ROWS_MIN: u64 = 5;
const MOVED_SIGMAS: f64 = 8.0;
/// The operating point is steady while it holds this share of the rows in the window.
const STEADY_SHARE_MIN: f64 = 0.5;
/// What the model itself may be wrong by, in 95 % intervals too.
const COHESION_FLOOR: f64 = 0.04;
const COHESION_FLOOR_PA: f64 = 30.0;
const FRICTION_FLOOR_RAD: f64 = 0.007;
const STRENGTH_FLOOR: f64 = 0.01;

/// Everything that changes from row to row.
#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct FullEstimator {
    regression: Regression,
    detector: ChangeDetector,
    suspects: [Row; SUSPECTS_MAX],
    /// Suspects since the last reset; the newest of them are kept.
    suspects_count: u64,
    rows_used: u64,
    rows_rejected: u64,
    resets: u64,
    point: OperatingPoint,
    /// The newest row that was used.
    newest: Tracked,
    stuck: StuckAngle,
}

/// An entry angle that stays the same to the last digit.
#[derive(Clone, Copy, Debug, Default, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct StuckAngle {
    entry_rad: f64,
    rows: u64,
    /// How many of them are in the window.
    rows_used: u64,
    load_n: [f64; 2],
    slip: [f64; 2],
}

/// Writes what is known of the soil.
fn write(known: &Posterior, pressure_pa: f64, soil: &mut Soil) {
    let Posterior { parameters, covariance } = known;
    let tangent = parameters[TANGENT];
    let per_tangent = 1.0 / (1.0 + tangent * tangent); // dφ/dtanφ
    let cohesion_variance = covariance[COHESION][COHESION] * COHESION_UNIT_PA.powi(2);
    let tangent_variance = covariance[TANGENT][TANGENT];
    let both = covariance[COHESION][TANGENT] * COHESION_UNIT_PA;
    soil.cohesion_pa = parameters[COHESION] * COHESION_UNIT_PA;
    soil.cohesion_sigma_pa = cohesion_variance
        .sqrt()
        .hypot(COHESION_FLOOR * soil.cohesion_pa + COHESION_FLOOR_PA);
    soil.friction_rad = tangent.atan();
    soil.friction_sigma_rad = (tangent_variance.sqrt() * per_tangent).hypot(FRICTION_FLOOR_RAD);
    soil.cohesion_friction_covariance_pa_rad = both * per_tangent;
    soil.shear_modulus_m = parameters[SHEAR_MODULUS].exp();
    soil.shear_modulus_sigma_m = covariance[SHEAR_MODULUS][SHEAR_MODULUS].sqrt() * soil.shear_modulus_m;
    soil.sinkage_exponent = parameters[EXPONENT];
    soil.sinkage_exponent_sigma = covariance[EXPONENT][EXPONENT].sqrt();
    soil.pressure_pa = pressure_pa;
    soil.strength_pa = soil.cohesion_pa + pressure_pa * tangent; // Eq. (1)
    let variance = cohesion_variance + 2.0 * pressure_pa * both + pressure_pa.powi(2) * tangent_variance;
    soil.strength_sigma_pa = variance.max(0.0).sqrt().hypot(STRENGTH_FLOOR * soil.strength_pa);
}

impl StuckAngle {
    /// Whether the angle has stayed the same while load or slip moved far beyond their noise.
    fn add(&mut self, row: &Row, model: &Model) -> bool {
        if row.entry_rad != self.entry_rad {
            let (load_n, slip) = ([row.load_n; 2], [row.slip; 2]);
            *self = Self {
                entry_rad: row.entry_rad,
                rows: 0,
                rows_used: 0,
                load_n,
                slip,
            };
        }
        self.rows += 1;
        self.load_n = [self.load_n[0].min(row.load_n), self.load_n[1].max(row.load_n)];
        self.slip = [self.slip[0].min(row.slip), self.slip[1].max(row.slip)];
        self.rows >= STUCK_ROWS_MIN
            && (self.load_n[1] > self.load_n[0] * (1.0 + MOVED_SIGMAS * model.load_sigma)
                || self.slip[1] > self.slip[0] + MOVED_SIGMAS * model.slip_sigma)
    }
}

impl FullEstimator {
    /// No rows yet.
    pub(crate) fn start(&mut self, model: &Model) {
        self.regression.start(model);
    }

    /// Whether this can be a state at all: every number is finite, and what counts or indexes is in its range.
    pub(crate) fn is_sound(&self) -> bool {
        // A count seen as a floating point number is a tiny one.
        let is_finite = self
            .as_bytes()
            .as_chunks()
            .0
            .iter()
            .all(|word| f64::from_le_bytes(*word).is_finite());
        let counts = [
            self.suspects_count,
            self.rows_used,
            self.rows_rejected,
            self.resets,
            self.stuck.rows,
        ];
        is_finite && counts.iter().all(|count| *count < COUNT_MAX) && self.regression.is_sound()
    }

    /// Takes in the row of this cycle; the reason why it was left out, if it was.
    pub(crate) fn add(&mut self, row: &Row, model: &Model, soil: &mut Soil) -> u32 {
        if self.stuck.add(row, model) {
            self.regression.discard_newest(self.stuck.rows_used, model);
            self.rows_used -= self.stuck.rows_used.min(self.rows_used);
            self.stuck.rows_used = 0;
            self.rows_rejected += 1;
            return Soil::STUCK_ANGLE;
        }
        let innovation = self.regression.compare(row, model);
        soil.normalized_innovation = (innovation.distance / 2.0).sqrt();
        soil.slip = innovation.tracked.slip;
        let gate = if self.regression.rows() < ROWS_EARLY {
            GATE_EARLY
        } else {
            GATE
        };
        let far_off = innovation.distance.is_nan() || innovation.distance > gate;
        if far_off {
            self.suspects[self.suspects_count as usize % SUSPECTS_MAX] = *row;
            self.suspects_count += 1;
            self.rows_rejected += 1;
            self.regression.improve(model);
        } else {
            self.take(&innovation, model);
            self.rows_used += 1;
            self.stuck.rows_used += 1;
        }
        if self.detector.note(far_off) {
            self.start_over(model);
            return Soil::USED;
        }
        if let Some(block) = self.detector.split(&self.regression, self.regression.prior(model)) {
            self.regression.forget_before(block, model);
            self.count_reset();
        }
        if let Some(soil) = self.detector.earlier(&self.regression, self.regression.prior(model)) {
            self.regression.recall(soil, model);
        }
        if far_off { Soil::OUTLIER } else { Soil::USED }
    }

    /// Keeps the estimate in shape where a cycle brings no row.
    pub(crate) fn idle(&mut self, model: &Model) {
        self.rows_rejected += 1;
        self.regression.improve(model);
    }

    /// Writes what is known; the status that it deserves.
    pub(crate) fn report(&self, model: &Model, soil: &mut Soil) -> Status {
        soil.rows = u32::try_from(self.rows_used).unwrap_or(u32::MAX);
        soil.rows_rejected = u32::try_from(self.rows_rejected).unwrap_or(u32::MAX);
        soil.resets = u32::try_from(self.resets).unwrap_or(u32::MAX);
        if self.regression.rows() == 0 {
            return Status::WARMING_UP;
        }
        let status = observability::status(&self.regression, model);
        if self.point.rows < STEADY_SHARE_MIN * self.regression.rows() as f64 {
            write(&self.regression.solution, self.newest.pressure_pa(&model.rim), soil);
        } else if status == Status::OK {
            let point = Tracked::new(&self.point.as_row());
            write(&self.regression.solution, point.pressure_pa(&model.rim), soil);
        } else {
            // At one operating point the regression would take the noise of its rows for the shape of the soil's response.
            let (known, point) = self.regression.alone(&self.point.as_row(), model);
            write(&known, point.pressure_pa(&model.rim), soil);
        }
        status
    }

    fn take(&mut self, innovation: &Innovation, model: &Model) {
        self.regression.push(innovation, model);
        self.point.add(&innovation.tracked.row, model);
        self.newest = innovation.tracked;
    }

    fn start_over(&mut self, model: &Model) {
        self.regression.start_over(model);
        self.point = OperatingPoint::default();
        let kept = self.suspects_count.min(SUSPECTS_MAX as u64);
        for number in self.suspects_count - kept..self.suspects_count {
            let row = self.suspects[number as usize % SUSPECTS_MAX];
            let innovation = self.regression.compare(&row, model);
            self.take(&innovation, model);
        }
        self.count_reset();
    }

    fn count_reset(&mut self) {
        self.suspects_count = 0;
        self.detector.forget();
        self.resets += 1;
        self.rows_used = self.regression.rows();
        self.rows_rejected = 0;
    }
}
