//! Camera ingest: frames from a simulated rover or a recorded traverse.
