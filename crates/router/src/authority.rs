//! A certificate authority in a folder: issues, renews and revokes certificates for nodes, hubs and routers.
//!
//! A certificate's common name identifies its holder: `ROLE/NAME/ISSUE`, such as `node/car-7/1`. Zenoh does not support
//! revocation lists, and its access control knows only common names. Revoking a certificate therefore retires its
//! issue: the rules no longer name that common name, and the next certificate of the same name has the next issue. A
//! renewed certificate keeps the issue of the old one, which stays valid until it expires.

mod list;

pub use list::{Entry, Role};

use crate::error::{RouterError, about, at, other};
use albireo_service::clock::unix_milliseconds;
use albireo_wire::{check_node_name, check_segment};
use list::List;
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose,
};
use std::fs::{self, Permissions};
use std::io::Write;
use std::net::IpAddr;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use x509_parser::pem::parse_x509_pem;
use x509_parser::time::ASN1Time;

/// The authority's certificate, which every member of the fleet needs.
pub(crate) const AUTHORITY: &str = "authority.pem";
const AUTHORITY_KEY: &str = "authority.key";

/// One day.
pub const DAY: Duration = Duration::from_secs(86_400);

/// How long before its creation a certificate is valid already, seconds: the clock of a board that just booted may be behind.
const VALID_BEFORE_S: i64 = 86_400;

/// The most characters of a DNS name.
const LONGEST_NAME: usize = 253;

/// The most characters between two dots of a DNS name.
const LONGEST_LABEL: usize = 63;

/// A new certificate: its paths and its entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issued {
    /// The certificate.
    pub certificate: PathBuf,
    /// Its private key, readable only by its owner.
    pub key: PathBuf,
    /// Its entry in the list.
    pub entry: Entry,
}

/// An authority: its certificate and key, and the list of the certificates it issued.
pub struct Authority {
    folder: PathBuf,
    name: String,
    key: KeyPair,
    list: List,
}

impl Authority {
    /// Creates an authority in `folder`.
    ///
    /// # Errors
    /// [`RouterError`] if one already exists or a file cannot be written.
    pub fn create(folder: &Path, name: &str, lasts: Duration) -> Result<Self, RouterError> {
        let file = folder.join(AUTHORITY);
        let key_file = folder.join(AUTHORITY_KEY);
        for file in [&file, &key_file] {
            if file.exists() {
                return other(format!(
                    "{} exists already: a new authority would invalidate every certificate of the old one",
                    file.display()
                ));
            }
        }
        create_folder(folder)?;
        let key = KeyPair::generate()?;
        let mut params = authority_params(name);
        set_validity(&mut params, lasts)?;
        let certificate = params.self_signed(&key)?;
        // An authority is there once its certificate is, so that comes last.
        List::begin(folder)?;
        write(&key_file, &key.serialize_pem(), PRIVATE)?;
        write(&file, &certificate.pem(), PUBLIC)?;
        Self::open(folder)
    }

    /// Opens the authority in `folder` and locks it against other changes.
    ///
    /// # Errors
    /// [`RouterError`] if there is none, or its files cannot be read or do not belong together.
    pub fn open(folder: &Path) -> Result<Self, RouterError> {
        let file = folder.join(AUTHORITY);
        // Before the list, whose lock is a file: a look into another folder leaves nothing there.
        if !file.try_exists().map_err(at(&file))? {
            let shown = folder.display();
            return other(format!(
                "no authority in {shown}; create one with `albireo cert authority --folder {shown}`"
            ));
        }
        let list = List::open(folder)?;
        let (name, public_key) = subject_and_key(&file)?;
        let key_file = folder.join(AUTHORITY_KEY);
        let key = KeyPair::from_pem(&read(&key_file)?).map_err(at(&key_file))?;
        // Whoever trusts the certificate would refuse all that this key signs.
        if public_key != key.public_key_raw() {
            let reason = "the certificate belongs to another key than that in authority.key: restore both from one backup";
            return Err(about(&file, reason));
        }
        Ok(Self {
            folder: folder.to_owned(),
            name,
            key,
            list,
        })
    }

