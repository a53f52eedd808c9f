//! The container of a VTU file: XML elements and their arrays in every encoding that VTK, ParaView and meshio write (ASCII, base64 in
//! place, base64 or raw appended; uncompressed or zlib; either byte order; 32 or 64 bit headers).
//!
//! Own code, for vtkio reads no raw appended data, passes over arrays that it cannot decode, and panics or asks for any amount of memory
//! when a damaged file tells it to. Here every length is checked against the bytes that are there.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use quick_xml::events::{BytesStart, Event};
use std::io::Read;

/// What is wrong and with which element or array.
pub(crate) type Refusal = (String, String);

/// Where an array stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Section {
    Points,
    Cells,
    CellData,
}

/// The numbers of an array.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Numbers {
    Whole(Vec<i64>),
    Real(Vec<f64>),
}

impl Numbers {
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Whole(v) => v.len(),
            Self::Real(v) => v.len(),
        }
    }
}

/// A piece of the grid: sizes as the file says, and the arrays, as yet encoded.
#[derive(Clone, Debug, Default)]
pub(crate) struct Piece {
    pub points: usize,
    pub cells: usize,
    arrays: Vec<Array>,
}

#[derive(Clone, Debug)]
struct Array {
    section: Section,
    name: String,
    kind: Kind,
    components: usize,
    format: String,
    offset: usize,
    text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kind {
    bytes: usize,
    signed: bool,
    real: bool,
}

/// An opened file.
#[derive(Debug)]
pub(crate) struct File<'a> {
    pub pieces: Vec<Piece>,
    big_endian: bool,
    header_bytes: usize,
    zlib: bool,
    appended: Option<(&'a [u8], bool)>,
}

const ROOT: &str = "VTKFile";

impl<'a> File<'a> {
    /// Reads the elements; arrays are decoded when asked for.
    pub(crate) fn open(bytes: &'a [u8]) -> Result<Self, Refusal> {
        if !bytes.windows(8).take(4096).any(|w| w == b"<VTKFile") {
            return Err(at(ROOT, "is not among the first elements".into()));
        }
        let (head, appended) = split_appended(bytes)?;
        let head = std::str::from_utf8(head).map_err(|e| at(ROOT, format!("byte {} is no UTF-8", e.valid_up_to())))?;
        let mut file = Self { pieces: Vec::new(), big_endian: false, header_bytes: 4, zlib: false, appended };
        let mut reader = quick_xml::Reader::from_str(head);
        reader.config_mut().expand_empty_elements = true;
        // What was split off took the closing tags with it.
        reader.config_mut().check_end_names = false;
        let (mut section, mut grid, mut in_array) = (None, false, false);
        loop {
            let event = reader.read_event().map_err(|e| at(ROOT, format!("no XML at byte {}: {e}", reader.error_position())))?;
            match event {
                Event::Start(e) => match e.name().as_ref() {
                    b"VTKFile" => file.set_root(&e)?,
                    b"UnstructuredGrid" => grid = true,
                    b"Piece" if grid => file.pieces.push(Piece {
                        points: size(&e, "NumberOfPoints")?,
                        cells: size(&e, "NumberOfCells")?,
                        arrays: Vec::new(),
                    }),
                    b"Points" => section = Some(Section::Points),
                    b"Cells" => section = Some(Section::Cells),
                    b"CellData" => section = Some(Section::CellData),
                    b"PointData" | b"FieldData" => section = None,
                    b"DataArray" => {
                        if let (Some(section), Some(piece)) = (section, file.pieces.last_mut()) {
                            piece.arrays.push(array(&e, section)?);
                            in_array = true;
                        }
                    }
                    _ => {}
                },
                Event::Text(t) if in_array => {
                    let text = t.unescape().map_err(|e| at("DataArray", e.to_string()))?;
                    if let Some(array) = file.pieces.last_mut().and_then(|p| p.arrays.last_mut()) {
                        array.text.push_str(text.trim());
                    }
                }
                Event::End(e) => match e.name().as_ref() {
                    b"DataArray" => in_array = false,
                    b"Points" | b"Cells" | b"CellData" => section = None,
                    _ => {}
                },
                Event::Eof => break,
                _ => {}
            }
        }
        if grid { Ok(file) } else { Err(at(ROOT, "has no UnstructuredGrid".into())) }
    }

    fn set_root(&mut self, e: &BytesStart) -> Result<(), Refusal> {
        let kind = attribute(e, "type")?.unwrap_or_default();
        if kind != "UnstructuredGrid" {
            return Err(at(ROOT, format!("is of type `{kind}`: expected UnstructuredGrid")));
        }
        self.big_endian = attribute(e, "byte_order")?.is_some_and(|o| o == "BigEndian");
        self.header_bytes = match attribute(e, "header_type")?.as_deref() {
            None | Some("UInt32") => 4,
            Some("UInt64") => 8,
            Some(other) => return Err(at(ROOT, format!("header_type is `{other}`: expected UInt32 or UInt64"))),
        };
        self.zlib = match attribute(e, "compressor")?.as_deref() {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => return Err(at(ROOT, format!("compressor is `{other}`: write it uncompressed or with zlib"))),
        };
        Ok(())
    }

