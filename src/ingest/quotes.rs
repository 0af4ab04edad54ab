//! Removes quotes around cells. Few tables have any.

use super::csv_rows::lines_of;
use memchr::memchr;
use std::borrow::Cow;

/// Replaces a comma or a line end within a cell (ASCII unit separator), so that lines can be split at their commas. It
/// occurs in no name or number of a recording.
const WITHIN_CELL: u8 = 0x1f;

/// The lines of a table without quotes around their cells; the same lines, so that their numbers stay.
pub(super) fn without_quotes(table: &[u8]) -> Cow<'_, [u8]> {
    if memchr(b'"', table).is_none() {
        return Cow::Borrowed(table);
    }
    let mut plain = Vec::with_capacity(table.len());
    for line in lines_of(table) {
        append_plain(line, &mut plain);
        plain.push(b'\n');
    }
    Cow::Owned(plain)
}

/// Appends a line without the quotes around its cells. A line with an unclosed quote does not change and is later
/// rejected as malformed: it must not swallow the rows after it.
pub(super) fn append_plain(line: &[u8], plain: &mut Vec<u8>) {
    let mut cells = csv::ByteRecord::new();
    if memchr(b'"', line).is_none() || split_quoted(line, b',', &mut cells).is_err() {
        plain.extend_from_slice(line);
        return;
    }
    for (index, cell) in cells.iter().enumerate() {
        if index > 0 {
            plain.push(b',');
        }
        plain.extend(cell.iter().map(|byte| if matches!(byte, b',' | b'\n' | b'\r') { WITHIN_CELL } else { *byte }));
    }
}

/// Replaces `cells` by those of a line, without the quotes and blanks around them.
///
/// # Errors
/// Says that a quote is not closed: it must not swallow the rows after it.
pub(super) fn split_quoted(line: &[u8], separator: u8, cells: &mut csv::ByteRecord) -> Result<(), &'static str> {
    cells.clear();
    if memchr(b'"', line).is_none() {
        line.split(|byte| *byte == separator).for_each(|cell| cells.push_field(cell.trim_ascii()));
        return Ok(());
    }
    let mut rest = Some(line);
    while let Some(line) = rest {
        let n_blanks = line.iter().take_while(|byte| **byte == b' ').count();
        let mut cell = Vec::new();
        let mut after = line;
        if let Some(mut quoted) = line[n_blanks..].strip_prefix(b"\"") {
            loop {
                let end = memchr(b'"', quoted).ok_or("a quote on it is not closed")?;
                cell.extend_from_slice(&quoted[..end]);
                quoted = &quoted[end + 1..];
                // Two quotes stand for one.
                match quoted.strip_prefix(b"\"") {
                    Some(more) => {
                        cell.push(b'"');
                        quoted = more;
                    }
                    None => break,
                }
            }
            after = quoted;
        }
        let end = memchr(separator, after);
        cell.extend_from_slice(&after[..end.unwrap_or(after.len())]);
        cells.push_field(cell.trim_ascii());
        rest = end.map(|end| &after[end + 1..]);
    }
    Ok(())
}

/// A cell for messages: with its commas, and without other control characters.
pub(super) fn printable(cell: &[u8]) -> String {
    const MAX_CHARS: usize = 40;
    let text = String::from_utf8_lossy(cell.trim_ascii());
    text.chars()
        .take(MAX_CHARS)
        .map(|c| match c {
            _ if c == char::from(WITHIN_CELL) => ',',
            c if c.is_control() => char::REPLACEMENT_CHARACTER,
            c => c,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(table: &str) -> String {
        String::from_utf8_lossy(&without_quotes(table.as_bytes())).into_owned()
    }

    #[test]
    fn quotes_around_cells_go_and_their_content_stays() {
        assert_eq!(plain("1,\"car\",\"2.5\"\r\n2,bus,3\n"), "1,car,2.5\n2,bus,3\n");
        assert_eq!(plain("\"say \"\"go\"\"\",x"), "say \"go\",x\n");
        assert_eq!(plain("\"1,5\",\"\",2"), "1\u{1f}5,,2\n");
        assert!(matches!(without_quotes(b"1,2\r\n3"), Cow::Borrowed(b"1,2\r\n3")));
        assert_eq!(printable("1\u{1f}5\u{7}".as_bytes()), "1,5\u{fffd}");
    }

    #[test]
    fn cells_are_split_at_any_separator() {
        let cells = |line: &str, separator| {
            let mut cells = csv::ByteRecord::new();
            split_quoted(line.as_bytes(), separator, &mut cells)
                .map(|()| cells.iter().map(|cell| String::from_utf8_lossy(cell).into_owned()).collect::<Vec<_>>())
        };
        let found = cells("1; \"a;b\" ;\"say \"\"go\"\"\";", b';');
        assert_eq!(found, Ok(vec!["1", "a;b", "say \"go\"", ""].into_iter().map(str::to_owned).collect()));
        assert_eq!(cells(" 1\t\t 2.5", b'\t').unwrap(), ["1", "", "2.5"]);
        assert_eq!(cells("5'10\",2", b','), Ok(vec!["5'10\"".to_owned(), "2".to_owned()]));
        assert!(cells("1,\"2,3", b',').is_err());
    }

    #[test]
    fn a_quote_that_is_not_closed_costs_its_line_alone() {
        assert_eq!(plain("\"1,2\n\"3\",4\n"), "\"1,2\n3,4\n");
    }
}
