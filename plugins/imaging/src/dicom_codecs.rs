//! Frames in JPEG-LS and JPEG 2000: finding them among the fragments, and decoding them after checking what their headers declare.

use dicom_core::value::{C, PixelFragmentSequence};
use rayon::prelude::*;
use std::borrow::Cow;

/// A compression of single frames that is decoded here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Codec {
    /// ISO/IEC 14495-1, lossless and near lossless.
    JpegLs,
    /// ISO/IEC 15444-1, reversible and irreversible.
    Jpeg2000,
}

impl Codec {
    /// The codec of a transfer syntax, if it is one of these.
    pub fn of(syntax: &str) -> Option<Self> {
        match syntax {
            "1.2.840.10008.1.2.4.80" | "1.2.840.10008.1.2.4.81" => Some(Self::JpegLs),
            "1.2.840.10008.1.2.4.90" | "1.2.840.10008.1.2.4.91" => Some(Self::Jpeg2000),
            _ => None,
        }
    }

    /// Decodes all frames to words of the machine, as many bytes a pixel as `width` says (1 or 2), frames in order.
    pub fn decode(self, pixels: &PixelFragmentSequence<Vec<u8>>, size: [usize; 2], count: usize, width: usize) -> Result<Vec<u8>, String> {
        if width > 2 {
            return Err(format!("{} bits a pixel: expected 8 or 16", 8 * width));
        }
        let decoded: Vec<Vec<u8>> = frames(pixels, count)?
            .par_iter()
            .map(|data| {
                let words = match self {
                    Self::JpegLs => jpeg_ls(data, size)?,
                    Self::Jpeg2000 => jpeg_2000(data, size)?,
                };
                Ok(if width == 1 { words.iter().map(|w| *w as u8).collect() } else { words.iter().flat_map(|w| w.to_ne_bytes()).collect() })
            })
            .collect::<Result<_, String>>()?;
        Ok(decoded.concat())
    }
}

/// Fragments as one.
fn whole(fragments: &[Vec<u8>]) -> Cow<'_, [u8]> {
    if let [one] = fragments { Cow::Borrowed(one) } else { Cow::Owned(fragments.concat()) }
}

/// The bytes of each frame: one fragment each, all fragments for one frame, or what the table of offsets says (PS3.5 A.4).
fn frames(pixels: &PixelFragmentSequence<Vec<u8>>, count: usize) -> Result<Vec<Cow<'_, [u8]>>, String> {
    let (fragments, table): (&[Vec<u8>], &[u32]) = (pixels.fragments(), pixels.offset_table());
    if count == 1 && !fragments.is_empty() {
        return Ok(vec![whole(fragments)]);
    }
    if fragments.len() == count {
        return Ok(fragments.iter().map(|f| f.as_slice().into()).collect());
    }
    let wrong = || format!("{} fragments for {count} frames, and no table of offsets that tells which belong together", fragments.len());
    if table.len() != count {
        return Err(wrong());
    }
    // A fragment stands behind a tag and a length of four bytes each.
    let starts: C<usize> = fragments.iter().scan(0, |at, f| Some(std::mem::replace(at, *at + 8 + f.len()))).collect();
    let first: Option<Vec<usize>> = table.iter().map(|offset| starts.binary_search(&(*offset as usize)).ok()).collect();
    let mut bounds = first.ok_or_else(wrong)?;
    bounds.push(fragments.len());
    bounds.windows(2).map(|b| if b[0] < b[1] { Ok(whole(&fragments[b[0]..b[1]])) } else { Err(wrong()) }).collect()
}

fn jpeg_ls(data: &[u8], [columns, rows]: [usize; 2]) -> Result<Vec<u16>, String> {
    // The decoder refuses any other size before it allocates.
    let side = |n: usize| u32::try_from(n).map_err(|e| e.to_string());
    jpegls::decode(data, side(columns)?, side(rows)?).map(|(words, ..)| words).map_err(|e| e.to_string())
}

