//! A certificate authority in a folder: certificates for nodes, hubs and routers, renewed and revoked.
//!
//! The common name of a certificate says whose it is: `ROLE/NAME/ISSUE`, `node/car-7/1`. Zenoh knows no lists of revoked
//! certificates, and its access control knows common names alone. So a certificate that is revoked takes its issue with
//! it: the rules no longer name that common name, and the next certificate of the same name has the next issue. A
//! renewed certificate has the issue of the old one, which stays good until it ends.

mod list;

pub use list::{Entry, Role};

use list::List;
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    Issuer, KeyPair, KeyUsagePurpose,
};
use std::fs::{self, Permissions};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use x509_parser::pem::parse_x509_pem;
use x509_parser::time::ASN1Time;

/// The authority's certificate, which every member of the fleet has.
pub(crate) const AUTHORITY: &str = "authority.pem";
const AUTHORITY_KEY: &str = "authority.key";

/// A day.
pub const DAY: Duration = Duration::from_secs(86_400);

/// How far certificates reach back: the clock of a board that has just started may be behind.
const REACH_BACK: Duration = DAY;

/// Why something cannot be done with certificates.
#[derive(Debug, thiserror::Error)]
pub enum AuthorityError {
    /// A file cannot be read or written, or has something else in it than it should.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// There is an authority already.
    #[error(
        "{0} is there already: a new authority would make every certificate of the old one worthless"
    )]
    Exists(PathBuf),
    /// The name cannot be used.
    #[error(transparent)]
    Name(#[from] albireo_wire::KeyError),
    /// There is one already, and it is good.
    #[error("{role} `{name}` has a certificate; renew it, or revoke it first")]
    Issued {
        /// Role.
        role: Role,
        /// Name.
        name: String,
    },
    /// There is none that could be renewed or revoked.
    #[error("{role} `{name}` has no certificate that is good")]
    Unknown {
        /// Role.
        role: Role,
        /// Name.
        name: String,
    },
    /// It would end before it begins, or centuries ahead.
    #[error("that time cannot stand in a certificate")]
    Time,
    /// The certificate cannot be made.
    #[error("the certificate cannot be made: {0}")]
    Making(#[from] rcgen::Error),
}

/// For what goes wrong with a file.
fn at<E: ToString>(file: &Path) -> impl Fn(E) -> AuthorityError + '_ {
    |error| AuthorityError::File {
        file: file.to_owned(),
        reason: error.to_string(),
    }
}

/// Whose certificate, and how long it is good.
#[derive(Clone, Debug)]
pub struct Request<'a> {
    /// What the holder may do.
    pub role: Role,
    /// The holder's name: for a node the one in its keys.
    pub name: &'a str,
    /// Names and addresses the holder is reached at; for routers, and hubs that are one.
    pub hosts: &'a [String],
    /// When it begins.
    pub begins: SystemTime,
    /// When it ends.
    pub ends: SystemTime,
}

impl<'a> Request<'a> {
    /// A certificate that is good from now on for `lasts`. It reaches back a day.
    ///
    /// # Errors
    /// When that time cannot be written.
    pub fn lasting(
        role: Role,
        name: &'a str,
        hosts: &'a [String],
        lasts: Duration,
    ) -> Result<Self, AuthorityError> {
        let now = SystemTime::now();
        Ok(Self {
            role,
            name,
            hosts,
            begins: now - REACH_BACK,
            ends: later(now, lasts)?,
        })
    }
}

/// Where a certificate and its key were written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issued {
    /// The certificate.
    pub certificate: PathBuf,
    /// Its private key, readable by its owner alone.
    pub key: PathBuf,
    /// What the list says of it.
    pub entry: Entry,
}

/// An authority: its certificate and key, and the list of what it made.
pub struct Authority {
    folder: PathBuf,
    name: String,
    key: KeyPair,
    list: List,
}

impl Authority {
    /// Makes an authority in `folder`.
    ///
    /// # Errors
    /// When there is one already, or a file cannot be written.
    pub fn create(folder: &Path, name: &str, lasts: Duration) -> Result<Self, AuthorityError> {
        let file = folder.join(AUTHORITY);
        if file.exists() || folder.join(AUTHORITY_KEY).exists() {
            return Err(AuthorityError::Exists(file));
        }
        create_folder(folder)?;
        let key = KeyPair::generate()?;
        let now = SystemTime::now();
        let mut params = authority_params(name);
        set_validity(&mut params, now - REACH_BACK, later(now, lasts)?)?;
        let certificate = params.self_signed(&key)?;
        write_private(&folder.join(AUTHORITY_KEY), &key.serialize_pem())?;
        write_public(&file, &certificate.pem())?;
        List::open(folder)?.write()?;
        Self::open(folder)
    }

    /// Opens the authority in `folder`. Nobody else can change it meanwhile.
    ///
    /// # Errors
    /// When there is none, or its files cannot be read.
    pub fn open(folder: &Path) -> Result<Self, AuthorityError> {
        let list = List::open(folder)?;
        let file = folder.join(AUTHORITY);
        let (name, _) = subject(&file)?;
        let key_file = folder.join(AUTHORITY_KEY);
        let key = KeyPair::from_pem(&read(&key_file)?).map_err(at(&key_file))?;
        Ok(Self {
            folder: folder.to_owned(),
            name,
            key,
            list,
        })
    }

    /// What was made, the good and the revoked.
    pub fn entries(&self) -> &[Entry] {
        self.list.entries()
    }

