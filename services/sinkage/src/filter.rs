//! What the pictures before say of this one: a Bayes filter over the height of either side.

use crate::posterior::{BINS, Posterior};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// How fast a wheel usually sinks or climbs, in outer radii per second, and what its height is uncertain by at once.
const RATE_S: f32 = 0.08;
const BLUR: f32 = 0.006;
/// Probability that the height has nothing to do with the one before.
const JUMP: f32 = 0.03;
/// Time within which pictures err alike.
const ALIKE_S: f32 = 0.1;
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
    #[inline(always)]
    pub fn expect(&self, taken_ns: u64, sides: &mut [Option<Posterior>; 2]) {
        let Some(passed_ns) = taken_ns
            .checked_sub(self.taken_ns)
            .filter(|passed| *passed <= FORGOTTEN_NS)
        else {
            return;
        };
        let passed_s = passed_ns as f32 * 1e-9;
        let reach = BLUR + RATE_S * passed_s;
        let worth = 0.5 / (1.0 + passed_s / ALIKE_S);
        for (side, before) in sides.iter_mut().zip(&self.sides) {
            if let (Some(side), Some(before)) = (side, before) {
                let mut expected = before.mass;
                spread(&mut expected, reach * BINS as f32);
                let (mut following, mut any) = (0.0, f32::MIN_POSITIVE);
                for (mass, expected) in side.mass.iter_mut().zip(expected) {
                    let follows = (1.0 - JUMP) * expected;
                    let likely = JUMP / BINS as f32 + follows;
                    following += *mass * follows;
                    any += *mass * likely;
                    *mass *= likely.sqrt();
                }
                // What has nothing to do with the pictures before has gained nothing from them.
                side.pictures += worth * before.pictures * following / any;
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

/// The filter as plain bytes. A side that is not expected is zeros.
#[derive(FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub(crate) struct State {
    taken_ns: u64,
    pictures: [f32; 2],
    mass: [[f32; BINS]; 2],
}

impl Filter {
    pub(crate) fn state(&self) -> State {
        let sides = self.sides.each_ref().map(Option::as_ref);
        State {
            taken_ns: self.taken_ns,
            pictures: sides.map(|side| side.map_or(0.0, |side| side.pictures)),
            mass: sides.map(|side| side.map_or([0.0; BINS], |side| side.mass)),
        }
    }

    /// # Errors
    /// Why this can be no state.
    pub(crate) fn set(&mut self, state: &State) -> Result<(), &'static str> {
        let is_probability = |mass: &f32| (0.0..=1.001).contains(mass);
        let is_count = |pictures: &f32| *pictures >= 0.0 && pictures.is_finite();
        if !state.mass.as_flattened().iter().all(is_probability) || !state.pictures.iter().all(is_count) {
            return Err("holds a probability that cannot be");
        }
        self.taken_ns = state.taken_ns;
        self.sides = [0, 1].map(|side| {
            let (mass, pictures) = (state.mass[side], state.pictures[side]);
            (pictures > 0.0).then_some(Posterior { mass, pictures })
        });
        Ok(())
    }
}

/// Convolves with a two-sided exponential of this many bins: a forward and a backward recursion.
#[inline(always)]
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
    /// A picture that shows this height, and less likely another one.
    fn picture(height: f32, other: f32) -> Option<Posterior> {
        let near =
            |bin: usize, middle: f32| (-0.5 * (((bin as f32 + 0.5) / BINS as f32 - middle) / 0.01).powi(2)).exp();
        let mut posterior = Posterior {
            mass: std::array::from_fn(|bin| near(bin, height) + 0.3 * near(bin, other)),
            pictures: 1.0,
        };
        posterior.normalize();
        Some(posterior)
    }

    #[test]
    fn a_picture_seen_again_and_again_is_as_sure_as_once() {
        let mut filter = Filter::NEW;
        for k in 0..60 {
            let mut sides = [picture(0.8, 0.6), None];
            filter.expect(k * 33_000_000, &mut sides);
            filter.observe(k * 33_000_000, &sides);
            let [Some(side), None] = sides else { panic!() };
            let near = side.of_one_picture().near(0.8);
            // The other height has 0.3 of 1.3.
            assert!((0.7..0.87).contains(&near), "{k}: {near}");
        }
    }

    #[test]
    fn a_fast_sinkage_is_not_lagged() {
        let mut filter = Filter::NEW;
        for k in 0..30 {
            // A wheel that digs itself in within a second.
            let height = 0.95 - 0.4 * k as f32 / 30.0;
            let mut sides = [picture(height, 0.3), None];
            filter.expect(k * 33_000_000, &mut sides);
            filter.observe(k * 33_000_000, &sides);
            let [Some(side), None] = sides else { panic!() };
            let found = (0..BINS)
                .max_by(|a, b| side.mass[*a].total_cmp(&side.mass[*b]))
                .unwrap();
            let found = (found as f32 + 0.5) / BINS as f32;
            assert!((found - height).abs() < 0.01, "{k}: {found} for {height}");
        }
    }
}
