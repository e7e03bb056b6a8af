//! What is masked in the messages of programs.

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};
use std::cmp::Reverse;

/// The characters encoded between `://` and `@`: all but the unreserved ones of RFC 3986, section 2.3.
pub(super) const LOGIN: &AsciiSet =
    &NON_ALPHANUMERIC.remove(b'-').remove(b'.').remove(b'_').remove(b'~');

/// Shown instead of a secret.
pub(super) const MASK: &str = "***";

/// Secrets, longest first.
#[derive(Clone, Default)]
pub(crate) struct Secrets(Vec<String>);

impl Secrets {
    pub(super) fn add(&mut self, secret: &str) {
        let decoded = percent_decode_str(secret).decode_utf8_lossy().into_owned();
        let encoded = utf8_percent_encode(secret, LOGIN).to_string();
        for form in [secret.to_owned(), decoded, encoded] {
            if !form.is_empty() && !self.0.contains(&form) {
                self.0.push(form);
            }
        }
        self.0.sort_by_key(|secret| Reverse(secret.len()));
    }

    /// Adds the user and password of an address. A name of one or two letters would be masked everywhere.
    pub(super) fn add_login(&mut self, login: Option<&str>) {
        let Some(login) = login else { return };
        let (user, password) = login.split_once(':').unwrap_or((login, ""));
        self.add(login);
        self.add(password);
        if user.len() > 2 {
            self.add(user);
        }
    }

    /// Adds the query of an address.
    pub(super) fn add_query(&mut self, query: Option<&str>) {
        let Some(query) = query else { return };
        self.add(query);
        let values = query.split('&').filter_map(|pair| pair.split_once('='));
        for (_, value) in values.filter(|(_, value)| value.len() > 2) {
            self.add(value);
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns `text` with the secrets masked.
    pub(super) fn redact(&self, text: &str) -> String {
        let hidden = |text: String, secret: &String| text.replace(secret.as_str(), MASK);
        self.0.iter().fold(text.to_owned(), hidden)
    }
}
