//! The sections `[mqtt]` and `[[hook]]`.

use super::address::{self, Endpoint, HookUrl, Target};
use albireo_service::config::{Finding, Findings, first_line};
use albireo_service::identity::exposed;
use albireo_vision::detector::named_classes;
use albireo_wire::Sighting;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The MQTT broker: the `[mqtt]` section.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MqttConfig {
    /// Address of the broker; without one there is no MQTT.
    pub broker: Option<String>,
    /// User of the broker.
    pub user: Option<String>,
    /// A file whose first line is the user's password.
    pub password_file: Option<PathBuf>,
    /// Certificate of the authority that signed the broker's; by default those of the system.
    pub root_ca_certificate: Option<PathBuf>,
    /// First level of the topics by which Home Assistant discovers devices; empty for none.
    pub discovery: String,
}

impl Default for MqttConfig {
    fn default() -> Self {
        Self {
            broker: None,
            user: None,
            password_file: None,
            root_ca_certificate: None,
            discovery: "homeassistant".to_owned(),
        }
    }
}

/// The most characters of a password.
const LONGEST_SECRET: usize = 4096;

/// Reads a secret in the first line of a file.
///
/// # Errors
/// The file, and why its first line cannot be used; does not show it.
fn secret(file: &Path) -> Result<String, String> {
    let wrong = |what: &dyn std::fmt::Display| format!("{}: {what}", file.display());
    let first = first_line(file).map_err(|error| wrong(&error))?;
    if first.is_empty() || first.len() > LONGEST_SECRET {
        return Err(wrong(&"its first line is empty or too long"));
    }
    albireo_service::logging::conceal(&first);
    Ok(first)
}

impl MqttConfig {
    /// The broker's place, if one is set.
    pub(crate) fn place(&self) -> Option<Result<Endpoint, String>> {
        self.broker.as_deref().map(address::broker)
    }

    /// The user and the password.
    pub(super) fn login(&self) -> Result<Option<(String, String)>, String> {
        let Some(user) = &self.user else {
            return Ok(None);
        };
        let password = match &self.password_file {
            Some(file) => secret(file).map_err(|error| format!("mqtt.password_file {error}"))?,
            None => String::new(),
        };
        Ok(Some((user.clone(), password)))
    }

    /// Adds the errors in the section.
    pub(crate) fn check(&self, findings: &mut Findings) {
        let place = self.place().and_then(|place| findings.check("mqtt.broker", place));
        findings.path("mqtt.password_file", self.password_file.as_deref());
        let authority = self.root_ca_certificate.as_deref();
        findings.path("mqtt.root_ca_certificate", authority);
        if authority.is_some() && place.is_some_and(|place| !place.is_secure) {
            let reason = "applies only to a broker with TLS: begin mqtt.broker with mqtts://";
            findings.add("mqtt.root_ca_certificate", reason);
        }
        if self.password_file.is_some() && self.user.is_none() {
            findings.add("mqtt.password_file", "is set, but mqtt.user is not");
        }
        if self.broker.is_none() && (self.user.is_some() || authority.is_some()) {
            let reason = "is not set, but other keys of [mqtt] are: write \"mqtt://HOST\" or \"mqtts://HOST\"";
            findings.add("mqtt.broker", reason);
        }
        if self.discovery.contains(['+', '#', '\0']) || self.discovery.ends_with('/') {
            let reason = "is the beginning of a topic, such as \"homeassistant\": without + and #, and without / at its end";
            findings.add("mqtt.discovery", reason);
        }
    }

    /// Adds what is missing on this machine.
    pub(crate) fn look_here(&self, findings: &mut Findings) {
        let password = self.password_file.as_deref().map(secret).transpose();
        findings.check("mqtt.password_file", password);
    }

    /// The file with its secret, if every user of this machine can read it.
    pub(crate) fn exposed(&self) -> Option<Finding> {
        exposed("mqtt.password_file", self.password_file.as_deref()?)
    }
}

