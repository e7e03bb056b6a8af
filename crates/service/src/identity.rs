//! The files with which a service identifies itself: whether others can read its secrets, and how long its certificates are
//! valid.

use crate::clock::unix_milliseconds;
use crate::config::{Finding, HttpConfig, NamedToken, ZenohConfig};
use albireo_wire::CertificateStatus;
use parking_lot::RwLock;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};
use x509_parser::pem::Pem;

/// The name of the certificates in the readiness of a service.
pub const PART: &str = "certificates";

/// The time between two readings of the files: a renewed certificate is noticed without a restart.
const READ_EVERY: Duration = Duration::from_secs(60);

const DAY_S: i64 = 86_400;

/// From so many days before its end on, a certificate is a fault.
const FAULT_DAYS: i64 = 7;

/// From so many days before its end on, a certificate is in the log once a day.
const LOG_DAYS: i64 = 30;

/// Docker mounts secrets here, readable by every user of the container.
const CONTAINER_SECRETS: &str = "/run/secrets";

/// Says that other users of this machine can read a file with a secret, if they can.
pub fn exposed(key: &str, file: &Path) -> Option<Finding> {
    let mode = fs::metadata(file).ok()?.permissions().mode() & 0o777;
    if mode & 0o004 == 0 || file.starts_with(CONTAINER_SECRETS) {
        return None;
    }
    let shown = file.display();
    let reason = format!(
        "{shown} holds a secret, and every user of this machine can read it (mode {mode:o}): chmod o= {shown}"
    );
    Some(Finding::new(key, reason))
}

/// Finds secret files that other users of this machine can read: tokens, the private keys that Zenoh's configuration file
/// names, and the configuration `file` itself if it holds one of the tokens.
pub fn exposed_files(
    file: Option<&Path>,
    http: &HttpConfig,
    tokens: &[NamedToken],
    zenoh: &ZenohConfig,
) -> Vec<Finding> {
    let mut found = Vec::new();
    if let Some(token_file) = &http.token_file {
        found.extend(exposed("http.token_file", token_file));
    }
    for (index, named) in tokens.iter().enumerate() {
        if let Some(token_file) = &named.token_file {
            found.extend(exposed(&format!("token[{index}].token_file"), token_file));
        }
    }
    if let Some(file) = file {
        let text = fs::read_to_string(file).unwrap_or_default();
        let mut secrets = tokens.iter().map(|named| &named.token).chain([&http.token]).flatten();
        if secrets.any(|token| text.contains(token.secret())) {
            found.extend(exposed("", file));
        }
    }
    for (key, private_key) in zenoh.tls_files("private_key") {
        found.extend(exposed(&key, &private_key));
    }
    found
}

/// The files in the section `transport/link/tls` of a Zenoh configuration, under the names that end with `kind`:
/// `certificate` or `private_key`.
pub fn tls_files(config: &zenoh::Config, kind: &str) -> Vec<(String, PathBuf)> {
    let names = ["listen", "connect", "root_ca"].map(|whose| format!("{whose}_{kind}"));
    let mut files: Vec<(String, PathBuf)> = Vec::new();
    for name in names {
        let value = config.get_json(&format!("transport/link/tls/{name}")).ok();
        let path = value.and_then(|json| serde_json::from_str::<Option<PathBuf>>(&json).ok()?);
        // A router has the same certificate for both directions.
        if let Some(path) = path.filter(|path| files.iter().all(|(_, known)| known != path)) {
            files.push((name, path));
        }
    }
    files
}

/// The time in which a certificate is valid, seconds since the Unix epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Validity {
    from_s: i64,
    until_s: i64,
}

/// A certificate file that a configuration names, as last read.
#[derive(Clone, Debug)]
struct Certificate {
    key: String,
    file: PathBuf,
    validity: Result<Validity, String>,
}

impl Certificate {
    fn read(key: String, file: PathBuf) -> Self {
        let validity = validity(&file, key.contains("root_ca"));
        Self {
            key,
            file,
            validity,
        }
    }

    fn is_valid(&self, now_s: i64) -> bool {
        self.validity
            .as_ref()
            .is_ok_and(|known| (known.from_s..known.until_s).contains(&now_s))
    }

