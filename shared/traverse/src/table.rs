//! A CSV file of numbers, checked cell by cell.

use crate::{Input, InputError};
use std::io::{BufRead, BufReader, Read};
use std::ops::{Range, RangeInclusive};

/// Longest pause between two rows of one file, and between the first rows of two files [s]. A longer one is a clock
/// that jumped, or two clocks.
pub const GAP_MAX_S: f64 = 86_400.0;
/// Largest instant [s]: 1e10 s are 317 years, and fit into 64 bits as nanoseconds.
const TAKEN_S_MAX: f64 = 1e10;
/// Longest line [bytes].
const LINE_BYTES_MAX: usize = 1 << 16;
/// Characters of a cell that an error quotes.
const QUOTE_CHARS: usize = 24;

/// A table whose first line names its columns, read row by row. Column 0 is the one that was bound first.
pub struct Table {
    file: String,
    reader: BufReader<Input>,
    /// The current line, and where its cells stand in it.
    text: String,
    cells: Vec<Range<usize>>,
    /// The columns' names, and which cell of a line holds each.
    names: Vec<String>,
    columns: Vec<Option<usize>>,
    rows: u64,
    line: u64,
    taken_ns: Option<u64>,
}

impl Table {
    /// Reads the header. `file` is the name that errors give.
    ///
    /// # Errors
    /// Where there is no header, or it names a column twice.
    pub fn open(file: &str, input: Input) -> Result<Self, InputError> {
        let mut table = Self {
            file: file.into(),
            reader: BufReader::new(input),
            text: String::new(),
            cells: Vec::new(),
            names: Vec::new(),
            columns: Vec::new(),
            rows: 0,
            line: 0,
            taken_ns: None,
        };
        if !table.next_line()? {
            return Err(table.fault("the file is empty; its first line must name the columns"));
        }
        table.names = table
            .cells
            .iter()
            .map(|cell| table.text[cell.clone()].to_owned())
            .collect();
        if table.names.len() == 1 && table.names[0].contains([';', '\t']) {
            return Err(table.fault("the columns must be separated by commas"));
        }
        for (index, name) in table.names.iter().enumerate() {
            if table.names[..index].contains(name) {
                return Err(table.fault(format!("column {} is there twice; remove one", quote(name))));
            }
        }
        table.columns = (0..table.names.len()).map(Some).collect();
        Ok(table)
    }

    /// Names the columns that may stand in the file, in any order: from now on column `i` is `required[i]`, and after
    /// these come the `optional` ones.
    ///
    /// # Errors
    /// Where a column is unknown or missing.
    pub fn bind(&mut self, required: &[&str], optional: &[&str]) -> Result<(), InputError> {
        let known: Vec<&str> = required.iter().chain(optional).copied().collect();
        let expected = match optional {
            [] => required.join(","),
            _ => format!("{}[,{}]", required.join(","), optional.join(",")),
        };
        if let Some(name) = self.names.iter().find(|name| !known.contains(&name.as_str())) {
            let what = format!("unknown column {}; the columns are {expected}", quote(name));
            return Err(self.fault(what));
        }
        self.columns = known
            .iter()
            .map(|name| self.names.iter().position(|other| other == name))
            .collect();
        if let Some(index) = (0..required.len()).find(|index| self.columns[*index].is_none()) {
            let what = format!("column \"{}\" is missing; the columns are {expected}", known[index]);
            return Err(self.fault(what));
        }
        self.names = known.into_iter().map(str::to_owned).collect();
        Ok(())
    }

    /// The names of the columns.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number of the current row, the first being 0.
    #[must_use]
    pub fn row(&self) -> u64 {
        self.rows.saturating_sub(1)
    }

    /// The line at which the current row stands.
    #[must_use]
    pub fn line(&self) -> u64 {
        self.line
    }