    /// All issued certificates, revoked or not.
    pub fn entries(&self) -> &[Entry] {
        self.list.entries()
    }

    /// Issues a certificate that is valid for `lasts` from now on. `hosts` are the holder's host names and addresses,
    /// for routers and for hubs that act as routers.
    ///
    /// # Errors
    /// [`RouterError`] if the name or a host is invalid, if the name already has a certificate that is not revoked, or if a
    /// file cannot be written.
    pub fn issue(
        &mut self,
        role: Role,
        name: &str,
        hosts: &[String],
        lasts: Duration,
    ) -> Result<Issued, RouterError> {
        match role {
            Role::Node => check_node_name(name)?,
            Role::Hub | Role::Router => check_segment("name", name)?,
        }
        for host in hosts {
            check_host(host)?;
        }
        if self.list.unrevoked(role, name).is_ok() {
            return other(format!(
                "{role} `{name}` has a certificate that is not revoked; renew it, or revoke it first"
            ));
        }
        let entry = Entry {
            role,
            name: name.to_owned(),
            issue: self.list.last_issue(role, name) + 1,
            hosts: hosts.to_vec(),
            ends_s: 0,
            revoked_s: None,
        };
        self.make(entry, lasts)
    }

    /// Replaces a valid certificate by one with a new key. The old one stays valid until it expires.
    ///
    /// # Errors
    /// [`RouterError`] if there is no valid one or a file cannot be written.
    pub fn renew(
        &mut self,
        role: Role,
        name: &str,
        lasts: Duration,
    ) -> Result<Issued, RouterError> {
        let entry = self.list.unrevoked(role, name)?.clone();
        self.make(entry, lasts)
    }

    /// Revokes a certificate and all others with its common name: access rules generated from now on exclude them.
    ///
    /// # Errors
    /// [`RouterError`] if there is no valid one or the list cannot be written.
    pub fn revoke(&mut self, role: Role, name: &str) -> Result<Entry, RouterError> {
        let mut entry = self.list.unrevoked(role, name)?.clone();
        entry.revoked_s = Some(unix_milliseconds() / 1000);
        self.list.put(entry.clone())?;
        Ok(entry)
    }

    /// Creates the newest certificate of an entry.
    fn make(&mut self, mut entry: Entry, lasts: Duration) -> Result<Issued, RouterError> {
        let mut params = CertificateParams::new(entry.hosts.clone())?;
        entry.ends_s = set_validity(&mut params, lasts)?;
        params.distinguished_name = common_name(&entry.common_name());
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        // A router connects to other routers, and to itself to check that it still accepts sessions.
        params.extended_key_usages = match entry.role {
            Role::Node => vec![ExtendedKeyUsagePurpose::ClientAuth],
            Role::Hub | Role::Router => vec![
                ExtendedKeyUsagePurpose::ClientAuth,
                ExtendedKeyUsagePurpose::ServerAuth,
            ],
        };
        params.use_authority_key_identifier_extension = true;
        let key = KeyPair::generate()?;
        let own = authority_params(&self.name);
        let certificate = params.signed_by(&key, &Issuer::from_params(&own, &self.key))?;
        let issued = Issued {
            certificate: self.folder.join(entry.certificate()),
            key: self.folder.join(entry.certificate()).with_extension("key"),
            entry,
        };
        create_folder(&self.folder.join(issued.entry.role.to_string()))?;
        // The key is written first: if the second write fails, a new holder has a key without a certificate, and nobody takes
        // the certificate for a usable one. A renewal that fails between the two must be repeated, because the old certificate
        // does not fit the new key.
        write(&issued.key, &key.serialize_pem(), PRIVATE)?;
        write(&issued.certificate, &certificate.pem(), PUBLIC)?;
        self.list.put(issued.entry.clone())?;
        Ok(issued)
    }
}

