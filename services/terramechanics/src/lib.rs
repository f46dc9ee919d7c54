//! Terramechanics: cohesion and friction angle of the soil from what the wheel feels.
