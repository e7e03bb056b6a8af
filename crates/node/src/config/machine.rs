//! Checks what a configuration needs on this machine: files, folders, libraries, ports. Most of it is used only by
//! `albireo check`; a running node finds out when it opens them.

use super::NodeConfig;
use crate::input::source::{LiveSource, SourceAddress};
use crate::state_files;
use albireo_service::config::{Finding, Findings};
use albireo_service::http::read_token;
use albireo_service::identity::{Certificates, exposed, exposed_files};
use albireo_vision::detector::{Choice, DetectorConfig, DetectorNetwork, USUAL_PICTURE};
use albireo_vision::onnx::{ExecutionProvider, StartErrorKind, find_library};
use std::fmt::Display;
use std::net::TcpListener;
use std::path::{Path, PathBuf};

/// What a configuration finds on this machine.
pub struct Here {
    /// What is missing: without it a node would not start.
    pub missing: Vec<Finding>,
    /// What was learnt of the detector's model; `None` if it was not opened.
    pub detector: Option<DetectorHere>,
}

/// What is learnt of a detector's model by opening it.
pub struct DetectorHere {
    /// How it is read.
    pub description: String,
    /// What is wasteful about it.
    pub wasteful: Option<String>,
}

impl NodeConfig {
    /// Finds everything missing on this machine without which a node would not start, and tells how the detector is read if
    /// it can be.
    pub fn here(&self) -> Here {
        let mut findings = Findings::default();
        let mut detector = None;
        for (key, path) in self.model_files() {
            file(key, path, &mut findings);
        }
        self.check_library(&mut findings);
        if findings.0.is_empty() {
            detector = self.check_detector(&mut findings);
        }
        if let Some(file) = &self.http.token_file {
            findings.check("http.token_file", read_token(file));
        }
        let zenoh = self.zenoh.config_file.as_deref();
        file("zenoh.config_file", zenoh, &mut findings);
        for (key, path) in self.uplink.files() {
            file(key, Some(path), &mut findings);
        }
        self.mqtt.look_here(&mut findings);
        file(
            "mqtt.root_ca_certificate",
            self.mqtt.root_ca_certificate.as_deref(),
            &mut findings,
        );
        for (index, hook) in self.hooks.iter().enumerate() {
            hook.look_here(index, &mut findings);
            let authority = hook.root_ca_certificate.as_deref();
            file(
                &format!("hook[{index}].root_ca_certificate"),
                authority,
                &mut findings,
            );
        }
        if let Some(folder) = &self.node.state_dir {
            writable("node.state_dir", folder, &mut findings);
        }
        if let Some(folder) = &self.record.folder {
            writable("record.folder", folder, &mut findings);
        }
        for camera in &self.cameras {
            let found = camera.source_settings(self.frame).map(LiveSource::find).transpose();
            findings.check(format!("camera.{}.source", camera.name), found);
        }
        Here {
            missing: findings.0,
            detector,
        }
    }

    /// The detector as it runs on this machine: TensorRT's engines are kept in the state directory unless another folder is
    /// set, because each takes minutes to build.
    pub fn detector_here(&self) -> DetectorConfig {
        let mut detector = self.detector.clone();
        let kept = self.node.state_dir.as_ref().map(|folder| folder.join("engines"));
        detector.gpu.engine_cache = detector.gpu.engine_cache.or(kept);
        detector
    }

    /// Finds obstacles that may be temporary: ports in use, perhaps by this very node.
    pub fn in_the_way(&self) -> Vec<Finding> {
        let mut findings = Findings::default();
        let port = self.http.listen;
        let used = |place: &dyn Display, error: std::io::Error| {
            format!("{place} cannot be used now: {error}")
        };
        if port.port() != 0 {
            let bound = TcpListener::bind(port).map_err(|error| used(&port, error));
            findings.check("http.listen", bound);
        }
        if self.zenoh.config_file.is_none() {
            for endpoint in &self.zenoh.listen {
                let Some(place) = endpoint.strip_prefix("tcp/") else {
                    continue;
                };
                // Zenoh's options of an endpoint follow these signs.
                let address = place.split(['?', '#']).next().unwrap_or(place);
                let bound = TcpListener::bind(address).map_err(|error| used(endpoint, error));
                findings.check("zenoh.listen", bound);
            }
        }
        findings.0
    }