fn jpeg_2000(data: &[u8], [columns, rows]: [usize; 2]) -> Result<Vec<u16>, String> {
    let header = CodestreamHeader::read(data).ok_or("broken header of the codestream")?;
    header.check(columns, rows)?;
    check_precincts(data)?;
    let settings = hayro_jpeg2000::DecodeSettings { strict: true, ..Default::default() };
    let image = hayro_jpeg2000::Image::new(data, &settings).map_err(|e| e.to_string())?;
    let mut context = hayro_jpeg2000::DecoderContext::default();
    let decoded = image.decode(&mut context).map_err(|e| e.to_string())?;
    let [samples] = decoded.components() else { return Err("several components: colour images are no CT".into()) };
    let samples = samples.samples();
    if samples.len() != columns * rows {
        return Err(format!("{} samples, expected {columns} x {rows}", samples.len()));
    }
    // The decoder shifts signed samples too, as if they were not.
    let (shift, low, high) = match header.signed {
        true => (-(1_i32 << (header.precision - 1)), -(1_i32 << (header.precision - 1)), (1_i32 << (header.precision - 1)) - 1),
        false => (0, 0, (1_i32 << header.precision) - 1),
    };
    Ok(samples.iter().map(|v| (v.round() as i32).saturating_add(shift).clamp(low, high) as u16).collect())
}

/// Whether a transfer syntax is JPEG proper, which dicom-rs decodes.
pub(crate) fn is_jpeg(syntax: &str) -> bool {
    syntax.strip_prefix("1.2.840.10008.1.2.4.").and_then(|n| n.parse::<u32>().ok()).is_some_and(|n| (50..=70).contains(&n))
}

/// Refuses JPEG frames of another size than the file declares: the decoder trusts them to agree.
pub(crate) fn check_jpeg(pixels: &PixelFragmentSequence<Vec<u8>>, [columns, rows]: [usize; 2], count: usize) -> Result<(), String> {
    for data in frames(pixels, count)? {
        let headers = jpeg_frame_headers(&data).ok_or("broken JPEG header")?;
        let expected = [(columns, rows, 1)];
        if headers != expected {
            return Err(format!("its JPEG frame headers (columns, rows, components) are {headers:?}, expected {expected:?}"));
        }
    }
    Ok(())
}

/// Columns, rows and components of every frame header before the first scan (ISO/IEC 10918-1, B.2.2).
fn jpeg_frame_headers(data: &[u8]) -> Option<Vec<(usize, usize, u8)>> {
    let (mut at, mut found) = (2, Vec::new());
    if word(data, 0)? != 0xffd8 {
        return None;
    }
    loop {
        let marker = word(data, at)?;
        match marker {
            // A byte of fill before a marker.
            0xffff => at += 1,
            0xffda => return Some(found),
            0xff01 | 0xffd0..=0xffd9 | 0..0xff01 => return None,
            _ => {
                let length = usize::from(word(data, at + 2)?);
                if (0xffc0..=0xffcf).contains(&marker) && ![0xffc4, 0xffc8, 0xffcc].contains(&marker) {
                    found.push((word(data, at + 7)?.into(), word(data, at + 5)?.into(), *data.get(at + 9)?));
                }
                at += 2 + length.max(2);
            }
        }
    }
}

/// Pixels of a tile, and of a side of a precinct, below which an image is refused: bookkeeping would take many times the memory of the
/// pixels, and no encoder goes near them.
const LEAST_TILE: usize = 1024;
const LEAST_PRECINCT: u32 = 16;

/// What the SIZ marker at the start of a codestream declares (ISO/IEC 15444-1, A.5.1).
struct CodestreamHeader {
    capabilities: u16,
    size: [u32; 2],
    origin: [u32; 2],
    tile: [u32; 2],
    components: u16,
    signed: bool,
    precision: u32,
}

