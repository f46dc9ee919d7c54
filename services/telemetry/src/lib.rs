//! Wheel and vibration ingest: from a simulated rover or a recorded traverse.
