//! `[[token]]` sections: named tokens, each with its role.

use super::{Findings, Token};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Name of a caller without a token.
pub(crate) const ANONYMOUS: &str = "anonymous";

/// The permissions of a token's holder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Read only.
    #[default]
    Read,
    /// Read and change.
    Tune,
}

/// A named token: one `[[token]]` section.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NamedToken {
    /// The holder: the name in the history of changes.
    pub name: String,
    /// The permissions.
    pub role: Role,
    /// The secret.
    pub token: Option<Token>,
    /// A file whose first line is the secret.
    pub token_file: Option<PathBuf>,
}

impl NamedToken {
    /// Adds the errors in the sections.
    pub(super) fn check(tokens: &[Self], findings: &mut Findings) {
        for (index, token) in tokens.iter().enumerate() {
            let key = |name: &str| format!("token[{index}].{name}");
            if token.name.is_empty() {
                findings.add(key("name"), "is empty");
            }
            if token.name == ANONYMOUS {
                let reason = format!("`{ANONYMOUS}` is what callers without a token are called");
                findings.add(key("name"), reason);
            }
            if tokens[..index].iter().any(|other| other.name == token.name) {
                findings.add(key("name"), format!("`{}` is used twice", token.name));
            }
            if let Some(secret) = &token.token {
                findings.check(key("token"), secret.check());
            }
            findings.path(&key("token_file"), token.token_file.as_deref());
            if token.token.is_some() == token.token_file.is_some() {
                findings.add(key("token"), "needs either token or token_file");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_token_is_named_as_callers_without_one() {
        let token = NamedToken {
            name: ANONYMOUS.to_owned(),
            role: Role::Read,
            token: None,
            token_file: Some("token".into()),
        };
        let mut findings = Findings::default();
        NamedToken::check(&[token], &mut findings);
        let keys: Vec<_> = findings.0.iter().map(|finding| finding.key.as_str()).collect();
        assert_eq!(keys, ["token[0].name"]);
    }
}