    /// An array of a piece; `None` when there is none of this name. Points have one array whatever its name.
    pub(crate) fn numbers(&self, piece: &Piece, section: Section, name: &str) -> Result<Option<Numbers>, Refusal> {
        let wanted = |a: &&Array| a.section == section && (a.name == name || section == Section::Points);
        let Some(array) = piece.arrays.iter().find(wanted) else { return Ok(None) };
        let refuse = |reason: String| (name.to_owned(), reason);
        if array.format == "ascii" {
            return ascii(&array.text, array.kind).map(Some).map_err(refuse);
        }
        let items = match section {
            Section::Points => piece.points,
            _ => piece.cells,
        };
        // Connectivity has its own length; no cell of any type has more nodes than this.
        let most_a_item = if name == "connectivity" { 64 } else { array.components };
        let most = items.saturating_mul(most_a_item).saturating_mul(array.kind.bytes);
        let bytes = match array.format.as_str() {
            "binary" => {
                let packed: Vec<u8> = array.text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
                self.unpack(&packed, true, most)
            }
            "appended" => match self.appended {
                Some((data, base64)) => match data.get(array.offset..) {
                    Some(data) => self.unpack(data, base64, most),
                    None => Err(format!("begins at byte {} of {} appended ones", array.offset, data.len())),
                },
                None => Err("is appended, but the file has no AppendedData".into()),
            },
            other => Err(format!("format is `{other}`: expected ascii, binary or appended")),
        };
        bytes.and_then(|b| self.read(&b, array.kind)).map(Some).map_err(refuse)
    }

    /// The bytes of an array from its header on, `most` of them at the most.
    fn unpack(&self, data: &[u8], base64: bool, most: usize) -> Result<Vec<u8>, String> {
        let mut data = Source { rest: data, base64 };
        if !self.zlib {
            // Header and data are one run of base64.
            let length = self.header(&data.clone().take(self.header_bytes)?)[0];
            if length > most {
                return Err(format!("says that it has {length} bytes, at most {most} were expected"));
            }
            return Ok(data.take(self.header_bytes.saturating_add(length))?.split_off(self.header_bytes));
        }
        // Number of blocks, their size, the last one's if it is shorter, then the compressed size of each.
        let start = self.header(&data.clone().take(3 * self.header_bytes)?);
        let (blocks, size, last) = (start[0], start[1], start[2]);
        let whole = if last > 0 { blocks.saturating_sub(1) } else { blocks };
        let length = whole.saturating_mul(size).saturating_add(last);
        if length > most || blocks > length {
            return Err(format!("says that it has {length} bytes in {blocks} blocks, at most {most} were expected"));
        }
        let header = self.header(&data.take(blocks.saturating_add(3).saturating_mul(self.header_bytes))?);
        let packed = data.take(header[3..].iter().fold(0, |sum: usize, n| sum.saturating_add(*n)))?;
        let (mut bytes, mut from) = (Vec::new(), 0);
        for (i, n) in header[3..].iter().enumerate() {
            let expected = if i < whole { size } else { last };
            let before = bytes.len();
            let block = flate2::read::ZlibDecoder::new(&packed[from..from + n]);
            // One more than expected, to see that there is no more.
            block
                .take((expected as u64).saturating_add(1))
                .read_to_end(&mut bytes)
                .map_err(|e| format!("block {i} cannot be unpacked: {e}"))?;
            if bytes.len() - before != expected {
                return Err(format!("block {i} unpacks to {} bytes, expected {expected}", bytes.len() - before));
            }
            from += n;
        }
        Ok(bytes)
    }

    /// Header words.
    fn header(&self, bytes: &[u8]) -> Vec<usize> {
        bytes.chunks_exact(self.header_bytes).map(|w| usize::try_from(self.word(w)).unwrap_or(usize::MAX)).collect()
    }

    /// Up to eight bytes as an unsigned number.
    fn word(&self, bytes: &[u8]) -> u64 {
        let fold = |sum: u64, b: &u8| sum << 8 | u64::from(*b);
        if self.big_endian { bytes.iter().fold(0, fold) } else { bytes.iter().rev().fold(0, fold) }
    }

    fn read(&self, bytes: &[u8], kind: Kind) -> Result<Numbers, String> {
        if !bytes.len().is_multiple_of(kind.bytes) {
            return Err(format!("has {} bytes, not a multiple of {}", bytes.len(), kind.bytes));
        }
        let words = bytes.chunks_exact(kind.bytes).map(|w| self.word(w));
        Ok(match (kind.real, kind.bytes) {
            (true, 4) => Numbers::Real(words.map(|w| f64::from(f32::from_bits(w as u32))).collect()),
            (true, _) => Numbers::Real(words.map(f64::from_bits).collect()),
            (false, n) if kind.signed => {
                // Moves the sign to the top and back down over all higher bits.
                let shift = 64 - 8 * n;
                Numbers::Whole(words.map(|w| ((w << shift) as i64) >> shift).collect())
            }
            (false, _) => {
                let words: Option<Vec<i64>> = words.map(|w| i64::try_from(w).ok()).collect();
                Numbers::Whole(words.ok_or("holds a number beyond 63 bits")?)
            }
        })
    }
}

/// Encoded data that is taken from the front, each run padded on its own when it is base64.
#[derive(Clone)]
struct Source<'a> {
    rest: &'a [u8],
    base64: bool,
}

