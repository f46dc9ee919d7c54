//! Visual wheel sinkage: where the soil meets the wheel in a picture.
//!
//! The method is §2 of Iagnemma, Brooks and Dubowsky, "Visual, Tactile, and Vibration-Based Terrain Analysis for
//! Planetary Rovers", IEEE Aerospace 2004: along the rim, on either side of straight down, the soil begins at the row
//! at which the mean intensity changes the most. The default method goes on from there: it refines the wheel's centre,
//! weighs the contrast along every line that the soil may make, looks at where the line crosses the wheel's outer edge once
//! more, and says how sure it is.

pub mod annulus;
pub mod cells;
pub mod center;
pub mod contrast;
pub mod crossing;
pub mod filter;
pub mod interface;
pub mod lines;
pub mod lip;
pub mod posterior;
pub mod profile;
pub mod rim;
pub mod ring;
pub mod rows;
pub mod weights;

use annulus::Annulus;
use cells::{Cells, Sums};
use center::Shift;
use contrast::Contrast;
use filter::Filter;
use interface::Interface;
use messages::{Frame, Resumable, Sinkage, Status};
use posterior::{Coupling, Posterior};
use rim::Rim;
use ring::Ring;
use rows::Side;
use serde::Deserialize;
use weights::Weights;
use zerocopy::{FromBytes, IntoBytes};

/// Share of a side's pixels that must be in the picture.
const SHARE_MIN: f64 = 0.75;
/// Log ratio of the strongest step along a side, below which it has no contrast.
const CONTRAST_MIN: f32 = 0.02;
/// Confidence below which an answer is a guess.
const CONFIDENCE_MIN: f64 = 0.6;
/// The same of the largest change, which knows less of what could be wrong.
const CHANGE_CONFIDENCE_MIN: f64 = 0.75;
/// Standard deviation above which an answer is a guess: what is left may be improbable, but far away.
const SIGMA_MAX: f64 = 0.037;
/// Height of an interface above which a wheel would be stuck. It is the edge of a light where the wheel's outer edge is still
/// seen below it: log ratio of the gray values across the outer edge.
const COSINE_MIN: f64 = 0.62;
const EDGE_MAX: f32 = 0.25;

/// Measures the sinkage in one picture after the other.
#[derive(Clone, Debug)]
pub struct SinkageTracker {
    config: Config,
    sides: [Side; 2],
    cells: Box<[Cells; 2]>,
    contrast: Box<Contrast>,
    annulus: Annulus,
    rings: [Ring; 2],
    table: Box<[Sums; 256]>,
    filter: Filter,
    coupling: Coupling,
    processor: pulp::Arch,
    weights: Weights,
}

impl SinkageTracker {
    /// A tracker of a valid `config`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            sides: [Side::EMPTY; 2],
            cells: Box::new([Cells::EMPTY; 2]),
            contrast: Contrast::new(),
            annulus: Annulus::new(),
            rings: [[0.0; rows::ROWS]; 2],
            table: Box::new(cells::log_table()),
            filter: Filter::NEW,
            coupling: Coupling::new(),
            processor: pulp::Arch::new(),
            weights: Weights::fitted(),
        }
    }

    /// The sinkage that `frame` shows: a side that cannot be seen is NaN, and so is all else where it is the entry.
    pub fn step(&mut self, frame: &Frame) -> Sinkage {
        match self.find(frame) {
            Ok(found) => self.sinkage(frame, found),
            Err(status) => Sinkage::unknown(frame.header.answer(status)),
        }
    }

    /// What is in the picture, or why there is nothing.
    fn find(&mut self, frame: &Frame) -> Result<Found, Status> {
        let image = frame.image();
        if frame.header.status == Status::NO_DATA {
            return Err(Status::NO_DATA);
        }
        if !frame.header.status.is_answer() || image.is_empty() {
            return Err(Status::INPUT_REJECTED);
        }
        // A foreign writer can change the size at any time: only the pixels' number is relied on.
        let width = (frame.width as usize).clamp(1, image.len());
        let rim = Rim::locate(frame, width, image.len() / width)?;
        match self.config.method {
            Method::LargestChange => Ok(Found {
                sides: self.largest_change(image, width, &rim),
                center: None,
            }),
            Method::Contrast => Ok(self.processor.dispatch(ByContrast {
                tracker: self,
                image,
                width,
                frame,
                rim: &rim,
            })),
        }
    }

    fn largest_change(&mut self, image: &[u8], width: usize, rim: &Rim) -> [Option<Interface>; 2] {
        rows::accumulate(image, width, rim, &mut self.sides);
        self.sides
            .each_ref()
            .map(|side| Interface::find(side).filter(|_| side.pixels() >= SHARE_MIN * rim.side_px))
    }

    #[inline(always)]
    fn strongest_contrast(&mut self, image: &[u8], taken_ns: u64, rim: &Rim) -> [Option<Interface>; 2] {
        self.annulus
            .measure(image, &self.table, &mut self.cells, &mut self.rings);
        let mut sides = [None, None];
        for (k, ((side, cells), ring)) in sides.iter_mut().zip(&*self.cells).zip(&self.rings).enumerate() {
            let visible = f64::from(cells.pixels()) >= SHARE_MIN * rim.side_px;
            if self.contrast.measure(cells, ring) >= CONTRAST_MIN && visible {
                self.annulus.mark(k, &mut self.contrast);
                *side = Some(Posterior::new(&self.contrast, &self.weights));
            }
        }
        self.filter.expect(taken_ns, &mut sides);
        if let [Some(left), Some(right)] = &mut sides {
            self.coupling.couple(left, right);
        }
        self.filter.observe(taken_ns, &sides);
        let mut interfaces = [None, None];
        for ((interface, side), cells) in interfaces.iter_mut().zip(&sides).zip(&*self.cells) {
            *interface = side
                .as_ref()
                .and_then(|side| side.of_one_picture().interface(&self.weights));
            if let Some(interface) = interface {
                crossing::refine(cells, interface);
            }
        }
        interfaces
    }

    fn sinkage(&self, frame: &Frame, found: Found) -> Sinkage {
        let [left, right] = found.sides;
        let (entry, exit) = match self.config.rolls {
            Rolls::Right => (right, left),
            Rolls::Left => (left, right),
        };
        let confidence_min = match self.config.method {
            Method::Contrast => CONFIDENCE_MIN,
            Method::LargestChange => CHANGE_CONFIDENCE_MIN,
        };
        let status = match (entry, exit) {
            (None, _) => Status::NOT_VISIBLE,
            (Some(entry), Some(exit)) if entry.confidence.min(exit.confidence) >= confidence_min => Status::OK,
            (Some(_), _) => Status::UNCERTAIN,
        };
        let mut sinkage = Sinkage::unknown(frame.header.answer(status));
        if let Some((x_px, y_px)) = found.center {
            (sinkage.center_x_px, sinkage.center_y_px) = (x_px, y_px);
        }
        (sinkage.left_rad, sinkage.left_sigma_rad) = angle(left);
        (sinkage.right_rad, sinkage.right_sigma_rad) = angle(right);
        (sinkage.entry_rad, sinkage.entry_sigma_rad) = angle(entry);
        let (behind_rad, behind_sigma_rad) = angle(exit);
        (sinkage.exit_rad, sinkage.exit_sigma_rad) = (-behind_rad, behind_sigma_rad);
        if let Some(entry) = entry {
            sinkage.sinkage_m = self.config.radius_m * (1.0 - entry.cosine); // z = r (1 - cos θ1)
            sinkage.sinkage_sigma_m = self.config.radius_m * entry.sigma;
            sinkage.confidence = exit.map_or(entry.confidence, |exit| entry.confidence.min(exit.confidence));
        }
        sinkage
    }
}