    /// Goes to the next row; `false` behind the last one.
    ///
    /// # Errors
    /// Where the row cannot be read, has too few or too many cells, or the table has no row at all.
    pub fn next_row(&mut self) -> Result<bool, InputError> {
        if !self.next_line()? {
            return match self.rows {
                0 => Err(self.fault("there is no row; leave the file out if the sensor was not there")),
                _ => Ok(false),
            };
        }
        self.rows += 1;
        let columns = self.columns.iter().flatten().count();
        if self.cells.len() != columns {
            let what = format!("{} cells where the header names {columns} columns", self.cells.len());
            return Err(self.fault(what));
        }
        Ok(true)
    }

    /// A cell of the current row as text; empty where the column is not in the file.
    #[must_use]
    pub fn text(&self, column: usize) -> &str {
        let cell = self.columns.get(column).copied().flatten();
        let range = cell.and_then(|cell| self.cells.get(cell)).cloned();
        range.and_then(|range| self.text.get(range)).unwrap_or("")
    }

    /// A cell of the current row as a number in `range`, NaN where the cell is empty or `nan` or the column is not in the file.
    ///
    /// # Errors
    /// Where the cell holds anything else.
    pub fn number(&self, column: usize, range: RangeInclusive<f64>) -> Result<f64, InputError> {
        let text = self.text(column);
        // Some programs write a missing value so.
        if text.is_empty() || text.eq_ignore_ascii_case("nan") {
            return Ok(f64::NAN);
        }
        let remedy = "write one like -1.25e3, or leave the cell empty if the value is missing";
        self.parse(column, range, remedy)
    }

    /// The same, for a value that may not be missing.
    ///
    /// # Errors
    /// Where the cell is empty or holds anything but a number in `range`.
    pub fn required(&self, column: usize, range: RangeInclusive<f64>) -> Result<f64, InputError> {
        self.parse(column, range, "write one like -1.25e3; here it may not be missing")
    }

    fn parse(&self, column: usize, range: RangeInclusive<f64>, remedy: &str) -> Result<f64, InputError> {
        let value = self.text(column).parse().ok().filter(|value: &f64| value.is_finite());
        let Some(value) = value else {
            return Err(self.cell_fault(column, &format!("is not a number; {remedy}")));
        };
        if !range.contains(&value) {
            let what = format!(
                "is out of range; it must lie in {:?} to {:?}",
                range.start(),
                range.end()
            );
            return Err(self.cell_fault(column, &what));
        }
        Ok(value)
    }

    /// The instant of the current row, from column 0 (`taken_s`) or the one given, not before the last row's.
    ///
    /// # Errors
    /// Where it is missing, negative, earlier than the last row's, or far after it.
    pub fn taken_ns(&mut self, column: usize) -> Result<u64, InputError> {
        let taken_s = self.required(column, 0.0..=TAKEN_S_MAX)?;
        let taken_ns = (taken_s * 1e9).round() as u64;
        if let Some(last_ns) = self.taken_ns {
            let gap_s = (taken_ns as f64 - last_ns as f64) / 1e9;
            if taken_ns < last_ns {
                let what = format!("lies {:.9} s before the row above; sort the rows by time", -gap_s);
                return Err(self.cell_fault(column, &what));
            }
            if gap_s > GAP_MAX_S {
                let what =
                    format!("lies {gap_s:.0} s after the row above; at most {GAP_MAX_S:.0}, so split the traverse");
                return Err(self.cell_fault(column, &what));
            }
        }
        self.taken_ns = Some(taken_ns);
        Ok(taken_ns)
    }

    /// An error at the current line.
    #[must_use]
    pub fn fault(&self, what: impl Into<String>) -> InputError {
        InputError::new(&self.file, self.line, what)
    }

    /// An error in a cell of the current row: names the column and quotes the cell.
    #[must_use]
    pub fn cell_fault(&self, column: usize, what: &str) -> InputError {
        let name = self.names.get(column).map_or("", String::as_str);
        self.fault(format!("{name}: {} {what}", quote(self.text(column))))
    }