impl Source<'_> {
    fn take(&mut self, bytes: usize) -> Result<Vec<u8>, String> {
        let encoded = if self.base64 { bytes.div_ceil(3).saturating_mul(4) } else { bytes };
        if encoded > self.rest.len() {
            return Err(format!("ends after {} bytes, {encoded} were expected", self.rest.len()));
        }
        let (run, rest) = self.rest.split_at(encoded);
        self.rest = rest;
        if !self.base64 {
            return Ok(run.to_vec());
        }
        // Whole quads decode on their own, be they a run or the beginning of one.
        let mut decoded = STANDARD.decode(run).map_err(|e| format!("is no base64: {e}"))?;
        if decoded.len() < bytes {
            return Err(format!("has {} bytes, {bytes} were expected", decoded.len()));
        }
        decoded.truncate(bytes);
        Ok(decoded)
    }
}

/// The XML before appended data, and the data with whether it is base64.
fn split_appended(bytes: &[u8]) -> Result<(&[u8], Option<(&[u8], bool)>), Refusal> {
    const TAG: &[u8] = b"<AppendedData";
    let Some(start) = bytes.windows(TAG.len()).position(|w| w == TAG) else { return Ok((bytes, None)) };
    let (head, tail) = bytes.split_at(start);
    let refuse = |reason: &str| at("AppendedData", reason.into());
    let end = tail.iter().position(|b| *b == b'>').ok_or_else(|| refuse("its tag does not end"))?;
    let tag = String::from_utf8_lossy(&tail[..end]).into_owned();
    let base64 = match (tag.contains("base64"), tag.contains("raw")) {
        (true, false) => true,
        (false, true) => false,
        _ => return Err(refuse("encoding: expected base64 or raw")),
    };
    let data = &tail[end..];
    let first = data.iter().position(|b| *b == b'_').ok_or_else(|| refuse("does not begin with an underscore"))?;
    Ok((head, Some((&data[first + 1..], base64))))
}

fn array(e: &BytesStart, section: Section) -> Result<Array, Refusal> {
    let name = attribute(e, "Name")?.unwrap_or_default();
    let kind = attribute(e, "type")?.unwrap_or_default();
    let number = |key: &str, default: usize| match attribute(e, key)? {
        Some(text) => text.trim().parse().map_err(|_| (name.clone(), format!("{key} is `{text}`: expected a whole number"))),
        None => Ok(default),
    };
    let (components, offset) = (number("NumberOfComponents", 1)?, number("offset", 0)?);
    let format = attribute(e, "format")?.unwrap_or_else(|| "ascii".into());
    let kind = Kind::of(&kind).ok_or_else(|| (name.clone(), format!("type is `{kind}`: expected Int8 to UInt64, Float32 or Float64")))?;
    Ok(Array { section, name, kind, components, format, offset, text: String::new() })
}

impl Kind {
    fn of(name: &str) -> Option<Self> {
        let (signed, real, bits) = match name {
            _ if name.starts_with("Float") => (true, true, &name[5..]),
            _ if name.starts_with("UInt") => (false, false, &name[4..]),
            _ if name.starts_with("Int") => (true, false, &name[3..]),
            _ => return None,
        };
        let bytes = match bits {
            "8" if !real => 1,
            "16" if !real => 2,
            "32" => 4,
            "64" => 8,
            _ => return None,
        };
        Some(Self { bytes, signed, real })
    }
}

fn ascii(text: &str, kind: Kind) -> Result<Numbers, String> {
    let words = text.split_ascii_whitespace();
    let refuse = |w: &str| format!("`{w}` is not a number of its type");
    Ok(if kind.real {
        Numbers::Real(words.map(|w| w.parse().map_err(|_| refuse(w))).collect::<Result<_, _>>()?)
    } else {
        Numbers::Whole(words.map(|w| w.parse().map_err(|_| refuse(w))).collect::<Result<_, _>>()?)
    })
}

fn attribute(e: &BytesStart, key: &str) -> Result<Option<String>, Refusal> {
    let element = || String::from_utf8_lossy(e.name().as_ref()).into_owned();
    let found = e.try_get_attribute(key).map_err(|why| (element(), why.to_string()))?;
    found.map(|a| a.unescape_value().map(|v| v.into_owned()).map_err(|why| (element(), why.to_string()))).transpose()
}

fn size(e: &BytesStart, key: &str) -> Result<usize, Refusal> {
    let text = attribute(e, key)?.ok_or_else(|| at("Piece", format!("{key} is missing")))?;
    text.trim().parse().map_err(|_| at("Piece", format!("{key} is `{text}`: expected a whole number")))
}

fn at(place: &str, reason: String) -> Refusal {
    (place.into(), reason)
}