impl Resumable for SinkageTracker {
    fn state_bytes(&self) -> usize {
        size_of::<filter::State>()
    }

    fn save(&self, state: &mut [u8]) {
        state.copy_from_slice(self.filter.state().as_bytes());
    }

    fn restore(&mut self, state: &[u8]) -> Result<(), &'static str> {
        let state = filter::State::read_from_bytes(state).map_err(|_| "is of another length")?;
        self.filter.set(&state)
    }
}

/// The default method, its loops compiled for several generations of processors.
struct ByContrast<'a> {
    tracker: &'a mut SinkageTracker,
    image: &'a [u8],
    width: usize,
    frame: &'a Frame,
    rim: &'a Rim,
}

impl pulp::WithSimd for ByContrast<'_> {
    type Output = Found;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Found {
        let Self {
            tracker,
            image,
            width,
            frame,
            rim,
        } = self;
        tracker.annulus.call_up(image);
        let shift = Shift::find(image, width, frame);
        let center = shift.and_then(|shift| rim::project(&frame.homography, shift.right, shift.down));
        let rest = tracker
            .annulus
            .follow(rim, shift.unwrap_or(Shift::NONE), width, image.len() / width);
        let mut sides = tracker.strongest_contrast(image, frame.header.taken_ns, rim);
        for (side, ring) in sides.iter_mut().zip(&tracker.rings) {
            let Some(interface) = side else { continue };
            // From the prepared rim to this one.
            interface.cosine = ((interface.cosine - rest.down) / (1.0 + rest.growth)).clamp(0.0, 1.0);
            let light = interface.cosine < COSINE_MIN && ring::below(ring, interface.cosine) > EDGE_MAX;
            // Without the rim's inner edge it may be no wheel at all.
            if shift.is_none() || light || interface.sigma > SIGMA_MAX {
                interface.confidence *= CONFIDENCE_MIN;
            }
        }
        Found { sides, center }
    }
}

/// Left and right interface, and the refined centre [px].
#[derive(Clone, Copy, Debug)]
struct Found {
    sides: [Option<Interface>; 2],
    center: Option<(f64, f64)>,
}

/// Angle from straight down at which an interface meets the outer circle, and its standard deviation.
fn angle(interface: Option<Interface>) -> (f64, f64) {
    interface.map_or((f64::NAN, f64::NAN), |Interface { cosine, sigma, .. }| {
        let cosine = cosine.clamp(0.0, 1.0);
        // d cos θ = -sin θ dθ; at the lowest point, where sin θ is 0, cos θ = 1 - θ²/2 bounds it.
        (cosine.acos(), sigma / (1.0 - cosine * cosine + 2.0 * sigma).sqrt())
    })
}

/// The wheel, and the method.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Radius of the wheel's outer edge.
    pub radius_m: f64,
    /// The side of the picture to which the wheel rolls.
    pub rolls: Rolls,
    /// How the interface is found.
    pub method: Method,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            radius_m: 0.15,
            rolls: Rolls::Right,
            method: Method::Contrast,
        }
    }
}

impl Config {
    /// Checks what the types alone do not.
    ///
    /// # Errors
    /// The key that is wrong, and what would be right.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        if self.radius_m > 0.0 && self.radius_m <= 10.0 {
            return Ok(());
        }
        Err((
            "radius_m",
            format!("must be above 0 and at most 10, is {}", self.radius_m),
        ))
    }
}

/// The side of the picture to which the wheel rolls: there the soil is entered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rolls {
    /// To the right.
    Right,
    /// To the left.
    Left,
}

/// How the interface is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// The line across which the rim's cells differ most consistently.
    Contrast,
    /// The paper's: the row of the largest change of filtered intensity.
    LargestChange,
}
