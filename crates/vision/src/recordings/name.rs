//! What the names of dashcams' and action cameras' files say: when a file begins, which camera it shows, and which chapter
//! of a recording it is.

use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use std::path::Path;

/// Words for the place of a camera, and what they mean.
const WORDS: [(&str, &str); 13] = [
    ("front", "front"),
    ("rear", "rear"),
    ("back", "rear"),
    ("interior", "interior"),
    ("inside", "interior"),
    ("cabin", "interior"),
    ("left_repeater", "left"),
    ("right_repeater", "right"),
    ("left_pillar", "left pillar"),
    ("right_pillar", "right pillar"),
    ("left", "left"),
    ("right", "right"),
    ("tele", "telephoto"),
];

/// What a file's name says.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FileName {
    /// When it begins, by the camera's clock.
    pub time: Option<DateTime>,
    /// The camera, such as `front`; empty if the name has no mark for it.
    pub view: String,
    /// The mark for the camera, as it is written in the name; empty if there is none.
    pub mark: String,
    /// The pieces by which names are sorted.
    pub order: Vec<Piece>,
    /// The chapter of a recording, for GoPro.
    chapter: Option<Chapter>,
}

/// A chapter of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Chapter {
    recording: u32,
    /// From 1.
    number: u32,
}

/// A piece of a name, for sorting: `clip2` comes before `clip10`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Piece {
    Number(u64),
    Text(String),
}

/// What a last letter behind a number says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Letter {
    /// The camera.
    IsMark,
    /// The camera, if the name has a time.
    IsMarkBehindTime,
}

/// A name that ends in a number and a letter: `FILE0001F`.
pub(super) struct NumberedName {
    /// Folder and name without the letter, in small letters.
    pub before: String,
    /// In lower case.
    pub letter: u8,
}

/// Splits a last letter from the number before it, also with a separator between them.
pub(super) fn numbered(path: &Path) -> Option<NumberedName> {
    let stem = path.with_extension("").to_string_lossy().to_ascii_lowercase();
    let letter = stem.bytes().next_back().filter(u8::is_ascii_alphabetic)?;
    let before = &stem[..stem.len() - 1];
    if !ends_in_number(before) {
        return None;
    }
    Some(NumberedName {
        before: before.to_owned(),
        letter,
    })
}

/// True if nothing but a separator follows a number.
fn ends_in_number(text: &str) -> bool {
    text.trim_end_matches(['_', '-']).ends_with(|c: char| c.is_ascii_digit())
}

impl FileName {
    pub(super) fn of(path: &Path) -> Self {
        Self::read(path, Letter::IsMarkBehindTime)
    }

    pub(super) fn read(path: &Path, letter: Letter) -> Self {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let time = time(&stem);
        let chapter = chapter(&stem);
        let (view, mark) = view(&stem, time.is_some(), letter);
        let order = match chapter {
            // The recording comes before the chapter in time, and behind it in the name.
            Some(Chapter { recording, number }) => vec![
                Piece::Text("g".to_owned()),
                Piece::Number(recording.into()),
                Piece::Number(number.into()),
            ],
            None => pieces(&stem),
        };
        Self {
            time,
            view: view.to_owned(),
            mark: mark.to_owned(),
            order,
            chapter,
        }
    }

    /// True if it is the next chapter of the recording of `before`.
    pub(super) fn continues(&self, before: &Self) -> bool {
        let (Some(own), Some(other)) = (self.chapter, before.chapter) else {
            return false;
        };
        own.recording == other.recording && own.number == other.number + 1
    }

    /// When it begins, nanoseconds since the Unix epoch: cameras write local time.
    pub(super) fn started_ns(&self) -> Option<u64> {
        let zoned = self.time?.to_zoned(TimeZone::system()).ok()?;
        u64::try_from(zoned.timestamp().as_nanosecond()).ok()
    }
}

/// The time in a name: year to second as digits, with a separator or none between them. `2026_1120_080001_F`,
/// `20261120_080001_NF`, `NO20261120-080001-000123F`, `2026-11-20_08-00-01-front`; or, as Nextbase writes it, with two
/// digits of the year: `261120_080001_001_FH`, `FILE261120-080001F`.
fn time(stem: &str) -> Option<DateTime> {
    let bytes = stem.as_bytes();
    let mut before = None;
    for (at, byte) in bytes.iter().enumerate() {
        let begins_number = byte.is_ascii_digit() && !before.is_some_and(u8::is_ascii_digit);
        if begins_number && let Some(time) = time_at(&stem[at..]) {
            return Some(time);
        }
        before = Some(byte);
    }
    None
}

fn time_at(text: &str) -> Option<DateTime> {
    short_time_at(text).or_else(|| long_time_at(text))
}