    /// The files of the certificates of its sessions, by key.
    pub(crate) fn certificates(&self) -> Vec<(String, PathBuf)> {
        let mut files = Vec::new();
        for (key, file) in self.uplink.files() {
            if key.ends_with("certificate") {
                files.push((key.to_owned(), file.to_owned()));
            }
        }
        files.extend(self.zenoh.tls_files("certificate"));
        files
    }

    /// Why a certificate of its sessions cannot be used now, or soon cannot.
    pub fn certificate_fault(&self) -> Option<String> {
        Certificates::read(self.certificates()).fault()
    }

    /// Why positions cannot be had now from where they should come.
    pub fn position_fault(&self) -> Option<String> {
        let source = &self.position.source;
        let fault = |error| format!("position.source: {source} cannot be used now: {error}");
        source.look().err().map(fault)
    }

    /// Finds files with secrets that other users of this machine can read; `file` is the configuration's.
    pub fn exposed_here(&self, file: Option<&Path>) -> Vec<Finding> {
        let mut found = exposed_files(file, &self.http, &self.tokens, &self.zenoh);
        if let Some(key) = &self.uplink.private_key {
            found.extend(exposed("uplink.private_key", key));
        }
        found.extend(self.mqtt.exposed());
        for (index, hook) in self.hooks.iter().enumerate() {
            found.extend(hook.exposed(index, file));
        }
        for camera in &self.cameras {
            let has_password = camera.source.as_ref().is_some_and(SourceAddress::holds_password);
            if has_password && let Some(file) = file {
                let key = format!("camera.{}.source", camera.name);
                found.extend(exposed(&key, file));
            }
        }
        found
    }

    /// Opens the detector's model, which finds its head and holds the configured classes against it; returns what there is
    /// to say about it. On the processor: a GPU may build engines for minutes, and `--online` tries it.
    fn check_detector(&self, findings: &mut Findings) -> Option<DetectorHere> {
        let here = DetectorConfig {
            providers: vec![ExecutionProvider::Cpu],
            batch_size: self.detector.batch_size,
            ..self.detector.clone()
        };
        let error = match DetectorNetwork::open(&here) {
            Err(error) => error,
            Ok(network) => {
                let usual = network.input().first_use(USUAL_PICTURE);
                let is_wasteful = usual.choice == Choice::Fixed && usual.is_wasteful();
                return Some(DetectorHere {
                    description: network.description(),
                    wasteful: is_wasteful.then(|| usual.to_string()),
                });
            }
        };
        let text = error.to_string();
        match text.split_once(": ") {
            // Such an error begins with its key.
            Some((key, reason)) if error.kind() == StartErrorKind::Configuration => {
                findings.add(key, reason);
            }
            _ => findings.add("detector.model", text),
        }
        None
    }

    fn check_library(&self, findings: &mut Findings) {
        let library = find_library(self.detector.onnxruntime.as_deref());
        let Some(library) = findings.check("detector.onnxruntime", library) else {
            return;
        };
        // Not an error if another provider is listed after the missing one.
        let name = match self.detector.providers.as_slice() {
            [ExecutionProvider::Cuda] => "cuda",
            [ExecutionProvider::TensorRt] => "tensorrt",
            _ => return,
        };
        let file = format!(
            "{}onnxruntime_providers_{name}{}",
            std::env::consts::DLL_PREFIX,
            std::env::consts::DLL_SUFFIX
        );
        if !library.with_file_name(&file).exists() {
            findings.add(
                "detector.providers",
                format!(
                    "`{name}` is not in this ONNX Runtime: there is no {file} beside {}; install a build with it, \
                     or list \"cpu\" after it",
                    library.display()
                ),
            );
        }
    }
}

/// Adds an error if a named file cannot be read.
fn file(key: &str, path: Option<&Path>, findings: &mut Findings) {
    let Some(path) = path else { return };
    // The full path: the reader may not know where a relative path starts.
    let full = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let shown = full.display();
    if path.is_dir() {
        findings.add(key, format!("{shown} is a folder, not a file"));
    } else if let Err(error) = std::fs::File::open(path) {
        let relative = if path.is_relative() {
            format!(
                " (`{}` begins in the folder where the program runs)",
                path.display()
            )
        } else {
            String::new()
        };
        findings.add(key, format!("{shown} cannot be read: {error}{relative}"));
    }
}

