//! Selects nodes by names, globs and labels.
//!
//! A [`Selector`] is a list of terms; a node is selected when any term matches it. A term is `all`, a name or
//! glob (`cam-7`, `cam-*`), or a label (`region=north`, `region=n*`); parts joined by `&` must all match
//! (`cam-* & region=north`), and a part after `!` must not (`all & !cam-3`).

use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::str::FromStr;

/// Most terms of a selector; for more nodes there are labels.
const MOST_TERMS: usize = 1_000;

/// Selects nodes. In JSON it is a list of terms.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<String>")]
pub struct Selector(Vec<String>);

impl Default for Selector {
    /// Every node.
    fn default() -> Self {
        Self(vec!["all".to_owned()])
    }
}

impl Selector {
    /// A selector of the given terms.
    ///
    /// # Errors
    /// When there is no term, or one is malformed.
    pub fn new<T: AsRef<str>>(terms: &[T]) -> Result<Self, String> {
        let fault = |term: &str, reason| {
            format!(
                "`{term}` selects no nodes: {reason}; write `all`, a name, a glob such as `cam-*`, or a label such as \
                 `region=north`"
            )
        };
        if terms.is_empty() {
            return Err(fault("", "it is empty"));
        }
        if terms.len() > MOST_TERMS {
            return Err(fault("…", "it has more than 1000 terms"));
        }
        let mut known = HashSet::new();
        let mut checked = Vec::with_capacity(terms.len());
        for term in terms {
            let term = term.as_ref().trim();
            let is_repeated = !known.insert(term);
            if is_repeated {
                continue;
            }
            for part in parts(term) {
                part.check().map_err(|reason| fault(term, reason))?;
            }
            checked.push(term.to_owned());
        }
        Ok(Self(checked))
    }

    /// True if it selects a node with that name and those labels.
    pub fn selects(&self, name: &str, labels: &BTreeMap<String, String>) -> bool {
        let holds = |part: Part<'_>| {
            let found = match part.key {
                Some(key) => labels.get(key).is_some_and(|has| glob(part.pattern, has)),
                None => part.pattern == "all" || glob(part.pattern, name),
            };
            found != part.is_negated
        };
        self.0.iter().any(|term| parts(term).all(holds))
    }

    /// The plain names in it: a caller who names a node gets an error if no node has that name.
    pub fn named(&self) -> impl Iterator<Item = &str> {
        let plain = |term: &&String| *term != "all" && !term.contains(['*', '?', '=', '!', '&']);
        self.0.iter().filter(plain).map(String::as_str)
    }
}

/// One of the parts of a term that must all match.
struct Part<'a> {
    is_negated: bool,
    /// The name of a label; `None` if the pattern is for nodes' names.
    key: Option<&'a str>,
    pattern: &'a str,
}

fn parts(term: &str) -> impl Iterator<Item = Part<'_>> {
    term.split('&').map(|text| {
        let text = text.trim();
        let negated = text.strip_prefix('!');
        let wanted = negated.unwrap_or(text);
        let (key, pattern) = match wanted.split_once('=') {
            Some((key, value)) => (Some(key.trim()), value),
            None => (None, wanted),
        };
        Part {
            is_negated: negated.is_some(),
            key,
            pattern: pattern.trim(),
        }
    })
}

impl Part<'_> {
    fn check(&self) -> Result<(), &'static str> {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.*?/:".contains(c);
        let texts = [self.key.unwrap_or("*"), self.pattern];
        if texts.contains(&"") {
            Err("a part of it is empty")
        } else if !texts.iter().all(|text| text.chars().all(plain)) {
            Err("it has a character that no name has")
        } else {
            Ok(())
        }
    }
}

/// Returns true if `text` matches `pattern`, where `*` matches any characters and `?` matches one. Its time is at most
/// proportional to the product of the lengths.
fn glob(pattern: &str, text: &str) -> bool {
    let text = text.as_bytes();
    // `matches[n]`: the pattern so far matches the first `n` bytes of the text.
    let mut matches = vec![false; text.len() + 1];
    matches[0] = true;
    for wanted in pattern.bytes() {
        if wanted == b'*' {
            // It also matches whatever follows the shortest match.
            if let Some(first) = matches.iter().position(|matched| *matched) {
                matches[first..].fill(true);
            }
        } else {
            let mut longer = vec![false; text.len() + 1];
            for (n, byte) in text.iter().enumerate() {
                longer[n + 1] = matches[n] && (wanted == b'?' || wanted == *byte);
            }
            matches = longer;
        }
    }
    matches[text.len()]
}