/// Checks that a certificate can name `host`: nodes look for the address or the name alone.
fn check_host(host: &str) -> Result<(), RouterError> {
    let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_');
    let is_label = |label: &str| {
        (1..=LONGEST_LABEL).contains(&label.len())
            && label.bytes().all(is_allowed)
            && !label.starts_with('-')
            && !label.ends_with('-')
    };
    let name = host.strip_prefix("*.").unwrap_or(host);
    let last = name.rsplit('.').next().unwrap_or_default();
    // Then it was meant to be an address.
    let ends_in_number = last.bytes().all(|byte| byte.is_ascii_digit());
    let is_name = name.len() <= LONGEST_NAME && name.split('.').all(is_label) && !ends_in_number;
    if is_name || host.parse::<IpAddr>().is_ok() {
        return Ok(());
    }
    other(format!(
        "the host `{host}` is neither an IP address nor a DNS name: write it without scheme, port and brackets, as in \
         router.example or 203.0.113.7"
    ))
}

fn authority_params(name: &str) -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = common_name(name);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn common_name(name: &str) -> DistinguishedName {
    let mut distinguished = DistinguishedName::new();
    distinguished.push(DnType::CommonName, name);
    distinguished
}

fn read(file: &Path) -> Result<String, RouterError> {
    fs::read_to_string(file).map_err(at(file))
}

fn create_folder(folder: &Path) -> Result<(), RouterError> {
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o750)
        .create(folder)
        .map_err(at(folder))
}

/// The permissions of a file that only its owner may read.
pub(crate) const PRIVATE: u32 = 0o600;
/// The permissions of a file that every user may read.
pub const PUBLIC: u32 = 0o644;

/// Writes a file with these permissions atomically and syncs it.
///
/// # Errors
/// [`RouterError`] with the file's name if it cannot be written.
pub fn write(file: &Path, text: &str, mode: u32) -> Result<(), RouterError> {
    write_atomically(file, text, mode).map_err(at(file))
}

fn write_atomically(file: &Path, text: &str, mode: u32) -> std::io::Result<()> {
    let folder = match file.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    // Only its owner may read it until it is written.
    let mut new = tempfile::NamedTempFile::new_in(folder)?;
    new.write_all(text.as_bytes())?;
    // Other than at its creation, no umask takes anything away.
    new.as_file().set_permissions(Permissions::from_mode(mode))?;
    new.as_file().sync_all()?;
    new.persist(file)?;
    Ok(())
}

/// Returns the common name of the certificate in a file.
///
/// # Errors
/// [`RouterError`] if the file has no certificate with a common name.
pub(crate) fn subject(file: &Path) -> Result<String, RouterError> {
    let (name, _) = subject_and_key(file)?;
    Ok(name)
}

/// Returns the common name and the public key of the certificate in a file.
fn subject_and_key(file: &Path) -> Result<(String, Vec<u8>), RouterError> {
    let text = read(file)?;
    let (_, pem) = parse_x509_pem(text.as_bytes()).map_err(at(file))?;
    let certificate = pem.parse_x509().map_err(at(file))?;
    let name = certificate.subject().iter_common_name().find_map(|name| name.as_str().ok());
    let Some(name) = name else {
        return Err(about(file, "the certificate has no common name"));
    };
    let key = certificate.public_key().subject_public_key.data.to_vec();
    Ok((name.to_owned(), key))
}

/// Sets the validity: from [`VALID_BEFORE_S`] ago until `lasts` from now. Returns its end in seconds since the Unix epoch.
fn set_validity(params: &mut CertificateParams, lasts: Duration) -> Result<i64, RouterError> {
    let too_late = || RouterError::Other("a certificate cannot contain that time".to_owned());
    let now_s = unix_milliseconds() / 1000;
    let lasts_s = i64::try_from(lasts.as_secs()).map_err(|_| too_late())?;
    let ends_s = now_s.checked_add(lasts_s).ok_or_else(too_late)?;
    let time = |unix_s| ASN1Time::from_timestamp(unix_s).map_err(|_| too_late());
    params.not_before = time(now_s - VALID_BEFORE_S)?.to_datetime();
    params.not_after = time(ends_s)?.to_datetime();
    Ok(ends_s)
}

#[cfg(test)]
mod tests;
