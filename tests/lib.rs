//! The tests stand in `main.rs` and its modules.
