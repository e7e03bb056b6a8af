//! Connects to a place in the network, with TLS where that is asked for, and says in words why that fails.

use rustls::pki_types::pem::PemObject as _;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{CertificateError, ClientConfig, RootCertStore};
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;

/// The time within which a place must have accepted a connection.
const CONNECTED_WITHIN: Duration = Duration::from_secs(5);

/// A connection.
pub trait ByteStream: AsyncRead + AsyncWrite + Send + Sync + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Sync + Unpin> ByteStream for T {}

/// The authorities that may sign the certificate of a place, read once for many of them.
#[derive(Clone)]
pub(crate) struct Authorities(TlsConnector);

impl Authorities {
    /// Reads those of a file, or the system's.
    ///
    /// # Errors
    /// Why there are none.
    pub(crate) fn read(file: Option<&Path>) -> Result<Self, String> {
        tls(file).map(Self)
    }
}

/// Connects to one place.
#[derive(Clone)]
pub struct Connector {
    host: String,
    port: u16,
    tls: Option<TlsConnector>,
}

impl Connector {
    /// Connects without TLS.
    pub fn plain(host: impl Into<String>, port: u16) -> Self {
        Self {
            host: host.into(),
            port,
            tls: None,
        }
    }

    /// Connects with TLS. Reads the certificates of the authorities that may sign the place's: those of a file, or the
    /// system's.
    ///
    /// # Errors
    /// Why there are none.
    pub fn secure(
        host: impl Into<String>,
        port: u16,
        authority: Option<&Path>,
    ) -> Result<Self, String> {
        Ok(Self::verified(host, port, &Authorities::read(authority)?))
    }

    /// Connects with TLS to a place whose certificate these authorities have signed.
    pub(crate) fn verified(host: impl Into<String>, port: u16, authorities: &Authorities) -> Self {
        Self {
            host: host.into(),
            port,
            tls: Some(authorities.0.clone()),
        }
    }

    /// Opens a connection.
    ///
    /// # Errors
    /// In words, what is wrong and what to do.
    pub async fn open(&self) -> io::Result<Box<dyn ByteStream>> {
        if let Ok(opened) = timeout(CONNECTED_WITHIN, self.open_slowly()).await {
            return opened;
        }
        let seconds = CONNECTED_WITHIN.as_secs();
        let reason = format!("did not answer within {seconds} s");
        Err(io::Error::other(reason))
    }

    async fn open_slowly(&self) -> io::Result<Box<dyn ByteStream>> {
        let stream = TcpStream::connect((self.host.as_str(), self.port))
            .await
            .map_err(|error| io::Error::other(unreachable(&error)))?;
        stream.set_nodelay(true)?;
        let Some(tls) = &self.tls else {
            return Ok(Box::new(stream));
        };
        let name = ServerName::try_from(self.host.clone()).map_err(io::Error::other)?;
        let secured = tls
            .connect(name, stream)
            .await
            .map_err(|error| io::Error::other(refused_by_tls(&error)))?;
        Ok(Box::new(secured))
    }
}

fn tls(authority: Option<&Path>) -> Result<TlsConnector, String> {
    let mut roots = RootCertStore::empty();
    match authority {
        Some(file) => {
            let wrong = |what: &dyn std::fmt::Display| {
                format!("root_ca_certificate {}: {what}", file.display())
            };
            let certificates: Vec<_> = CertificateDer::pem_file_iter(file)
                .and_then(Iterator::collect)
                .map_err(|error| wrong(&error))?;
            let (added, _) = roots.add_parsable_certificates(certificates);
            if added == 0 {
                return Err(wrong(&"has no certificate"));
            }
        }
        None => {
            let found = rustls_native_certs::load_native_certs();
            roots.add_parsable_certificates(found.certs);
            if roots.is_empty() {
                let reason = "this system has no certificates of authorities: install ca-certificates, or set root_ca_certificate";
                return Err(reason.to_owned());
            }
        }
    }
    // Named here, because the process has no default as long as nobody chose one.
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(TlsConnector::from(Arc::new(config)))
}

fn unreachable(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::ConnectionRefused => {
            "refuses the connection: nothing listens there".to_owned()
        }
        io::ErrorKind::TimedOut => "did not answer".to_owned(),
        _ => format!("cannot be reached: {error}"),
    }
}

/// The words for a failed handshake.
fn refused_by_tls(error: &io::Error) -> String {
    let inner = error.get_ref().and_then(|inner| inner.downcast_ref::<rustls::Error>());
    let reason = match inner {
        Some(rustls::Error::InvalidCertificate(
            CertificateError::UnknownIssuer | CertificateError::BadSignature,
        )) => {
            "its certificate is signed by an authority that is not known here: set root_ca_certificate".to_owned()
        }
        Some(rustls::Error::InvalidCertificate(
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
        )) => "its certificate is for another name".to_owned(),
        Some(rustls::Error::InvalidCertificate(
            CertificateError::Expired | CertificateError::ExpiredContext { .. },
        )) => "its certificate has expired, or the clock here is wrong".to_owned(),
        Some(rustls::Error::InvalidMessage(_)) => "it does not speak TLS on this port".to_owned(),
        Some(other) => other.to_string(),
        None => error.to_string(),
    };
    format!("TLS failed: {reason}")
}
