//! A PNG or JPEG file, as bytes, into pixels of 8 bits a channel.

use png::{BitDepth, ColorType, Decoder, DecodingError, Limits, Transformations};
use std::io::{Cursor, ErrorKind};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;
use zune_jpeg::errors::DecodeErrors;

/// Pixels of a file at the most.
const PIXELS_MAX: u64 = 64_000_000;
/// Pixels of a row or a column of a file at the most.
pub(crate) const SIDE_PX_MAX: u32 = 65_535;
/// Memory that the PNG decoder may ask for beside the picture [bytes].
const PNG_BYTES_MAX: usize = 64 << 20;
/// What a JPEG file begins with.
const JPEG: [u8; 2] = [0xff, 0xd8];

/// Decodes into `pixels`: width, height and channels of a pixel, 1 to 4, gray or red, green and blue first.
///
/// # Errors
/// Says what is wrong with the file, and the way out.
pub(crate) fn decode(file: &[u8], pixels: &mut Vec<u8>) -> Result<(u32, u32, usize), String> {
    if file.starts_with(&JPEG) {
        jpeg(file, pixels)
    } else {
        png(file, pixels)
    }
}

fn png(file: &[u8], pixels: &mut Vec<u8>) -> Result<(u32, u32, usize), String> {
    let limits = Limits { bytes: PNG_BYTES_MAX };
    let mut decoder = Decoder::new_with_limits(Cursor::new(file), limits);
    decoder.set_transformations(Transformations::normalize_to_color8());
    let (width, height) = decoder.read_header_info().map_err(|error| complaint(&error))?.size();
    accept(width, height)?;
    let mut reader = decoder.read_info().map_err(|error| complaint(&error))?;
    let size = reader.output_buffer_size().unwrap_or(usize::MAX);
    if size as u64 > PIXELS_MAX * 4 {
        return Err("more than 4 bytes a pixel; save it as 8-bit gray or RGB".into());
    }
    // What the last picture left there is overwritten.
    pixels.resize(size, 0);
    let decoded = reader.next_frame(pixels).map_err(|error| complaint(&error))?;
    reader.finish().map_err(|error| complaint(&error))?;
    let whole = (decoded.width, decoded.height) == (width, height);
    if !whole || decoded.bit_depth != BitDepth::Eight || decoded.color_type == ColorType::Indexed {
        return Err("this kind of PNG is not supported; save it as 8-bit gray or RGB".into());
    }
    Ok((width, height, decoded.color_type.samples()))
}

fn jpeg(file: &[u8], pixels: &mut Vec<u8>) -> Result<(u32, u32, usize), String> {
    let failed = |error: DecodeErrors| match error {
        DecodeErrors::ExhaustedData | DecodeErrors::IoErrors(_) => CUT_OFF.into(),
        _ => format!("not a sound JPEG file: {error}"),
    };
    // Otherwise it fills up with gray what a file that was cut off does not hold.
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(SIDE_PX_MAX as usize)
        .set_max_height(SIDE_PX_MAX as usize);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(file), options);
    decoder.decode_headers().map_err(failed)?;
    let about = decoder.info().ok_or("not a sound JPEG file: it has no size")?;
    let (width, height) = (u32::from(about.width), u32::from(about.height));
    accept(width, height)?;
    let (color, channels) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, 1),
        _ => (ColorSpace::RGB, 3),
    };
    decoder.set_options(options.jpeg_set_out_colorspace(color));
    // What the last picture left there is overwritten.
    pixels.resize(width as usize * height as usize * channels, 0);
    decoder.decode_into(pixels).map_err(failed)?;
    Ok((width, height, channels))
}

fn accept(width: u32, height: u32) -> Result<(), String> {
    if width.max(height) > SIDE_PX_MAX || u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!(
            "{width}x{height} px; at most 64 Mpx and {SIDE_PX_MAX} px a side, crop or scale it down"
        ));
    }
    Ok(())
}

const CUT_OFF: &str = "the file is cut off; copy it again from its source";

/// What the PNG decoder says, in words that lead out of it.
fn complaint(error: &DecodingError) -> String {
    match error {
        DecodingError::IoError(error) if error.kind() == ErrorKind::UnexpectedEof => CUT_OFF.into(),
        DecodingError::LimitsExceeded => "decoding takes too much memory; save it as 8-bit gray or RGB".into(),
        _ => format!("neither a sound PNG file nor a JPEG file: {error}"),
    }
}