impl FromStr for Selector {
    type Err = String;

    /// Terms separated by commas: `cam-*,region=north`.
    fn from_str(text: &str) -> Result<Self, String> {
        let terms: Vec<_> = text.split(',').filter(|term| !term.trim().is_empty()).collect();
        Self::new(&terms)
    }
}

impl TryFrom<Vec<String>> for Selector {
    type Error = String;

    fn try_from(terms: Vec<String>) -> Result<Self, String> {
        Self::new(&terms)
    }
}

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_name_that_is_repeated_is_there_once() {
        let selector = Selector::new(&["ghost", "cam-1", "ghost"]).unwrap();
        assert!(selector.named().eq(["ghost", "cam-1"]));
    }

    fn selected(selector: &str) -> Vec<&'static str> {
        let fleet = [
            ("cam-1", "north"),
            ("cam-2", "south"),
            ("cam-10", "north"),
            ("bus-1", "north"),
            ("x", ""),
        ];
        let selector: Selector = selector.parse().unwrap();
        let has = |region: &str| {
            if region.is_empty() {
                return BTreeMap::new();
            }
            BTreeMap::from([("region".to_owned(), region.to_owned())])
        };
        fleet
            .iter()
            .filter(|(name, region)| selector.selects(name, &has(region)))
            .map(|(name, _)| *name)
            .collect()
    }

    #[test]
    fn names_globs_labels_and_all_select_the_right_nodes() {
        for (selector, expected) in [
            ("cam-1", vec!["cam-1"]),
            ("cam-?", vec!["cam-1", "cam-2"]),
            ("cam-*", vec!["cam-1", "cam-2", "cam-10"]),
            ("*-1", vec!["cam-1", "bus-1"]),
            ("*", vec!["cam-1", "cam-2", "cam-10", "bus-1", "x"]),
            ("all", vec!["cam-1", "cam-2", "cam-10", "bus-1", "x"]),
            ("region=north", vec!["cam-1", "cam-10", "bus-1"]),
            ("region=*", vec!["cam-1", "cam-2", "cam-10", "bus-1"]),
            ("region=north & cam-*", vec!["cam-1", "cam-10"]),
            ("all & !region=north", vec!["cam-2", "x"]),
            ("!cam-*", vec!["bus-1", "x"]),
            ("cam-2,x", vec!["cam-2", "x"]),
            ("nobody", vec![]),
        ] {
            assert_eq!(selected(selector), expected, "{selector}");
        }
    }

    #[test]
    fn an_invalid_selector_is_rejected() {
        for text in ["", ",", "a b", "region=", "=north", "cam-1 &", "käse", "!"] {
            assert!(text.parse::<Selector>().is_err(), "{text:?}");
        }
    }

    #[test]
    fn only_whole_names_are_named() {
        let selector: Selector = "cam-1,cam-*,region=north,!x,all".parse().unwrap();
        assert_eq!(selector.named().collect::<Vec<_>>(), ["cam-1"]);
    }

    proptest! {
        #[test]
        fn a_selector_survives_json_unchanged(terms in prop::collection::vec("!?[a-z*?-]{1,8}(=[a-z*]{1,4})?( & [a-z]{1,3})?", 1..4)) {
            let selector = Selector::new(&terms).unwrap();
            let text = serde_json::to_string(&selector).unwrap();
            prop_assert_eq!(serde_json::from_str::<Selector>(&text).unwrap(), selector);
        }

        #[test]
        fn a_glob_agrees_with_the_obvious_recursion(pattern in "[ab*?]{0,8}", text in "[ab]{0,8}") {
            fn plain(pattern: &[u8], text: &[u8]) -> bool {
                match pattern.split_first() {
                    None => text.is_empty(),
                    Some((b'*', rest)) => (0..=text.len()).any(|n| plain(rest, &text[n..])),
                    Some((&c, rest)) => text.split_first().is_some_and(|(&first, text)| (c == b'?' || c == first) && plain(rest, text)),
                }
            }
            prop_assert_eq!(glob(&pattern, &text), plain(pattern.as_bytes(), text.as_bytes()));
        }
    }
}
