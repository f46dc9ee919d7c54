//! Visual wheel sinkage: where the soil meets the wheel in a picture.