    /// Reads the next line that is not blank and finds its cells; `false` at the end of the file.
    fn next_line(&mut self) -> Result<bool, InputError> {
        let mut bytes = std::mem::take(&mut self.text).into_bytes();
        loop {
            bytes.clear();
            self.line += 1;
            let limit = LINE_BYTES_MAX as u64;
            let read = self.reader.by_ref().take(limit).read_until(b'\n', &mut bytes);
            match read {
                Err(error) => return Err(self.fault(format!("cannot be read: {error}"))),
                Ok(0) => return Ok(false),
                Ok(LINE_BYTES_MAX) => return Err(self.fault("the line is too long; this is not a table")),
                Ok(_) => (),
            }
            if self.line == 1 && bytes.starts_with(b"\xef\xbb\xbf") {
                bytes.drain(..3);
            }
            if !bytes.trim_ascii().is_empty() {
                break;
            }
        }
        match String::from_utf8(bytes) {
            Ok(text) => self.text = text,
            Err(_) => return Err(self.fault("this is not text; save the file as UTF-8")),
        }
        split(&self.text, &mut self.cells);
        Ok(true)
    }
}

/// Finds the cells of a line: separated by commas, without the blanks and the quotes around them.
fn split(line: &str, cells: &mut Vec<Range<usize>>) {
    cells.clear();
    let mut start = 0;
    let mut quoted = false;
    let ends = line.bytes().enumerate().filter_map(|(index, byte)| {
        quoted ^= byte == b'"';
        (byte == b',' && !quoted).then_some(index)
    });
    for end in ends.chain([line.len()]) {
        let blank = |byte: &u8| byte.is_ascii_whitespace();
        let mut range = start..end;
        while range.end > range.start && blank(&line.as_bytes()[range.end - 1]) {
            range.end -= 1;
        }
        while range.end > range.start && blank(&line.as_bytes()[range.start]) {
            range.start += 1;
        }
        let cell = &line.as_bytes()[range.clone()];
        if let [b'"', .., b'"'] = cell {
            range = range.start + 1..range.end - 1;
        }
        cells.push(range);
        start = end + 1;
    }
}

