//! A fleet with access control: certificates, the shipped configurations, and a router with the rules made from both.

use super::{Settings, settings};
use crate::support::{albireo, free_port, run, text, until_ready};
use std::path::PathBuf;
use std::process::Stdio;
use tokio::process::Child;

/// A folder with a certificate authority, and the addresses of a router with its access rules.
pub(crate) struct Protected {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) endpoint: String,
    pub(crate) http: String,
}

impl Protected {
    /// Makes the certificates of a router, a hub and these nodes.
    pub(crate) fn new(nodes: [&str; 2]) -> Self {
        let fleet = Self {
            folder: tempfile::tempdir().unwrap(),
            endpoint: format!("tls/localhost:{}", free_port()),
            http: format!("127.0.0.1:{}", free_port()),
        };
        fleet.does(&["cert", "authority"]);
        fleet.does(&["cert", "router", "east", "--host", "localhost"]);
        fleet.does(&["cert", "hub", "main"]);
        fleet.does(&[&["cert", "node"], &nodes[..]].concat());
        fleet
    }

    /// The settings of the hub, with its certificate.
    pub(crate) fn hub(&self, database: &str) -> Settings {
        let (_, mut settings) = settings(database);
        settings.retain(|(name, _)| *name != "ALBIREO_ZENOH__LISTEN");
        let file = self.shipped("hub.json5").display().to_string();
        settings.push(("ALBIREO_ZENOH__CONFIG_FILE", file));
        settings
    }

    /// The settings of a node's uplink for its certificate.
    pub(crate) fn certificate(&self, node: &str) -> String {
        let authority = self.authority().display().to_string();
        format!(
            "uplink.root_ca_certificate = \"{authority}/authority.pem\"\n\
             uplink.certificate = \"{authority}/node/{node}.pem\"\nuplink.private_key = \"{authority}/node/{node}.key\"\n"
        )
    }

    pub(crate) fn authority(&self) -> PathBuf {
        self.folder.path().join("authority")
    }

    pub(crate) fn does(&self, arguments: &[&str]) -> String {
        let authority = self.authority().display().to_string();
        run(arguments, &[("ALBIREO_AUTHORITY", &authority)]).succeeds()
    }

    /// The shipped configuration, with this fleet's addresses and paths.
    fn shipped(&self, name: &str) -> PathBuf {
        let authority = self.authority().display().to_string();
        let mut text = text(&format!("deploy/zenoh/{name}"));
        for (place, here) in [
            ("tls/[::]:7447", self.endpoint.clone()),
            ("tls/router.example:7447", self.endpoint.clone()),
            ("/etc/albireo/authority", format!("{authority}/authority")),
            ("/etc/albireo/router.", format!("{authority}/router/east.")),
            ("/etc/albireo/hub.", format!("{authority}/hub/main.")),
        ] {
            text = text.replace(place, &here);
        }
        assert!(!text.contains("\"/etc/"), "{text}");
        let file = self.folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        file
    }

    /// Starts a router with the rules of the present certificates.
    pub(crate) async fn start_router(&self) -> Child {
        let access = self.folder.path().join("access.json");
        self.does(&["acl", "--output", access.to_str().unwrap()]);
        let log = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(self.folder.path().join("router.log"))
            .unwrap();
        let router = albireo()
            .args(["router", "--log-json", "--probe-s", "1", "--http"])
            .args([&self.http, "--config"])
            .arg(self.shipped("router.json5"))
            .arg("--access")
            .arg(access)
            .stderr(log)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        until_ready(&format!("http://{}", self.http)).await;
        router
    }

    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("router.log")).unwrap()
    }
}