/// Adds an error if a folder cannot be written to or created.
fn writable(key: &str, folder: &Path, findings: &mut Findings) {
    // The nearest existing folder, or a link that leads nowhere: the node creates the rest when it starts. A relative path
    // begins where the program runs.
    let is_there = |folder: &&Path| folder.symlink_metadata().is_ok();
    let there = folder.ancestors().find(is_there).unwrap_or(Path::new("."));
    // By writing, because permissions are not the only possible reason: a full disk takes an empty file.
    let probe = there.join(format!(".albireo-check-{}", std::process::id()));
    if let Err(error) = std::fs::write(&probe, [0; 64 << 10]) {
        let reason = state_files::reason(there, &error);
        let fault = format!("{} cannot be used as a folder: {reason}", there.display());
        findings.add(key, fault);
    }
    let _ = std::fs::remove_file(&probe);
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_vision::detector::ClassNames;
    use std::path::PathBuf;

    fn keys(found: Vec<Finding>) -> Vec<String> {
        found.into_iter().map(|finding| finding.key).collect()
    }

    #[test]
    fn everything_missing_is_named_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        std::fs::write(&taken, "short").unwrap();
        let mut config = NodeConfig::default();
        config.detector.model = PathBuf::from("/nowhere/detector.onnx");
        config.detector.class_names = Some(ClassNames::File("/nowhere/classes.txt".into()));
        config.detector.onnxruntime = Some("/nowhere/libonnxruntime.so".into());
        config.screen.model = Some(folder.path().to_owned());
        config.http.token_file = Some(taken.clone());
        config.node.state_dir = Some(taken);
        config.uplink.root_ca_certificate = Some("/nowhere/ca.pem".into());
        let expected = "detector.model detector.class_names screen.model detector.onnxruntime http.token_file \
                        uplink.root_ca_certificate node.state_dir";
        assert_eq!(keys(config.here().missing).join(" "), expected);
    }

    #[test]
    fn a_link_to_nowhere_is_no_folder_that_can_be_created() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("state");
        std::os::unix::fs::symlink("nowhere", &link).unwrap();
        for path in [link.clone(), link.join("deeper")] {
            let mut findings = Findings::default();
            writable("node.state_dir", &path, &mut findings);
            let found = findings.0[0].to_string();
            let expected = format!(
                "{} cannot be used as a folder: it is a link",
                link.display()
            );
            assert!(found.contains(&expected), "{found}");
        }
    }

    #[test]
    fn a_list_of_classes_that_is_built_in_is_not_looked_for_as_a_file() {
        let mut config = NodeConfig::default();
        config.detector.model = PathBuf::from("/nowhere/detector.onnx");
        for name in ["coco", "coco91"] {
            config.detector.class_names = Some(ClassNames::File(name.into()));
            let missing = keys(config.here().missing);
            let is_missing = missing.iter().any(|key| key == "detector.class_names");
            assert!(!is_missing, "{missing:?}");
        }
    }

    #[test]
    fn engines_are_kept_in_the_state_directory_unless_another_folder_is_set() {
        let mut config = NodeConfig::default();
        let kept = |config: &NodeConfig| config.detector_here().gpu.engine_cache;
        assert_eq!(kept(&config), None);
        config.node.state_dir = Some("/state".into());
        assert_eq!(kept(&config), Some("/state/engines".into()));
        config.detector.gpu.engine_cache = Some("/engines".into());
        assert_eq!(kept(&config), Some("/engines".into()));
    }

    #[test]
    fn a_provider_missing_from_the_library_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let library = folder.path().join("libonnxruntime.so");
        std::fs::write(&library, []).unwrap();
        let mut config = NodeConfig::default();
        config.detector.onnxruntime = Some(library);
        config.detector.providers = vec![ExecutionProvider::Cuda];
        let fault = |config: &NodeConfig| {
            config
                .here()
                .missing
                .into_iter()
                .find(|finding| finding.key == "detector.providers")
                .map_or(String::new(), |finding| finding.reason)
        };
        let reason = fault(&config);
        let expected = "`cuda` is not in this ONNX Runtime";
        assert!(reason.contains(expected), "{reason}");
        std::fs::write(folder.path().join("libonnxruntime_providers_cuda.so"), []).unwrap();
        assert_eq!(fault(&config), "");
    }

    #[test]
    fn a_port_in_use_is_an_error() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let mut config = NodeConfig::default();
        config.http.listen = address;
        config.zenoh.listen = vec![format!("tcp/{address}")];
        assert_eq!(keys(config.in_the_way()), ["http.listen", "zenoh.listen"]);
    }
}
