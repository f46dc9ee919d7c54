//! What a stage hands to the process that takes its place.

/// A stage whose state outlives its process.
pub trait Resumable {
    /// Bytes of the state. The same for as long as the stage lives.
    fn state_bytes(&self) -> usize;

    /// Writes everything that changes from step to step into `state`, of [`Resumable::state_bytes`].
    fn save(&self, state: &mut [u8]);

    /// Goes on from a state that [`Resumable::save`] wrote, in this process or in another one, with the same configuration.
    ///
    /// # Errors
    /// Why the bytes cannot be used; nothing has changed then.
    fn restore(&mut self, state: &[u8]) -> Result<(), &'static str>;
}
