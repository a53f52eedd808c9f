//! Where the values of a RON text are, by their path: `organs[0].materials[1].density_kg_m3`. RON's own reader forgets places once it has
//! read a value; this scanner knows nothing else. It accepts any text and never fails.

use std::collections::BTreeMap;
use std::ops::Range;

/// The places of a text.
pub(crate) struct Places<'a> {
    text: &'a str,
    values: BTreeMap<String, usize>,
    fields: Vec<Field>,
}

/// A field with its key.
pub(crate) struct Field {
    /// The key.
    pub name: String,
    /// From the key to the end of the value, bytes, the comma included.
    pub span: Range<usize>,
}

struct Frame {
    path: String,
    index: usize,
    /// Key, and index in `fields`.
    key: Option<(String, usize)>,
    /// `Some(...)`: its content has its own path.
    transparent: bool,
    started: bool,
}

impl Frame {
    fn child(&self) -> String {
        match &self.key {
            _ if self.transparent => self.path.clone(),
            Some((key, _)) if self.path.is_empty() => key.clone(),
            Some((key, _)) => format!("{}.{key}", self.path),
            None => format!("{}[{}]", self.path, self.index),
        }
    }
}

impl<'a> Places<'a> {
    /// Scans a text.
    pub(crate) fn of(text: &'a str) -> Self {
        let root = Frame { path: String::new(), index: 0, key: None, transparent: true, started: false };
        let mut places = Self { text, values: BTreeMap::new(), fields: Vec::new() };
        let mut frames = vec![root];
        let bytes = text.as_bytes();
        let mut at = 0;
        let mut name = "";
        while at < bytes.len() {
            let start = at;
            match bytes[at] {
                b'/' if bytes.get(at + 1) == Some(&b'/') => at = find(bytes, at, b'\n'),
                b'/' if bytes.get(at + 1) == Some(&b'*') => at = end_of_comment(bytes, at),
                b'"' => {
                    places.start(&mut frames, start);
                    at = end_of_quoted(bytes, at, b'"');
                }
                b'\'' => {
                    places.start(&mut frames, start);
                    at = end_of_quoted(bytes, at, b'\'');
                }
                b'r' if raw_string(bytes, at).is_some() => {
                    places.start(&mut frames, start);
                    at = raw_string(bytes, at).unwrap_or(at + 1);
                }
                b'(' | b'[' | b'{' => {
                    places.start(&mut frames, start);
                    let path = frames.last().map(Frame::child).unwrap_or_default();
                    frames.push(Frame { path, index: 0, key: None, transparent: name == "Some", started: false });
                    at += 1;
                }
                b')' | b']' | b'}' => {
                    places.end(&mut frames, start);
                    if frames.len() > 1 {
                        frames.pop();
                    }
                    at += 1;
                }
                b',' => {
                    at += 1;
                    places.end(&mut frames, at);
                    if let Some(frame) = frames.last_mut() {
                        frame.index += 1;
                    }
                }
                c if c.is_ascii_alphanumeric() || matches!(c, b'_' | b'+' | b'-' | b'.') => {
                    while at < bytes.len() && (bytes[at].is_ascii_alphanumeric() || matches!(bytes[at], b'_' | b'+' | b'-' | b'.')) {
                        at += 1;
                    }
                    name = &text[start..at];
                    if let Some(value) = after_colon(bytes, at) {
                        let field = places.fields.len();
                        places.fields.push(Field { name: name.to_owned(), span: start..bytes.len() });
                        if let Some(frame) = frames.last_mut() {
                            frame.key = Some((name.to_owned(), field));
                            frame.started = false;
                        }
                        at = value;
                    } else {
                        places.start(&mut frames, start);
                    }
                    continue;
                }
                _ => {
                    at += 1;
                    continue;
                }
            }
            name = "";
        }
        places
    }

    fn start(&mut self, frames: &mut [Frame], at: usize) {
        if let Some(frame) = frames.last_mut()
            && !frame.started
        {
            frame.started = true;
            self.values.entry(frame.child()).or_insert(at);
        }
    }

    fn end(&mut self, frames: &mut [Frame], at: usize) {
        if let Some(frame) = frames.last_mut() {
            frame.started = false;
            if let Some((_, field)) = frame.key.take() {
                self.fields[field].span.end = at;
            }
        }
    }