    /// Why it cannot be used at this time, or soon cannot. The text is the same all day.
    fn fault(&self, now_s: i64) -> Option<String> {
        let shown = format!("{} ({})", self.key, self.file.display());
        let Validity { from_s, until_s } = match &self.validity {
            Ok(validity) => *validity,
            Err(error) => return Some(format!("{shown} cannot be read: {error}")),
        };
        let from = date(from_s);
        let until = date(until_s);
        let today = date(now_s);
        let renew = "renew it with `albireo cert renew`, and put the new file in its place";
        if now_s < from_s {
            Some(format!(
                "{shown} is a certificate valid from {from} on, and this machine's clock says {today}: set the clock"
            ))
        } else if now_s >= until_s {
            Some(format!("{shown}: certificate expired on {until}; {renew}"))
        } else if until_s - now_s < FAULT_DAYS * DAY_S {
            Some(format!("{shown}: certificate expires on {until}; {renew}"))
        } else {
            None
        }
    }
}

/// The time in which a file's certificates are all valid; of several authorities, until the last of them ends.
fn validity(file: &Path, of_authorities: bool) -> Result<Validity, String> {
    let text = fs::read(file).map_err(|error| error.to_string())?;
    let mut found: Option<Validity> = None;
    for pem in Pem::iter_from_buffer(&text) {
        let pem = pem.map_err(|error| error.to_string())?;
        if pem.label != "CERTIFICATE" {
            continue;
        }
        let times = pem.parse_x509().map_err(|error| error.to_string())?.validity().clone();
        let one = Validity {
            from_s: times.not_before.timestamp(),
            until_s: times.not_after.timestamp(),
        };
        found = Some(match found {
            None => one,
            Some(other) if of_authorities => Validity {
                from_s: one.from_s.min(other.from_s),
                until_s: one.until_s.max(other.until_s),
            },
            Some(other) => Validity {
                from_s: one.from_s.max(other.from_s),
                until_s: one.until_s.min(other.until_s),
            },
        });
    }
    found.ok_or_else(|| "it holds no certificate".to_owned())
}

/// `2026-12-24`.
fn date(at_s: i64) -> String {
    let since = Duration::from_secs(u64::try_from(at_s).unwrap_or(0));
    humantime::format_rfc3339_seconds(UNIX_EPOCH + since)
        .to_string()
        .chars()
        .take(10)
        .collect()
}

/// The certificates with which a service identifies itself and those it trusts. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Certificates(Arc<RwLock<Vec<Certificate>>>);

impl Certificates {
    /// Reads certificate files, each under the name of its key.
    pub fn read(files: impl IntoIterator<Item = (String, PathBuf)>) -> Self {
        let read = files.into_iter().map(|(key, file)| Certificate::read(key, file)).collect();
        Self(Arc::new(RwLock::new(read)))
    }

    /// Reads the files again every minute, and logs once a day those that end soon, for as long as it is polled.
    pub async fn follow(self) {
        let mut logged = None;
        loop {
            let now_s = unix_milliseconds().div_euclid(1000);
            if logged != Some(now_s.div_euclid(DAY_S)) {
                logged = Some(now_s.div_euclid(DAY_S));
                self.log(now_s);
            }
            tokio::time::sleep(READ_EVERY).await;
            let mut files = Vec::new();
            for one in self.0.read().iter() {
                files.push((one.key.clone(), one.file.clone()));
            }
            let reading = tokio::task::spawn_blocking(move || {
                let read = files.into_iter().map(|(key, file)| Certificate::read(key, file));
                read.collect::<Vec<_>>()
            });
            if let Ok(read) = reading.await {
                *self.0.write() = read;
            }
        }
    }

    fn log(&self, now_s: i64) {
        for CertificateStatus { name, until_s } in self.status() {
            let days_left = (until_s - now_s).div_euclid(DAY_S);
            if days_left < LOG_DAYS {
                let until = date(until_s);
                tracing::warn!(name, until, days_left, "a certificate ends soon");
            }
        }
    }

    /// Until when each certificate is valid.
    pub fn status(&self) -> Vec<CertificateStatus> {
        let known = self.0.read();
        known
            .iter()
            .filter_map(|one| {
                Some(CertificateStatus {
                    name: one.key.clone(),
                    until_s: one.validity.as_ref().ok()?.until_s,
                })
            })
            .collect()
    }

