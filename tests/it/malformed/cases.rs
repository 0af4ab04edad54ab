//! The cases: a text of `cases.txt` each.

use super::inputs::{Input, parquet};

/// A change of a good input, and what comes of it.
pub(super) struct Case {
    pub(super) name: &'static str,
    pub(super) input: Input,
    pub(super) file: &'static str,
    pub(super) edits: Vec<Edit>,
    pub(super) then: Then,
    /// Parts of what is said: the file, the place in it, what was expected or what to do.
    pub(super) says: Vec<&'static str>,
}

/// A change of a file.
pub(super) enum Edit {
    Whole(String),
    /// To so many percent of its length.
    Cut(usize),
    /// The first or last occurrence of a text, or all.
    Replace(Which, String, String),
    Made,
    Gone,
}

pub(super) enum Which {
    First,
    Last,
    All,
}

/// What happens.
pub(super) enum Then {
    /// The program ends with code 1.
    Ends,
    /// The recording is rejected: the program ends with code 1, and goes on if there is another recording.
    Rejected,
    /// What is wrong is left out and counted.
    GoesOn,
}

pub(super) fn cases() -> Vec<Case> {
    let (mut cases, mut changed) = (Vec::new(), None);
    for line in include_str!("cases.txt").lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        add(line, &mut cases, &mut changed).unwrap_or_else(|| panic!("cases.txt does not say a case: {line}"));
    }
    cases
}

/// Adds a line; `changed` is the file that the cases from here on change. `None` if it does not say what it should.
fn add(line: &'static str, cases: &mut Vec<Case>, changed: &mut Option<(Input, &'static str)>) -> Option<()> {
    if let Some(names) = line.strip_prefix('[') {
        let (input, file) = names.strip_suffix(']')?.split_once(' ')?;
        *changed = Some((Input::ALL.into_iter().find(|known| format!("{known:?}") == input)?, file));
        return Some(());
    }
    let Some(line) = line.strip_prefix("    ") else {
        let (name, then) = line.rsplit_once(": ")?;
        let then = match then {
            "ends" => Then::Ends,
            "is rejected" => Then::Rejected,
            "goes on" => Then::GoesOn,
            _ => return None,
        };
        let (input, file) = (*changed)?;
        cases.push(Case { name, input, file, edits: Vec::new(), then, says: Vec::new() });
        return Some(());
    };
    let case = cases.last_mut()?;
    let (sign, text) = line.split_once(' ').unwrap_or((line, ""));
    let replace = |which| Edit::Replace(which, unescaped(text), String::new());
    let edit = match sign {
        ">" => {
            case.says.extend(text.split(" | "));
            return Some(());
        }
        "+" => match case.edits.pop()? {
            Edit::Replace(which, from, _) => Edit::Replace(which, from, unescaped(text)),
            _ => return None,
        },
        "-" => replace(Which::First),
        "-last" => replace(Which::Last),
        "-all" => replace(Which::All),
        "=" => Edit::Whole(unescaped(text)),
        "cut" => Edit::Cut(text.parse().ok()?),
        "made" => Edit::Made,
        "gone" => Edit::Gone,
        _ => return None,
    };
    case.edits.push(edit);
    Some(())
}

fn unescaped(text: &str) -> String {
    text.replace("\\n", "\n")
}

pub(super) fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The changes that are more than texts for texts.
pub(super) fn made(name: &str, bytes: &[u8]) -> Vec<u8> {
    match name {
        "a mapping in Latin-1" => [b"# stra\xdfe\n", bytes].concat(),
        "milliseconds for seconds" => each_line(bytes, |i, line| {
            line.replacen(&format!("7,{},", (i as f64 - 1.0) / 10.0), &format!("7,{i}00,"), 1)
        }),
        "degrees for meters" => each_line(bytes, |i, line| {
            line.replacen(&format!(",{},-1.75", i as i64 - 1), &format!(",8.40000{i:02},49.01"), 1)
        }),
        "UTF-16" => [0xfeff].into_iter().chain(text(bytes).encode_utf16()).flat_map(u16::to_le_bytes).collect(),
        "Latin-1" => [&bytes[..bytes.len() - 4], b"c\xe4r\n"].concat(),
        "no text" => b"\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00".to_vec(),
        "too short" => text(bytes).split_inclusive('\n').take(21).collect::<String>().into_bytes(),
        "text in a column of numbers" => parquet(&["id", "t", "x", "y", "h", "l", "w", "c"], &["x"]),
        "Parquet without a column" => parquet(&["id", "t", "x", "north", "h", "l", "w", "c"], &[]),
        "a map in no encoding" => [bytes, b"<!-- \xff -->"].concat(),
        "a road without lanes" => {
            let text = text(bytes);
            [&text[..text.rfind("<laneSection").unwrap()], &text[text.rfind("</lanes>").unwrap()..]].concat().into()
        }
        "an obstacle without a beginning" => {
            let text = text(bytes);
            let (before, after) = text.rsplit_once("<initialState>").unwrap();
            [before, "<firstState>", &after.replace("</initialState>", "</firstState>")].concat().into()
        }
        "a scenario of two seconds" => {
            let text = text(bytes);
            let begins: Vec<usize> = text.match_indices("<state>").map(|(at, _)| at).collect();
            let ends: Vec<usize> = text.match_indices("</trajectory>").map(|(at, _)| at).collect();
            [&text[..begins[20]], &text[ends[0]..begins[79]], &text[ends[1]..]].concat().into()
        }
        _ => panic!("{name} is not made here"),
    }
}

fn each_line(bytes: &[u8], change: impl Fn(usize, &str) -> String) -> Vec<u8> {
    text(bytes).split_inclusive('\n').enumerate().map(|(i, line)| change(i, line)).collect::<String>().into()
}