/// A cell as an error quotes it, shortened where it is long.
fn quote(text: &str) -> String {
    let mut short: String = text.chars().take(QUOTE_CHARS).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("{short:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &'static str) -> Result<Table, InputError> {
        let mut table = Table::open("a.csv", Box::new(text.as_bytes()))?;
        table.bind(&["taken_s", "load_n"], &["slip"])?;
        Ok(table)
    }

    fn error(text: &'static str) -> String {
        let rows = || {
            let mut table = table(text)?;
            while table.next_row()? {
                table.taken_ns(0)?;
                table.number(1, -1e6..=1e6)?;
                table.number(2, -1e3..=1e3)?;
            }
            Ok::<(), InputError>(())
        };
        rows().expect_err("an error").to_string()
    }

    #[test]
    fn columns_are_found_in_any_order_and_missing_ones_are_nan() {
        let mut table = table("load_n,taken_s\n9.5,0.25\n,1\n").unwrap();
        assert!(table.next_row().unwrap());
        assert_eq!((table.row(), table.line()), (0, 2));
        assert_eq!(table.taken_ns(0).unwrap(), 250_000_000);
        assert_eq!(table.number(1, 0.0..=10.0).unwrap(), 9.5);
        assert!(table.number(2, 0.0..=10.0).unwrap().is_nan());
        assert!(table.next_row().unwrap());
        assert!(table.number(1, 0.0..=10.0).unwrap().is_nan());
        assert!(!table.next_row().unwrap());
    }

    #[test]
    fn a_byte_order_mark_crlf_spaces_and_blank_lines_do_no_harm() {
        let mut table = table("\u{feff}taken_s, load_n\r\n\r\n 0.5 ,\t-2e1\r\n").unwrap();
        assert!(table.next_row().unwrap());
        assert_eq!(table.line(), 3);
        assert_eq!(table.taken_ns(0).unwrap(), 500_000_000);
        assert_eq!(table.number(1, -100.0..=0.0).unwrap(), -20.0);
        assert!(!table.next_row().unwrap());
    }

    #[test]
    fn errors_name_file_line_column_and_remedy() {
        for (text, expected) in [
            ("", "a.csv:1: the file is empty; its first line must name the columns"),
            (
                "\n\n",
                "a.csv:3: the file is empty; its first line must name the columns",
            ),
            (
                "taken_s,load_n\n",
                "a.csv:2: there is no row; leave the file out if the sensor was not there",
            ),
            (
                "taken_s;load_n\n0;1\n",
                "a.csv:1: the columns must be separated by commas",
            ),
            (
                "taken_s,load_n,taken_s\n",
                "a.csv:1: column \"taken_s\" is there twice; remove one",
            ),
            (
                "taken_s,load_kg\n0,1\n",
                "a.csv:1: unknown column \"load_kg\"; the columns are taken_s,load_n[,slip]",
            ),
            (
                "taken_s,slip\n0,1\n",
                "a.csv:1: column \"load_n\" is missing; the columns are taken_s,load_n[,slip]",
            ),
            (
                "taken_s,load_n\n0,1\n1\n",
                "a.csv:3: 1 cells where the header names 2 columns",
            ),
            (
                "taken_s,load_n\r\n0,1\r\n1,2,3\r\n",
                "a.csv:3: 3 cells where the header names 2 columns",
            ),
            (
                "taken_s,load_n\r\n0,1\r\n1,abc\r\n",
                "a.csv:3: load_n: \"abc\" is not a number; write one like -1.25e3, or leave the cell empty if the value is missing",
            ),
            (
                "taken_s,load_n\n0,inf\n",
                "a.csv:2: load_n: \"inf\" is not a number; write one like -1.25e3, or leave the cell empty if the value is missing",
            ),
            (
                "taken_s,load_n\n0,1e999\n",
                "a.csv:2: load_n: \"1e999\" is not a number; write one like -1.25e3, or leave the cell empty if the value is missing",
            ),
            (
                "taken_s,load_n\n0,1e7\n",
                "a.csv:2: load_n: \"1e7\" is out of range; it must lie in -1000000.0 to 1000000.0",
            ),
            (
                "taken_s,load_n\n,1\n",
                "a.csv:2: taken_s: \"\" is not a number; write one like -1.25e3; here it may not be missing",
            ),
            (
                "taken_s,load_n\n-1,1\n",
                "a.csv:2: taken_s: \"-1\" is out of range; it must lie in 0.0 to 10000000000.0",
            ),
            (
                "taken_s,load_n\n1,1\n\n0.5,1\n",
                "a.csv:4: taken_s: \"0.5\" lies 0.500000000 s before the row above; sort the rows by time",
            ),
            (
                "taken_s,load_n\n1,1\n1e9,1\n",
                "a.csv:3: taken_s: \"1e9\" lies 999999999 s after the row above; at most 86400, so split the traverse",
            ),
        ] {
            assert_eq!(error(text), expected, "{text:?}");
        }
    }

    #[test]
    fn bytes_that_are_no_text_are_refused_with_their_line() {
        let bytes: &[u8] = b"taken_s,load_n\n0,1\n1,\xff\xfe\n";
        let mut table = Table::open("a.csv", Box::new(bytes)).unwrap();
        assert!(table.next_row().unwrap());
        let error = table.next_row().unwrap_err().to_string();
        assert_eq!(error, "a.csv:3: this is not text; save the file as UTF-8");
    }

    #[test]
    fn quoted_cells_may_hold_commas() {
        let line = "\"a, b.png\",1 , \"\",,\"";
        let mut cells = Vec::new();
        split(line, &mut cells);
        let texts: Vec<&str> = cells.iter().map(|cell| &line[cell.clone()]).collect();
        assert_eq!(texts, ["a, b.png", "1", "", "", "\""]);
    }

    #[test]
    fn a_file_without_line_ends_is_refused_before_it_fills_the_memory() {
        let error = Table::open("a.csv", Box::new(std::io::repeat(b'0'))).err().unwrap();
        assert_eq!(error.to_string(), "a.csv:1: the line is too long; this is not a table");
    }

    #[test]
    fn a_long_cell_is_quoted_short() {
        let long = "x".repeat(100_000);
        assert_eq!(quote(&long), format!("\"{}…\"", "x".repeat(24)));
    }
}
