//! Tells the numbers in a picture's name from the text around them.

/// A picture's name, or a part of it.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct NumberedName {
    /// The text, with `#` for each number.
    pub pattern: String,
    pub numbers: Vec<i64>,
}

impl NumberedName {
    pub(super) fn of(name: &str) -> Self {
        let mut pattern = String::new();
        let mut numbers = Vec::new();
        let is_digit = |byte: &u8| byte.is_ascii_digit();
        for part in name.as_bytes().chunk_by(|a, b| is_digit(a) == is_digit(b)) {
            let text = String::from_utf8_lossy(part);
            if let Ok(number) = text.parse() {
                numbers.push(number);
                pattern.push('#');
            } else {
                // A number with too many digits is text.
                pattern.push_str(&text);
            }
        }
        Self { pattern, numbers }
    }
}

/// A picture's name without folders, as Linux or Windows writes them.
pub(super) fn file_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

/// A picture's name without folders and without the extension.
pub(super) fn stem(name: &str) -> &str {
    let file = file_name(name);
    file.rsplit_once('.').map_or(file, |(stem, _)| stem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_told_apart_into_its_numbers_and_the_text_around_them() {
        let name = NumberedName::of("a/cam2_0010.jpg");
        assert_eq!(name.pattern, "a/cam#_#.jpg");
        assert_eq!(name.numbers, [2, 10]);
        let hashed = NumberedName::of("99999999999999999999f");
        assert_eq!(hashed.pattern, "99999999999999999999f");
        assert_eq!(stem("a\\b/frame.1.jpg"), "frame.1");
    }
}