/// What is done when a class appears or leaves, a POST or a recording: a `[[hook]]` section.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HookConfig {
    /// The address.
    pub url: Option<HookUrl>,
    /// A file whose first line is the address.
    pub url_file: Option<PathBuf>,
    /// Certificate of the authority that signed the receiver's; by default those of the system.
    pub root_ca_certificate: Option<PathBuf>,
    /// Cameras that it is told of; empty for all.
    pub cameras: Vec<String>,
    /// Classes that it is told of; empty for all.
    pub classes: Vec<String>,
    /// True if what it is told of is recorded, too.
    pub record: bool,
}

impl HookConfig {
    /// True if it is told of this sighting.
    pub(super) fn hears(&self, sighting: &Sighting) -> bool {
        let is_in =
            |names: &[String], name: &str| names.is_empty() || names.iter().any(|one| one == name);
        is_in(&self.cameras, &sighting.camera) && is_in(&self.classes, &sighting.class)
    }

    /// True if it posts: without an address it only records.
    pub(crate) fn posts(&self) -> bool {
        self.url.is_some() || self.url_file.is_some()
    }

    /// Where it posts to.
    pub(crate) fn target(&self) -> Result<Target, String> {
        if let Some(file) = &self.url_file {
            return HookUrl::new(secret(file)?).target();
        }
        let url = self.url.as_ref().ok_or("has neither url nor url_file")?;
        url.target()
    }

    /// Adds the errors in the section at `index`, of a node with these cameras.
    pub(crate) fn check(&self, index: usize, cameras: &[&str], findings: &mut Findings) {
        let key = |name: &str| format!("hook[{index}].{name}");
        match (&self.url, &self.url_file) {
            (Some(_), Some(_)) => {
                findings.add(key("url_file"), "is set together with url; keep one")
            }
            (None, None) if self.record => {}
            (None, None) => findings.add(key("url"), "is missing: the address that gets the POST"),
            (Some(url), None) => drop(findings.check(key("url"), url.target())),
            (None, Some(file)) => findings.path(&key("url_file"), Some(file)),
        }
        let authority = self.root_ca_certificate.as_deref();
        findings.path(&key("root_ca_certificate"), authority);
        for name in &self.cameras {
            if !cameras.contains(&name.as_str()) {
                let there = cameras.join(", ");
                let reason = format!("there is no camera `{name}`; there is: {there}");
                findings.add(key("cameras"), reason);
            }
        }
    }

    /// Its classes that a detector which reports `classes` never finds, each with its key and the reason; it is the section
    /// at `index`.
    pub(crate) fn never_found(&self, index: usize, classes: &[String]) -> Vec<String> {
        let reported = named_classes(classes);
        let there = reported.join(", ");
        let absent = self.classes.iter().filter(|class| !reported.contains(&class.as_str()));
        let sentence = |class: &String| {
            format!("hook[{index}].classes: the detector reports no `{class}`; it reports: {there}")
        };
        absent.map(sentence).collect()
    }

    /// Adds what is missing on this machine.
    pub(crate) fn look_here(&self, index: usize, findings: &mut Findings) {
        if self.url_file.is_some() {
            findings.check(format!("hook[{index}].url_file"), self.target());
        }
    }

    /// Its file with the address, or the configuration `file` with it, if every user of this machine can read that.
    pub(crate) fn exposed(&self, index: usize, file: Option<&Path>) -> Option<Finding> {
        if let Some(secret) = &self.url_file {
            return exposed(&format!("hook[{index}].url_file"), secret);
        }
        if !self.url.as_ref().is_some_and(HookUrl::may_hold_secret) {
            return None;
        }
        exposed(&format!("hook[{index}].url"), file?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_class_of_a_hook_that_the_detector_never_reports_is_told() {
        let hook = |classes: &[&str]| HookConfig {
            classes: classes.iter().map(|class| (*class).to_owned()).collect(),
            ..HookConfig::default()
        };
        // The model has a class without a name.
        let reported = ["person", "", "car"].map(str::to_owned);
        let told = hook(&["car", "pedestrian"]).never_found(2, &reported);
        let expected =
            "hook[2].classes: the detector reports no `pedestrian`; it reports: person, car";
        assert_eq!(told, [expected]);
        for classes in [&["person", "car"][..], &[]] {
            assert!(hook(classes).never_found(0, &reported).is_empty());
        }
    }
}