impl CodestreamHeader {
    fn read(data: &[u8]) -> Option<Self> {
        let long = |at: usize| data.get(at..at + 4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]));
        if long(0)? != 0xff4f_ff51 {
            return None;
        }
        let depth = *data.get(42)?;
        Some(Self {
            capabilities: word(data, 6)?,
            size: [long(8)?, long(12)?],
            origin: [long(16)?, long(20)?],
            tile: [long(24)?, long(28)?],
            components: word(data, 40)?,
            signed: depth & 0x80 != 0,
            precision: u32::from(depth & 0x7f) + 1,
        })
    }

    fn check(&self, columns: usize, rows: usize) -> Result<(), String> {
        let [width, height] = [0, 1].map(|a| self.size[a].saturating_sub(self.origin[a]) as usize);
        if [width, height] != [columns, rows] {
            return Err(format!("an image of {width} x {height}, expected {columns} x {rows}"));
        }
        // Part 15 announces itself here.
        if self.capabilities & 0x4000 != 0 {
            return Err("High-Throughput JPEG 2000".into());
        }
        if self.components != 1 || self.precision > 16 {
            return Err(format!("{} component(s) of {} bits, expected one of up to 16", self.components, self.precision));
        }
        let [across, down] = [0, 1].map(|a| (self.size[a] as usize).div_ceil((self.tile[a] as usize).max(1)));
        if across.saturating_mul(down) > 1 + columns * rows / LEAST_TILE {
            return Err(format!("{across} x {down} tiles in an image of {columns} x {rows}"));
        }
        Ok(())
    }
}

fn word(data: &[u8], at: usize) -> Option<u16> {
    data.get(at..at + 2).map(|b| u16::from_be_bytes([b[0], b[1]]))
}

/// Refuses tiny precincts, wherever a coding style declares them (COD and COC, A.6.1 and A.6.2), in the main header or in a tile's.
fn check_precincts(data: &[u8]) -> Result<(), String> {
    let (mut at, mut tile_end) = (2, data.len());
    while let (Some(marker), Some(length)) = (word(data, at), word(data, at + 2)) {
        let body = data.get(at + 4..at + 2 + usize::from(length)).unwrap_or_default();
        // What stands before the precincts: Scod, SGcod and five bytes of SPcod; a component's number, Scoc and the same five.
        let styles = match marker {
            0xff52 => body.first().map(|style| (*style, 10)),
            0xff53 => body.get(1).map(|style| (*style, 7)),
            _ => None,
        };
        if let Some((_, before)) = styles.filter(|(style, _)| style & 1 == 1) {
            let tiny = |b: &u8| (1_u32 << (b & 15)) < LEAST_PRECINCT || (1_u32 << (b >> 4)) < LEAST_PRECINCT;
            if body.iter().skip(before).any(tiny) {
                return Err(format!("precincts below {LEAST_PRECINCT} pixels"));
            }
        }
        match marker {
            // Start of a tile's part: its length counts from the marker, and 0 is all that is left.
            0xff90 => {
                let part = body.get(2..6).map_or(0, |b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]) as usize);
                tile_end = if part == 0 { data.len() } else { at.saturating_add(part) };
                at += 2 + usize::from(length);
            }
            // Its data.
            0xff93 if tile_end > at => at = tile_end,
            0xff93 | 0xffd9 => break,
            _ => at += 2 + usize::from(length).max(2),
        }
    }
    Ok(())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test panics where it fails")]
mod tests {
    use super::*;

    #[test]
    fn fragments_are_put_together_as_the_table_says() {
        let fragments = vec![vec![1, 2], vec![3, 4], vec![5, 6]];
        let of = |table: Vec<u32>, count| {
            let pixels = PixelFragmentSequence::new(table, fragments.clone());
            frames(&pixels, count).map(|f| f.into_iter().map(Cow::into_owned).collect::<Vec<_>>())
        };
        assert_eq!(of(vec![], 1).unwrap(), [vec![1, 2, 3, 4, 5, 6]]);
        assert_eq!(of(vec![], 3).unwrap(), fragments);
        assert_eq!(of(vec![0, 10], 2).unwrap(), [vec![1, 2], vec![3, 4, 5, 6]]);
        assert_eq!(of(vec![0, 20], 2).unwrap(), [vec![1, 2, 3, 4], vec![5, 6]]);
        for table in [vec![], vec![0, 5], vec![10, 0], vec![0, 0], vec![0, 999]] {
            assert!(of(table, 2).is_err());
        }
    }
}
