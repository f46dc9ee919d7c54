//! What the pictures before say of this one: a Bayes filter over the height of either side.

use crate::posterior::{BINS, Posterior};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// How fast a wheel usually sinks or climbs, in outer radii per second, and what its height is uncertain by at once.
const RATE_S: f32 = 0.08;
const BLUR: f32 = 0.006;
/// Probability that the height has nothing to do with the one before.
const JUMP: f32 = 0.03;
/// Time after which nothing is left of a picture.
const FORGOTTEN_NS: u64 = 2_000_000_000;

/// The heights of the pictures so far.
#[derive(Clone, Debug)]
pub struct Filter {
    sides: [Option<Posterior>; 2],
    taken_ns: u64,
}

impl Filter {
    /// Without a picture.
    pub const NEW: Self = Self {
        sides: [None, None],
        taken_ns: 0,
    };

    /// Weighs the sides by what the pictures before let expect. Pictures of one scene err alike: the expectation
    /// counts half, as its square root, and so no more than one picture's worth in the long run.
    pub fn expect(&self, taken_ns: u64, sides: &mut [Option<Posterior>; 2]) {
        let Some(passed_ns) = taken_ns
            .checked_sub(self.taken_ns)
            .filter(|passed| *passed <= FORGOTTEN_NS)
        else {
            return;
        };
        let reach = BLUR + RATE_S * (passed_ns as f32 * 1e-9);
        for (side, before) in sides.iter_mut().zip(&self.sides) {
            if let (Some(side), Some(before)) = (side, before) {
                let mut expected = before.mass;
                spread(&mut expected, reach * BINS as f32);
                for (mass, expected) in side.mass.iter_mut().zip(expected) {
                    *mass *= (JUMP / BINS as f32 + (1.0 - JUMP) * expected).sqrt();
                }
                side.normalize();
            }
        }
    }

    /// Takes the sides of a picture in. A side that is not seen is not expected of the next picture.
    pub fn observe(&mut self, taken_ns: u64, sides: &[Option<Posterior>; 2]) {
        self.taken_ns = taken_ns;
        self.sides.clone_from(sides);
    }
}

/// The filter as plain bytes. A side that is not expected is zeros, and its flag 0.
#[derive(FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct State {
    taken_ns: u64,
    expected: [u32; 2],
    mass: [[f32; BINS]; 2],
}

impl Filter {
    pub(crate) fn state(&self) -> State {
        let mass = self.sides.each_ref().map(|side| side.as_ref().map(|side| side.mass));
        State {
            taken_ns: self.taken_ns,
            expected: mass.map(|mass| u32::from(mass.is_some())),
            mass: mass.map(|mass| mass.unwrap_or([0.0; BINS])),
        }
    }

    /// # Errors
    /// Why this can be no state.
    pub(crate) fn set(&mut self, state: &State) -> Result<(), &'static str> {
        let is_probability = |mass: &f32| (0.0..=1.001).contains(mass);
        if !state.mass.as_flattened().iter().all(is_probability) {
            return Err("holds a probability that cannot be");
        }
        self.taken_ns = state.taken_ns;
        self.sides = [0, 1].map(|side| (state.expected[side] != 0).then(|| Posterior { mass: state.mass[side] }));
        Ok(())
    }
}

/// Convolves with a two-sided exponential of this many bins: a forward and a backward recursion.
fn spread(mass: &mut [f32; BINS], bins: f32) {
    let keep = (-1.0 / bins.max(1e-3)).exp();
    let mut carried = 0.0;
    let mut forward = [0.0; BINS];
    for (forward, mass) in forward.iter_mut().zip(&*mass) {
        carried = carried * keep + mass;
        *forward = carried;
    }
    carried = 0.0;
    for (mass, forward) in mass.iter_mut().zip(forward).rev() {
        let here = *mass;
        // Both recursions hold this bin itself.
        *mass = (1.0 - keep) / (1.0 + keep) * (forward + carried * keep);
        carried = carried * keep + here;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_height_is_spread_as_a_two_sided_exponential() {
        let mut mass = [0.0; BINS];
        mass[100] = 1.0;
        spread(&mut mass, 5.0);
        let sum: f32 = mass.iter().sum();
        assert!((sum - 1.0).abs() < 1e-3, "{sum}");
        for k in 0..BINS {
            let expected = mass[100] * (-(k.abs_diff(100) as f32) / 5.0).exp();
            assert!((mass[k] - expected).abs() < 1e-5, "{k}");
        }
    }
}