    /// Line and column of the value at a path, or of the nearest value around it.
    pub(crate) fn value(&self, path: &str) -> (usize, usize) {
        let mut path = path;
        loop {
            if let Some(at) = self.values.get(path) {
                return self.line_column(*at);
            }
            match path.rfind(['.', '[']) {
                Some(cut) => path = &path[..cut],
                None => return self.line_column(self.values.get("").copied().unwrap_or(0)),
            }
        }
    }

    /// The field of that name whose key is nearest to a line and column.
    pub(crate) fn field_near(&self, name: &str, line: usize, column: usize) -> Option<&Field> {
        let far = |f: &&Field| {
            let (l, c) = self.line_column(f.span.start);
            (l.abs_diff(line), c.abs_diff(column))
        };
        self.fields.iter().filter(|f| f.name == name).min_by_key(far)
    }

    /// Line and column, from 1, of a byte.
    pub(crate) fn line_column(&self, at: usize) -> (usize, usize) {
        let before = self.text.get(..at).unwrap_or(self.text);
        let line = before.rsplit('\n').next().unwrap_or("");
        (1 + before.matches('\n').count(), 1 + line.chars().count())
    }
}

fn find(bytes: &[u8], from: usize, what: u8) -> usize {
    bytes[from..].iter().position(|b| *b == what).map_or(bytes.len(), |i| from + i)
}

fn end_of_comment(bytes: &[u8], from: usize) -> usize {
    let (mut at, mut depth) = (from, 0usize);
    while at < bytes.len() {
        match (bytes[at], bytes.get(at + 1)) {
            (b'/', Some(b'*')) => (at, depth) = (at + 2, depth + 1),
            (b'*', Some(b'/')) => (at, depth) = (at + 2, depth - 1),
            _ => at += 1,
        }
        if depth == 0 {
            break;
        }
    }
    at.min(bytes.len())
}

fn end_of_quoted(bytes: &[u8], from: usize, quote: u8) -> usize {
    let mut at = from + 1;
    while at < bytes.len() && bytes[at] != quote {
        at += if bytes[at] == b'\\' { 2 } else { 1 };
    }
    (at + 1).min(bytes.len())
}

/// The end of a raw string that starts here.
fn raw_string(bytes: &[u8], from: usize) -> Option<usize> {
    let hashes = bytes[from + 1..].iter().take_while(|b| **b == b'#').count();
    let open = from + 1 + hashes;
    if bytes.get(open) != Some(&b'"') {
        return None;
    }
    let mut at = open + 1;
    while at < bytes.len() {
        if bytes[at] == b'"' && bytes[at + 1..].iter().take(hashes).filter(|b| **b == b'#').count() == hashes {
            return Some(at + 1 + hashes);
        }
        at += 1;
    }
    Some(bytes.len())
}

fn after_colon(bytes: &[u8], from: usize) -> Option<usize> {
    let at = from + bytes[from..].iter().take_while(|b| b.is_ascii_whitespace()).count();
    (bytes.get(at) == Some(&b':')).then_some(at + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn finds_values_through_comments_strings_and_options() {
        let text = "// a: 1\n(\n  name: \"x, (y: 2\", /* b: ( */\n  list: [\n    (at: Ball(r: 1.5)),\n    (at: Ball(r: -2.5), z: r#\"\"),\"#),\n  ],\n  o: Some((p: \"q\")), t: (1, 22, 3),\n)";
        let places = Places::of(text);
        let value = |path: &str| places.value(path);
        assert_eq!(value("name"), (3, 9));
        assert_eq!(value("list[0].at.r"), (5, 18));
        assert_eq!(value("list[1].at.r"), (6, 18));
        assert_eq!(value("list[1].z"), (6, 28));
        assert_eq!(value("o.p"), (8, 15));
        assert_eq!(value("t[1]"), (8, 29));
        assert_eq!(value("list[1].missing"), (6, 5));
        assert_eq!(value("nothing"), (2, 1));
        let field = places.field_near("at", 6, 1).map(|f| &text[f.span.clone()]);
        assert_eq!(field, Some("at: Ball(r: -2.5),"));
    }

    proptest! {
        #[test]
        fn accepts_any_text(text in "(\\PC|[(\\[{}\\]),:\"'/*\n#r\\\\]){0,80}", path in "[a-c.\\[\\]0-9]{0,12}") {
            let places = Places::of(&text);
            let (line, column) = places.value(&path);
            prop_assert!(line >= 1 && column >= 1);
            for field in &places.fields {
                prop_assert!(text.get(field.span.clone()).is_some());
            }
        }
    }
}
