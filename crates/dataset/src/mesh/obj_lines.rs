//! The lines of OBJ and MTL files as `tobj` can read them: UTF-8, with every number checked that it relies on.

use std::{
    collections::HashSet,
    io::{BufRead, Read},
};

use super::file::{decode, excerpt};

/// Hands out a file line by line; a line is changed or dropped by `edit`, whose error ends the file.
pub(super) struct Lines<'a, F> {
    rest: &'a [u8],
    /// The line that is being read, and how much of it has been.
    line: Vec<u8>,
    read: usize,
    /// Its number, from 1.
    number: usize,
    edit: F,
    /// Why the file ended early.
    error: Option<String>,
}

impl<'a, F: FnMut(&str, usize) -> Result<Option<String>, String>> Lines<'a, F> {
    pub fn new(bytes: &'a [u8], edit: F) -> Self {
        Self { rest: bytes, line: Vec::new(), read: 0, number: 0, edit, error: None }
    }

    /// What is wrong, with the line that was read last.
    pub fn explain(&self, error: &tobj::LoadError) -> String {
        match &self.error {
            Some(reason) => format!("line {}: {reason}", self.number),
            None => {
                format!("line {}: {}: {error}", self.number, excerpt(&String::from_utf8_lossy(&self.line)))
            }
        }
    }
}

impl<F: FnMut(&str, usize) -> Result<Option<String>, String>> Read for Lines<'_, F> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.fill_buf()?.read(buffer)?;
        self.consume(read);
        Ok(read)
    }
}

impl<F: FnMut(&str, usize) -> Result<Option<String>, String>> BufRead for Lines<'_, F> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        while self.read == self.line.len() && !self.rest.is_empty() {
            let end = self.rest.iter().position(|&b| b == b'\n').map_or(self.rest.len(), |i| i + 1);
            let (line, rest) = self.rest.split_at(end);
            self.rest = rest;
            self.number += 1;
            self.line.clear();
            self.read = 0;
            match (self.edit)(decode(line).trim_start_matches('\u{feff}').trim(), self.number) {
                Ok(Some(text)) => self.line.extend(text.bytes().chain(*b"\n")),
                Ok(None) => {}
                Err(reason) => {
                    self.error = Some(reason);
                    return Err(std::io::ErrorKind::InvalidData.into());
                }
            }
        }
        Ok(&self.line[self.read..])
    }

    fn consume(&mut self, amount: usize) {
        self.read = (self.read + amount).min(self.line.len());
    }
}

/// What has been met of an OBJ file.
#[derive(Debug, Default)]
pub(super) struct ObjCheck {
    /// Vertices, texture coordinates and normals so far.
    counts: [usize; 3],
    /// Largest index into each of them, and its line.
    largest: [(usize, usize); 3],
    /// Whether any vertex has a colour.
    pub colored: bool,
    /// Names of material libraries.
    libraries: HashSet<String>,
}

/// Material libraries that a file may have.
const MOST_LIBRARIES: usize = 64;
const LISTS: [&str; 3] = ["vertex", "texture coordinate", "normal"];

impl ObjCheck {
    /// Whether any vertex of the file has a colour, as `x y z red green blue`.
    pub fn new(bytes: &[u8]) -> Self {
        let colored = |line: &[u8]| {
            let text = line.split(|&b| b == b'#').next().unwrap_or_default();
            let mut words = text.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
            words.next() == Some(b"v") && words.count() >= 6
        };
        Self { colored: bytes.split(|&b| b == b'\n').any(colored), ..Self::default() }
    }

    /// A line for `tobj`; none where it holds nothing of a surface.
    pub fn edit(&mut self, line: &str, number: usize) -> Result<Option<String>, String> {
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let named = ["usemtl", "mtllib", "o", "g"].contains(&word);
        let rest = if named { rest } else { rest.split('#').next().unwrap_or_default() }.trim();
        match word {
            "v" => {
                self.counts[0] += 1;
                // Where some vertices have a colour, all must: NaN stands for none.
                let numbers = rest.split_whitespace();
                match (self.colored, numbers.clone().count()) {
                    (true, 3) => return Ok(Some(format!("v {rest} NaN NaN NaN"))),
                    (true, 7) => {
                        let kept: Vec<&str> = numbers.take(6).collect();
                        return Ok(Some(format!("v {}", kept.join(" "))));
                    }
                    (true, 4) => return Err(format!("{}: a weight beside vertex colours", excerpt(line))),
                    _ => {}
                }
            }
            "vt" => self.counts[1] += 1,
            "vn" => self.counts[2] += 1,
            "f" => {
                let corners = rest.split_whitespace();
                for corner in corners.clone() {
                    self.corner(corner, number)?;
                }
                if corners.count() < 3 {
                    return Ok(None);
                }
            }
            "usemtl" | "mtllib" if rest.is_empty() => return Ok(None),
            // A library that is named again and again is read once.
            "mtllib" if !self.libraries.insert(rest.to_owned()) || self.libraries.len() > MOST_LIBRARIES => {
                return Ok(None);
            }
            _ if named => {}
            _ => return Ok(None),
        }
        Ok(Some(format!("{word} {rest}")))
    }

    fn corner(&mut self, corner: &str, number: usize) -> Result<(), String> {
        for (list, index) in corner.split('/').enumerate().filter(|(_, index)| !index.is_empty()) {
            let bad = || format!("corner {} of a face, expected vertex/texture/normal", excerpt(corner));
            let value: i64 = index.parse().map_err(|_| bad())?;
            let (Some(name), Some(&count)) = (LISTS.get(list), self.counts.get(list)) else {
                return Err(bad());
            };
            let size = usize::try_from(value.unsigned_abs()).unwrap_or(usize::MAX);
            // Index 0 of a texture coordinate or normal stands for none.
            let none = value == 0 && list == 0;
            if none || (value < 0 && size > count) || size > u32::MAX as usize {
                return Err(format!("a face refers to {name} {value}, but there are {count} so far"));
            }
            if value > 0 && size > self.largest[list].0 {
                self.largest[list] = (size, number);
            }
        }
        Ok(())
    }

    /// The first index that is none of the whole file's.
    pub fn out_of_range(&self) -> Option<String> {
        (0..3).find(|&list| self.largest[list].0 > self.counts[list]).map(|list| {
            let ((index, line), count, name) = (self.largest[list], self.counts[list], LISTS[list]);
            format!("line {line}: a face refers to {name} {index}, but there are only {count}")
        })
    }
}

/// A line of a material file for `tobj`: names, base colours and their pictures.
pub(super) fn edit_mtl(line: &str) -> Option<String> {
    let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
    let rest = rest.trim();
    let numbers = || rest.split_whitespace().map_while(|n| n.parse::<f32>().ok()).take(3).count();
    let kept = match word {
        "newmtl" | "map_Kd" => !rest.is_empty(),
        "Kd" => numbers() == 3,
        _ => false,
    };
    kept.then(|| format!("{word} {rest}"))
}
