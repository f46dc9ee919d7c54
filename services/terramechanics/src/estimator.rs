//! Cohesion and friction angle, cycle by cycle.

use crate::checkpoint::{Checkpoint, State, config_digest};
use crate::model::Model;
use crate::{Config, Estimator, Row};
use messages::{Resumable, Sinkage, Soil, Status, Wheel};
use zerocopy::{FromBytes, IntoBytes};

/// Estimates the soil under one wheel.
#[derive(Clone, Debug)]
pub struct SoilEstimator {
    config: Config,
    config_digest: u64,
    model: Model,
    state: Box<State>,
}

impl SoilEstimator {
    /// An estimator that knows nothing of the soil yet. `config` has been validated.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let model = Model::new(&config);
        let mut state = State::new_boxed();
        state.full.start(&model);
        Self {
            config_digest: config_digest(&config),
            config,
            model,
            state,
        }
    }

    /// Takes in a reading of the wheel, not later than the next sinkage.
    pub fn observe_wheel(&mut self, wheel: &Wheel) {
        self.state.wheels.observe(wheel, &self.config);
    }

    /// The soil, after the sinkage of one more cycle.
    pub fn step(&mut self, sinkage: &Sinkage) -> Soil {
        let mut soil = Soil::unknown(sinkage.header.answer(Status::INPUT_REJECTED));
        let row = Row::join(sinkage, &mut self.state.wheels, &self.config);
        let status = match self.config.estimator {
            Estimator::Linear => self.step_linear(row, &mut soil),
            Estimator::Full => self.step_full(row, &mut soil),
        };
        if soil.reason == Soil::USED {
            soil.header.status = status;
        }
        soil
    }

    /// The whole state; [`SoilEstimator::restore`] continues from it bit for bit.
    #[must_use]
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint::of(&self.state, self.config_digest)
    }

    /// Continues where the estimator stopped that `checkpoint` is of.
    ///
    /// # Errors
    /// Why the checkpoint cannot be used; nothing has changed then.
    pub fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), &'static str> {
        *self.state = *checkpoint.state(self.config_digest)?;
        Ok(())
    }

    fn step_linear(&mut self, row: Result<Row, u32>, soil: &mut Soil) -> Status {
        let paper = &mut self.state.paper;
        soil.reason = match row {
            Ok(row) => paper.add(&row, &self.config, soil),
            Err(reason) => reason,
        };
        if soil.reason != Soil::USED {
            paper.reject();
        }
        paper.report(&self.config, soil)
    }

    fn step_full(&mut self, row: Result<Row, u32>, soil: &mut Soil) -> Status {
        let full = &mut self.state.full;
        soil.reason = match row {
            Ok(row) => full.add(&row, &self.model, soil),
            Err(reason) => {
                full.idle(&self.model);
                reason
            }
        };
        full.report(&self.model, soil)
    }
}

impl Resumable for SoilEstimator {
    fn state_bytes(&self) -> usize {
        size_of::<Checkpoint>()
    }

    fn save(&self, state: &mut [u8]) {
        state.copy_from_slice(self.checkpoint().as_bytes());
    }

    fn restore(&mut self, state: &[u8]) -> Result<(), &'static str> {
        let checkpoint = Checkpoint::read_from_bytes(state).map_err(|_| "is of another length")?;
        Self::restore(self, &checkpoint)
    }
}