    /// Why some of them cannot be used now, or soon cannot.
    pub fn fault(&self) -> Option<String> {
        self.fault_at(unix_milliseconds().div_euclid(1000))
    }

    /// Why some of them cannot be used now.
    pub fn invalid(&self) -> Option<String> {
        self.invalid_at(unix_milliseconds().div_euclid(1000))
    }

    fn invalid_at(&self, now_s: i64) -> Option<String> {
        let known = self.0.read();
        let invalid = known.iter().filter(|one| !one.is_valid(now_s));
        in_one_sentence(invalid.filter_map(|one| one.fault(now_s)).collect())
    }

    fn fault_at(&self, now_s: i64) -> Option<String> {
        let known = self.0.read();
        in_one_sentence(known.iter().filter_map(|one| one.fault(now_s)).collect())
    }
}

fn in_one_sentence(faults: Vec<String>) -> Option<String> {
    if faults.is_empty() {
        return None;
    }
    Some(faults.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;

    /// A certificate that is valid from 1 January 2026 to 31 January of `until`.
    fn certificate(until: i32) -> String {
        let mut params = rcgen::CertificateParams::default();
        params.not_before = rcgen::date_time_ymd(2026, 1, 1);
        params.not_after = rcgen::date_time_ymd(until, 1, 31);
        params.self_signed(&rcgen::KeyPair::generate().unwrap()).unwrap().pem()
    }

    fn seconds(date: &str) -> i64 {
        let at = humantime::parse_rfc3339(&format!("{date}T12:00:00Z")).unwrap();
        i64::try_from(at.duration_since(UNIX_EPOCH).unwrap().as_secs()).unwrap()
    }

    #[test]
    fn a_certificate_is_a_fault_a_week_before_its_end_after_it_and_with_a_clock_before_its_begin() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let file = folder.path().join(name);
            fs::write(&file, text).unwrap();
            (format!("uplink.{name}"), file)
        };
        let certificates = Certificates::read([
            write("certificate", &certificate(2026)),
            write(
                "root_ca_certificate",
                &(certificate(2036) + &certificate(2026)),
            ),
        ]);
        let ends: Vec<_> = certificates
            .status()
            .into_iter()
            .map(|one| (one.name, date(one.until_s)))
            .collect();
        let [leaf, authority] = ["2026-01-31", "2036-01-31"].map(str::to_owned);
        let named = |name: &str| format!("uplink.{name}");
        assert_eq!(
            ends,
            [
                (named("certificate"), leaf),
                (named("root_ca_certificate"), authority)
            ]
        );
        for (date, said, is_invalid) in [
            (
                "1970-01-01",
                "this machine's clock says 1970-01-01: set the clock",
                true,
            ),
            ("2026-01-05", "", false),
            ("2026-01-23", "", false),
            ("2026-01-24", "certificate expires on 2026-01-31", false),
            ("2026-01-31", "certificate expired on 2026-01-31", true),
            // The first one has been invalid for years.
            ("2036-01-28", "certificate expires on 2036-01-31", true),
        ] {
            let fault = certificates.fault_at(seconds(date)).unwrap_or_default();
            assert!(fault.contains(said), "{date}: {fault}");
            assert_eq!(fault.is_empty(), said.is_empty(), "{date}: {fault}");
            let invalid = certificates.invalid_at(seconds(date));
            assert_eq!(invalid.is_some(), is_invalid, "{date}");
        }
        let broken = Certificates::read([write("certificate", "nothing")]);
        let fault = broken.fault().unwrap();
        assert!(fault.contains("it holds no certificate"), "{fault}");
    }

    #[test]
    fn a_secret_that_every_user_can_read_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("node.key");
        fs::write(&file, "secret").unwrap();
        for (mode, is_found) in [(0o600, false), (0o640, false), (0o644, true), (0o604, true)] {
            fs::set_permissions(&file, Permissions::from_mode(mode)).unwrap();
            let found = exposed("uplink.private_key", &file);
            assert_eq!(found.is_some(), is_found, "{mode:o}");
        }
        let found = exposed("uplink.private_key", &file).unwrap().to_string();
        assert!(found.contains("(mode 604): chmod o= "), "{found}");
        assert_eq!(exposed("uplink.private_key", Path::new("/nowhere")), None);
    }
}
