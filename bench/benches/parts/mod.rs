//! The parts of the contrast method, one after the other, as the tracker runs them.

use messages::Frame;
use shell::now_ns;
use sinkage::annulus::Annulus;
use sinkage::cells::{Cells, Sums, log_table};
use sinkage::center::Shift;
use sinkage::contrast::Contrast;
use sinkage::crossing;
use sinkage::posterior::Posterior;
use sinkage::rim::Rim;
use sinkage::ring::Ring;
use sinkage::rows::ROWS;
use sinkage::weights::Weights;
use std::hint::black_box;

/// What is measured, in order.
pub const NAMES: [&str; 6] = [
    "centre refinement",
    "preparation for another geometry",
    "accumulation",
    "features of both sides",
    "scores and softmax of both sides",
    "answers, refined where they cross the outer edge",
];

/// The state of a tracker.
pub struct Parts {
    annulus: Annulus,
    cells: Box<[Cells; 2]>,
    rings: [Ring; 2],
    contrast: Box<Contrast>,
    table: Box<[Sums; 256]>,
    weights: Weights,
}

impl Parts {
    pub fn new() -> Self {
        Self {
            annulus: Annulus::new(),
            cells: Box::new([Cells::EMPTY; 2]),
            rings: [[0.0; ROWS]; 2],
            contrast: Contrast::new(),
            table: Box::new(log_table()),
            weights: Weights::fitted(),
        }
    }

    /// How long each part takes for a picture [ns], compiled as in the tracker.
    pub fn measure(&mut self, frame: &Frame) -> [u64; NAMES.len()] {
        pulp::Arch::new().dispatch(Measurement(self, frame))
    }
}

struct Measurement<'a>(&'a mut Parts, &'a Frame);

impl pulp::WithSimd for Measurement<'_> {
    type Output = [u64; NAMES.len()];

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Self::Output {
        let Self(parts, frame) = self;
        let (image, width, height) = (frame.image(), frame.width as usize, frame.height as usize);
        let rim = Rim::locate(frame, width, height).expect("the simulated wheel is in the picture");
        let moved = Shift {
            growth: 1.0,
            ..Shift::NONE
        };
        parts.annulus.follow(&rim, moved, width, height);
        let begun_ns = now_ns();
        let shift = Shift::find(black_box(image), width, frame).unwrap_or(Shift::NONE);
        let centered_ns = now_ns();
        black_box(parts.annulus.follow(&rim, black_box(shift), width, height));
        let prepared_ns = now_ns();
        let (cells, rings) = (&mut *parts.cells, &mut parts.rings);
        parts.annulus.measure(black_box(image), &parts.table, cells, rings);
        let summed_ns = now_ns();
        let (mut features_ns, mut softmax_ns, mut crossings_ns) = (0, 0, 0);
        for (side, (cells, ring)) in parts.cells.iter().zip(&parts.rings).enumerate() {
            let begun_ns = now_ns();
            black_box(parts.contrast.measure(black_box(cells), ring));
            parts.annulus.mark(side, &mut parts.contrast);
            let measured_ns = now_ns();
            let posterior = black_box(Posterior::new(black_box(&parts.contrast), &parts.weights));
            let scored_ns = now_ns();
            let mut interface = black_box(posterior.of_one_picture().interface(&parts.weights));
            if let Some(interface) = &mut interface {
                crossing::refine(black_box(cells), interface);
            }
            black_box(interface);
            features_ns += measured_ns - begun_ns;
            softmax_ns += scored_ns - measured_ns;
            crossings_ns += now_ns() - scored_ns;
        }
        [
            centered_ns - begun_ns,
            prepared_ns - centered_ns,
            summed_ns - prepared_ns,
            features_ns,
            softmax_ns,
            crossings_ns,
        ]
    }
}