    /// Makes a certificate.
    ///
    /// # Errors
    /// When the name cannot be used or has a good certificate, or a file cannot be written.
    pub fn issue(&mut self, request: &Request<'_>) -> Result<Issued, AuthorityError> {
        albireo_wire::check_segment("name", request.name)?;
        let (role, name) = (request.role, request.name);
        if self.list.good(role, name).is_ok() {
            let name = name.to_owned();
            return Err(AuthorityError::Issued { role, name });
        }
        let issue = self.list.last_issue(role, name) + 1;
        self.make(request, issue)
    }

    /// Replaces a certificate that is good by one with a new key. The old one stays good until it ends.
    ///
    /// # Errors
    /// When there is no good one, or a file cannot be written.
    pub fn renew(
        &mut self,
        role: Role,
        name: &str,
        lasts: Duration,
    ) -> Result<Issued, AuthorityError> {
        let old = self.list.good(role, name)?.clone();
        let request = Request::lasting(role, name, &old.hosts, lasts)?;
        self.make(&request, old.issue)
    }

    /// Takes a certificate, and all with its common name, out of the access control that is generated from now on.
    ///
    /// # Errors
    /// When there is no good one, or the list cannot be written.
    pub fn revoke(&mut self, role: Role, name: &str) -> Result<Entry, AuthorityError> {
        let mut entry = self.list.good(role, name)?.clone();
        entry.revoked_s = Some(seconds(SystemTime::now())?);
        self.list.put(entry.clone())?;
        Ok(entry)
    }

    fn make(&mut self, request: &Request<'_>, issue: u32) -> Result<Issued, AuthorityError> {
        let (role, name) = (request.role, request.name);
        let mut params = CertificateParams::new(request.hosts.to_vec())?;
        set_validity(&mut params, request.begins, request.ends)?;
        params.distinguished_name = common_name(&role.common_name(name, issue));
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        // A router connects to others of the fleet, and to itself to see whether it still takes sessions.
        params.extended_key_usages = match role {
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
        let folder = self.folder.join(role.as_str());
        create_folder(&folder)?;
        let (certificate_file, key_file) = (
            folder.join(format!("{name}.pem")),
            folder.join(format!("{name}.key")),
        );
        // The key first: a certificate with the key of another is worse than a key without its certificate.
        write_private(&key_file, &key.serialize_pem())?;
        write_public(&certificate_file, &certificate.pem())?;
        let entry = Entry {
            role,
            name: name.to_owned(),
            issue,
            hosts: request.hosts.to_vec(),
            ends_s: seconds(request.ends)?,
            revoked_s: None,
        };
        self.list.put(entry.clone())?;
        Ok(Issued {
            certificate: certificate_file,
            key: key_file,
            entry,
        })
    }
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

fn read(file: &Path) -> Result<String, AuthorityError> {
    fs::read_to_string(file).map_err(at(file))
}

fn create_folder(folder: &Path) -> Result<(), AuthorityError> {
    fs::DirBuilder::new()
        .recursive(true)
        .mode(0o750)
        .create(folder)
        .map_err(at(folder))
}

/// What only the owner may read.
fn write_private(file: &Path, text: &str) -> Result<(), AuthorityError> {
    write(file, text, 0o600).map_err(at(file))
}

/// Writes a file that anybody may read, whole or not at all, and synced.
///
/// # Errors
/// When it cannot be written, with its name.
pub fn write_public(file: &Path, text: &str) -> Result<(), AuthorityError> {
    write(file, text, 0o644).map_err(at(file))
}

fn write(file: &Path, text: &str, mode: u32) -> std::io::Result<()> {
    let folder = file.parent().filter(|folder| *folder != Path::new(""));
    let mut new = tempfile::Builder::new()
        .permissions(Permissions::from_mode(mode))
        .tempfile_in(folder.unwrap_or(Path::new(".")))?;
    new.write_all(text.as_bytes())?;
    new.as_file().sync_all()?;
    new.persist(file)?;
    Ok(())
}

/// The common name of the certificate in a file, and when it ends, seconds since the Unix epoch.
///
/// # Errors
/// When the file has no certificate with a common name.
pub(crate) fn subject(file: &Path) -> Result<(String, i64), AuthorityError> {
    let text = read(file)?;
    let (_, pem) = parse_x509_pem(text.as_bytes()).map_err(at(file))?;
    let certificate = pem.parse_x509().map_err(at(file))?;
    let name = certificate
        .subject()
        .iter_common_name()
        .find_map(|name| name.as_str().ok())
        .ok_or_else(|| at(file)("the certificate has no common name"))?;
    Ok((
        name.to_owned(),
        certificate.validity().not_after.timestamp(),
    ))
}

fn later(time: SystemTime, by: Duration) -> Result<SystemTime, AuthorityError> {
    time.checked_add(by).ok_or(AuthorityError::Time)
}

fn seconds(time: SystemTime) -> Result<i64, AuthorityError> {
    time.duration_since(UNIX_EPOCH)
        .ok()
        .and_then(|since| i64::try_from(since.as_secs()).ok())
        .ok_or(AuthorityError::Time)
}

/// Sets the span in which a certificate is good.
fn set_validity(
    params: &mut CertificateParams,
    begins: SystemTime,
    ends: SystemTime,
) -> Result<(), AuthorityError> {
    let time = |at| ASN1Time::from_timestamp(at).map_err(|_| AuthorityError::Time);
    let (begins, ends) = (seconds(begins)?, seconds(ends)?);
    if ends <= begins {
        return Err(AuthorityError::Time);
    }
    params.not_before = time(begins)?.to_datetime();
    params.not_after = time(ends)?.to_datetime();
    Ok(())
}

#[cfg(test)]
mod tests;
