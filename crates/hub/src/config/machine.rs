//! Checks the files that a configuration names on this machine. Only `albireo check` uses it; a hub finds out when it reads them.

use super::HubConfig;
use albireo_service::config::{Finding, Findings};
use albireo_service::http::read_token;

impl HubConfig {
    /// Finds the files that cannot be read on this machine, without which a hub would not start. The database is not among
    /// them.
    pub fn here(&self) -> Vec<Finding> {
        let mut findings = Findings::default();
        if let Some(file) = &self.http.token_file {
            findings.check("http.token_file", read_token(file));
        }
        for (index, named) in self.tokens.iter().enumerate() {
            if let Some(file) = &named.token_file {
                let key = format!("token[{index}].token_file");
                findings.check(key, read_token(file));
            }
        }
        if let Some(file) = &self.zenoh.config_file {
            let read = std::fs::read_to_string(file);
            let shown = file.display();
            let read = read.map_err(|error| format!("{shown} cannot be read: {error}"));
            findings.check("zenoh.config_file", read);
        }
        findings.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_service::config::NamedToken;

    #[test]
    fn files_with_which_a_hub_would_not_start_are_named_by_their_keys() {
        let folder = tempfile::tempdir().unwrap();
        let written = |name: &str, text: &str| {
            let file = folder.path().join(name);
            std::fs::write(&file, text).unwrap();
            file
        };
        let mut config = HubConfig::default();
        assert!(config.here().is_empty());
        config.http.token_file = Some(written("empty", ""));
        for (name, file) in [
            ("spaced", written("spaced", "a token with spaces in it\n")),
            ("folder", folder.path().to_owned()),
            ("missing", folder.path().join("missing")),
            ("good", written("good", "0123456789abcdef\n")),
        ] {
            config.tokens.push(NamedToken {
                name: name.to_owned(),
                token_file: Some(file),
                ..NamedToken::default()
            });
        }
        config.zenoh.config_file = Some(folder.path().join("zenoh.json5"));
        let keys: Vec<String> = config.here().into_iter().map(|found| found.key).collect();
        let expected = "http.token_file token[0].token_file token[1].token_file token[2].token_file zenoh.config_file";
        assert_eq!(keys.join(" "), expected);
    }
}