/// Six digits of a date, a separator, and six of a time, behind which there are no more.
fn short_time_at(text: &str) -> Option<DateTime> {
    let (date, after) = text.split_at_checked(6)?;
    let (time, after) = after.strip_prefix(['_', '-'])?.split_at_checked(6)?;
    number(date)?;
    number(time)?;
    if after.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    long_time_at(&format!("20{date}{time}"))
}

fn long_time_at(mut text: &str) -> Option<DateTime> {
    let mut next = |digits: usize| {
        let from = text.strip_prefix(['_', '-', '.', ' ', 'T', 'h', 'm']).unwrap_or(text);
        let (read, after) = from.split_at_checked(digits)?;
        text = after;
        number(read)
    };
    let year = i16::try_from(next(4)?).ok()?;
    let mut next_two = || i8::try_from(next(2)?).ok();
    let month = next_two()?;
    let day = next_two()?;
    let hour = next_two()?;
    let minute = next_two()?;
    let second = next_two()?;
    // Other years are other numbers.
    if !(2000..2100).contains(&year) {
        return None;
    }
    DateTime::new(year, month, day, hour, minute, second, 0).ok()
}

/// A number that is written with digits alone.
fn number(text: &str) -> Option<u32> {
    if text.bytes().all(|byte| byte.is_ascii_digit()) {
        text.parse().ok()
    } else {
        None
    }
}

/// The recording and the chapter in a GoPro's name: `GX010123` is the first of recording 123, `GOPR0123` too, and `GP010123`
/// is the second.
fn chapter(stem: &str) -> Option<Chapter> {
    let stem = stem.to_ascii_uppercase();
    if let Some(recording) = stem.strip_prefix("GOPR") {
        return Some(Chapter {
            recording: recording_number(recording)?,
            number: 1,
        });
    }
    let (kind, digits) = stem.split_at_checked(2)?;
    let written_before = match kind {
        "GH" | "GX" | "GL" => 0,
        // The first is `GOPR`.
        "GP" => 1,
        _ => return None,
    };
    let (chapter, recording) = digits.split_at_checked(2)?;
    Some(Chapter {
        recording: recording_number(recording)?,
        number: number(chapter)? + written_before,
    })
}

/// The number of a recording, which has four digits.
fn recording_number(text: &str) -> Option<u32> {
    if text.len() == 4 { number(text) } else { None }
}

/// The camera that a file shows, and the mark in its name: a word at the end, or behind a time a letter, which another may
/// precede for the mode of recording (`NF`, `PR`) or follow for the size (`FH`, `NFS`). Without a time it may be a single
/// letter behind a number. Both are empty if it has none.
fn view(stem: &str, has_time: bool, letter: Letter) -> (&'static str, &str) {
    let lower = stem.to_ascii_lowercase();
    for (word, view) in WORDS {
        if let Some(before) = lower.strip_suffix(word)
            && !before.ends_with(|c: char| c.is_ascii_alphabetic())
        {
            return (view, &stem[before.len()..]);
        }
    }
    let letters = lower.bytes().rev().take_while(u8::is_ascii_alphabetic).count();
    let mark_begins = stem.len() - letters;
    let is_letter_of_number = letters == 1 && ends_in_number(&stem[..mark_begins]);
    let may_be_a_mark = has_time || (letter == Letter::IsMark && is_letter_of_number);
    if !may_be_a_mark {
        return ("", "");
    }
    let view = match lower.as_bytes()[mark_begins..] {
        [letter] | [letter, b'h' | b'l'] | [_, letter] => of_letter(letter),
        [_, letter, b's'] => match of_letter(letter) {
            "front" => "front (small copy)",
            "rear" => "rear (small copy)",
            "interior" => "interior (small copy)",
            _ => "",
        },
        _ => "",
    };
    if view.is_empty() {
        return ("", "");
    }
    (view, &stem[mark_begins..])
}

fn of_letter(letter: u8) -> &'static str {
    match letter {
        b'f' => "front",
        b'r' | b'b' => "rear",
        b'i' => "interior",
        b't' => "telephoto",
        _ => "",
    }
}

fn pieces(stem: &str) -> Vec<Piece> {
    let are_alike = |one: &u8, next: &u8| one.is_ascii_digit() == next.is_ascii_digit();
    stem.as_bytes().chunk_by(are_alike).map(piece).collect()
}

/// The piece that consists of these digits, or of these other characters.
fn piece(run: &[u8]) -> Piece {
    let text = String::from_utf8_lossy(run).to_lowercase();
    match text.parse() {
        Ok(number) => Piece::Number(number),
        Err(_) => Piece::Text(text),
    }
}
