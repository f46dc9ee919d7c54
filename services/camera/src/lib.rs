//! Camera ingest: frames from a simulated rover or a recorded traverse.

mod picture;

pub use picture::PictureReader;
