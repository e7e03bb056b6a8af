//! The files shipped beside the programs: manual pages, completions, packages, containers, proxies.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use crate::support::{PATIENCE, albireo, free_port};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn text(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

async fn says(arguments: &[&str]) -> String {
    let ended = albireo().args(arguments).output().await.unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success(), "{arguments:?}: {said}");
    String::from_utf8(ended.stdout).unwrap()
}

#[tokio::test]
async fn every_subcommand_has_a_manual_page_and_every_shell_its_completions() {
    let folder = tempfile::tempdir().unwrap();
    says(&["man", folder.path().to_str().unwrap()]).await;
    for page in ["albireo", "albireo-node", "albireo-check", "albireo-man"] {
        let page = std::fs::read_to_string(folder.path().join(format!("{page}.1"))).unwrap();
        assert!(page.contains(".SH NAME"), "{page}");
    }
    #[cfg(feature = "hub")]
    for page in [
        "albireo-hub",
        "albireo-router",
        "albireo-cert-revoke",
        "albireo-fleet",
    ] {
        assert!(folder.path().join(format!("{page}.1")).exists(), "{page}");
    }
    for shell in ["bash", "zsh", "fish"] {
        let script = says(&["completions", shell]).await;
        assert!(script.contains("node"), "{shell}: {script}");
    }
    // A shell takes them.
    let script = folder.path().join("completions.bash");
    std::fs::write(&script, says(&["completions", "bash"]).await).unwrap();
    let taken = Command::new("bash")
        .arg("-n")
        .arg(&script)
        .status()
        .unwrap();
    assert!(taken.success());
}

/// The scripts that are shipped.
fn scripts() -> Vec<PathBuf> {
    let mut found = vec![
        root().join("deploy/dist.sh"),
        root().join("deploy/fetch-onnxruntime.sh"),
    ];
    for entry in std::fs::read_dir(root().join("deploy/debian")).unwrap() {
        let folder = entry.unwrap().path();
        if !folder.is_dir() {
            continue;
        }
        for file in std::fs::read_dir(folder).unwrap() {
            let file = file.unwrap().path();
            let name = file.file_name().unwrap().to_string_lossy().into_owned();
            if ["preinst", "postinst", "prerm", "postrm"].contains(&name.as_str()) {
                found.push(file);
            }
        }
    }
    found
}

#[test]
fn every_script_can_be_read_by_its_shell_and_ends_at_the_first_error() {
    let scripts = scripts();
    assert!(scripts.len() >= 6, "{scripts:?}");
    for script in scripts {
        let text = std::fs::read_to_string(&script).unwrap();
        let shell = if text.starts_with("#!/bin/sh") {
            "sh"
        } else {
            "bash"
        };
        let read = Command::new(shell).arg("-n").arg(&script).status().unwrap();
        assert!(read.success(), "{}", script.display());
        assert!(
            text.lines().any(|line| line.starts_with("set -e")),
            "{}: no set -e",
            script.display()
        );
    }
}

#[test]
fn manifests_and_changelog_have_one_version_and_a_tag_of_another_is_refused() {
    let run = |tag: &str| {
        std::process::Command::new("bash")
            .args(["deploy/release-version.sh", tag])
            .current_dir(root())
            .output()
            .unwrap()
    };
    let notes = run(concat!("v", env!("CARGO_PKG_VERSION")));
    assert!(notes.status.success(), "{notes:?}");
    assert!(!notes.stdout.is_empty(), "the changelog says nothing");
    let refused = run("v0.0.1");
    assert!(!refused.status.success());
    assert!(String::from_utf8_lossy(&refused.stderr).contains("the tag has 0.0.1"));
}

#[test]
fn every_action_of_the_public_workflows_is_pinned_by_its_hash() {
    for file in ["ci", "release"] {
        let text = text(&format!(".github/workflows/{file}.yml"));
        let uses: Vec<_> = (text.lines())
            .filter_map(|line| line.trim().trim_start_matches("- ").strip_prefix("uses: "))
            .collect();
        assert!(!uses.is_empty(), "{file}");
        for action in uses {
            let hash = action.split_once('@').unwrap().1.split(' ').next().unwrap();
            let is_hash = hash.len() == 40 && hash.bytes().all(|b| b.is_ascii_hexdigit());
            assert!(is_hash, "{file}: {action}");
        }
        assert!(text.contains("\npermissions:"), "{file}: all permissions");
    }
}

#[test]
#[ignore = "needs shellcheck"]
fn shellcheck_finds_nothing_in_the_scripts() {
    for script in scripts() {
        let ended = Command::new("shellcheck")
            .arg("--severity=warning")
            .arg(&script)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&ended.stdout);
        assert!(ended.status.success(), "{said}");
    }
}

#[test]
#[ignore = "needs hadolint"]
fn hadolint_finds_nothing_in_the_images() {
    for image in ["Dockerfile", "Dockerfile.l4t"] {
        let ended = Command::new("hadolint")
            .arg(root().join("deploy/docker").join(image))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&ended.stdout);
        assert!(ended.status.success(), "{image}: {said}");
    }
}

#[test]
fn every_maintainer_script_leaves_room_for_debhelper() {
    for script in scripts() {
        if script.components().any(|part| part.as_os_str() == "debian") {
            let text = std::fs::read_to_string(&script).unwrap();
            assert!(text.contains("#DEBHELPER#"), "{}", script.display());
        }
    }
}

/// Runs a maintainer script of `package` with everything it touches under `root`, and users and owners made up.
fn runs_in(package: &str, script: &str, argument: &str, folder: &Path) {
    let here = folder.display();
    let text = text(&format!("deploy/debian/{package}/{script}"))
        .replace("/etc/", &format!("{here}/etc/"))
        .replace("/var/lib/", &format!("{here}/var/lib/"))
        .replace("#DEBHELPER#", "");
    let file = folder.join(script);
    std::fs::write(&file, text).unwrap();
    let bin = folder.join("bin");
    std::fs::create_dir_all(&bin).unwrap();
    for command in ["getent", "groupadd", "useradd", "chown"] {
        let stub = bin.join(command);
        std::fs::write(&stub, "#!/bin/sh\nexit 0\n").unwrap();
        let executable = Command::new("chmod").arg("755").arg(&stub).status();
        assert!(executable.unwrap().success());
    }
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let ended = Command::new("sh")
        .arg(&file)
        .arg(argument)
        .env("PATH", path)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(
        ended.status.success(),
        "{package} {script} {argument}: {said}"
    );
}

#[test]
fn an_installation_makes_a_token_and_a_name_an_upgrade_keeps_them_and_a_purge_takes_them_away() {
    use std::os::unix::fs::PermissionsExt;
    for package in ["node", "hub", "router"] {
        let folder = tempfile::tempdir().unwrap();
        for made in ["etc/albireo", "etc/default"] {
            std::fs::create_dir_all(folder.path().join(made)).unwrap();
        }
        let token = folder.path().join(format!("etc/albireo/{package}-token"));
        runs_in(package, "postinst", "configure", folder.path());
        let first = std::fs::read_to_string(&token).unwrap();
        assert_eq!(first.trim_end().len(), 48, "{first}");
        assert!(
            first
                .trim_end()
                .bytes()
                .all(|byte| byte.is_ascii_hexdigit()),
            "{first}"
        );
        let mode = std::fs::metadata(&token).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode, 0o640, "{package}");
        let name = folder.path().join("etc/default/albireo-node");
        if package == "node" {
            let text = std::fs::read_to_string(&name).unwrap();
            let value = text.trim_end().strip_prefix("ALBIREO_NODE__NAME=").unwrap();
            assert!(
                albireo_wire::check_segment("node name", value).is_ok(),
                "{value}"
            );
            std::fs::write(&name, "ALBIREO_NODE__NAME=mine\n").unwrap();
        }
        runs_in(package, "postinst", "configure", folder.path());
        assert_eq!(
            std::fs::read_to_string(&token).unwrap(),
            first,
            "an upgrade keeps it"
        );
        if package == "node" {
            assert!(std::fs::read_to_string(&name).unwrap().contains("mine"));
        }
        runs_in(package, "postrm", "remove", folder.path());
        assert!(token.exists(), "{package}: a removal keeps it");
        runs_in(package, "postrm", "purge", folder.path());
        assert!(!token.exists() && !name.exists(), "{package}");
    }
}

#[test]
fn every_image_is_built_with_every_member_of_the_workspace() {
    let manifest: toml::Value = toml::from_str(&text("Cargo.toml")).unwrap();
    for image in ["Dockerfile", "Dockerfile.l4t"] {
        let steps = text(&format!("deploy/docker/{image}"));
        for member in manifest["workspace"]["members"].as_array().unwrap() {
            let folder = member.as_str().unwrap().split('/').next().unwrap();
            let copied = format!("\nCOPY {folder} {folder}\n");
            assert!(steps.contains(&copied), "{image}: {folder}");
        }
    }
}

#[test]
fn every_file_a_package_or_an_image_takes_along_is_there() {
    let manifest: toml::Value = toml::from_str(&text("Cargo.toml")).unwrap();
    let packages = &manifest["package"]["metadata"]["deb"];
    let variants = packages["variants"].as_table().unwrap();
    let names: BTreeSet<&str> = variants.keys().map(String::as_str).collect();
    assert_eq!(names, BTreeSet::from(["hub", "node", "program", "router"]));
    for (name, variant) in variants {
        for asset in variant["assets"].as_array().unwrap() {
            let from = asset[0].as_str().unwrap();
            // What `make dist` builds is not in the clone.
            let built = from.starts_with("target/");
            let place = root().join(from.trim_end_matches("/*"));
            assert!(built || place.exists(), "{name}: {from}");
        }
        let Some(scripts) = variant.get("maintainer-scripts") else {
            continue;
        };
        let scripts = scripts.as_str().unwrap();
        assert!(
            root().join(scripts).join("postinst").exists(),
            "{name}: {scripts}"
        );
        for kept in variant["conf-files"].as_array().unwrap() {
            let kept = kept.as_str().unwrap();
            assert!(kept.starts_with("/etc/albireo/"), "{kept}");
            let brought = |asset: &toml::Value| asset[1].as_str() == kept.strip_prefix('/');
            assert!(
                variant["assets"].as_array().unwrap().iter().any(brought),
                "{kept}"
            );
        }
    }
    for image in ["Dockerfile", "Dockerfile.l4t"] {
        let image = text(&format!("deploy/docker/{image}"));
        let copied = (image.lines())
            .filter_map(|line| line.strip_prefix("COPY "))
            .filter(|line| !line.starts_with("--from"));
        for line in copied {
            let words: Vec<&str> = line.split_whitespace().collect();
            // What is named at build time comes along then.
            let named = words.iter().filter(|word| !word.contains("${"));
            for from in named
                .take(words.len() - 1)
                .filter(|word| !word.starts_with('/'))
            {
                assert!(root().join(from).exists(), "{from} of `{line}`");
            }
        }
        assert!(image.contains("\nUSER "), "it runs as root");
        assert!(image.contains("\nHEALTHCHECK "));
    }
}

#[tokio::test]
async fn the_configurations_that_packages_and_the_compose_file_bring_can_be_used() {
    // The file alone: the model and the token come with the package.
    says(&["check", "--file-only", "deploy/debian/node.toml"]).await;
    for node in ["car-1", "car-2", "car-3"] {
        let ended = albireo()
            .args(["check", "--file-only", "deploy/docker/node.toml"])
            .env("ALBIREO_NODE__NAME", node)
            .output()
            .await
            .unwrap();
        assert!(
            ended.status.success(),
            "{}",
            String::from_utf8_lossy(&ended.stderr)
        );
    }
    #[cfg(feature = "hub")]
    {
        says(&["check", "deploy/debian/hub.toml"]).await;
        says(&["check", "deploy/docker/hub.toml"]).await;
        says(&[
            "router",
            "--check",
            "--config",
            "deploy/docker/router.json5",
        ])
        .await;
        // The access rules are written for each fleet.
        let certified = "deploy/zenoh/router.json5";
        says(&[
            "router",
            "--check",
            "--config",
            certified,
            "--no-access-control",
        ])
        .await;
        says(&["router", "--check", "--config", "config/zenoh-router.json5"]).await;
    }
}

#[test]
fn zenoh_takes_every_configuration_of_it_that_is_shipped() {
    for file in [
        "config/zenoh-router.json5",
        "deploy/docker/router.json5",
        "deploy/zenoh/hub.json5",
        "deploy/zenoh/node-peer.json5",
        "deploy/zenoh/router.json5",
    ] {
        let taken = zenoh::Config::from_file(root().join(file));
        assert!(taken.is_ok(), "{file}: {:?}", taken.err());
    }
}

#[test]
fn every_command_of_the_compose_file_is_one_of_the_program() {
    use clap::Parser;
    let compose = text("deploy/docker/compose.yml");
    let mut seen = 0;
    for line in compose.lines() {
        let Some(command) = line.trim().strip_prefix("command: ") else {
            continue;
        };
        let words: Vec<String> = serde_json::from_str(command).unwrap();
        // The bridge is another program.
        if words[0].starts_with("--") || !cfg!(feature = "hub") {
            continue;
        }
        let parsed = albireo::cli::Arguments::try_parse_from(
            std::iter::once("albireo".to_owned()).chain(words.clone()),
        );
        assert!(parsed.is_ok(), "{words:?}: {:?}", parsed.err());
        seen += 1;
    }
    assert!(seen >= 6 || !cfg!(feature = "hub"), "{seen}");
}

#[test]
#[ignore = "needs Docker Compose"]
fn the_compose_file_is_one() {
    let plugin = Command::new("docker").args(["compose", "version"]).output();
    let mut command = if plugin.is_ok_and(|ended| ended.status.success()) {
        let mut command = Command::new("docker");
        command.arg("compose");
        command
    } else {
        Command::new("docker-compose")
    };
    let ended = command
        .args(["-f", "deploy/docker/compose.yml", "config", "--quiet"])
        .current_dir(root())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success(), "{said}");
}

#[cfg(feature = "hub")]
#[tokio::test]
#[ignore = "needs Caddy and curl"]
async fn the_proxy_gives_tls_hands_on_the_token_and_lets_the_event_stream_through() {
    use crate::support::fleet::{HubProcess, settings, sqlite};
    let folder = tempfile::tempdir().unwrap();
    let (_, mut settings) = settings(&sqlite(folder.path()));
    settings.push(("ALBIREO_HTTP__TOKEN", "a-long-random-secret".to_owned()));
    let hub = HubProcess::start(&settings);
    hub.until_ready().await;
    let port = free_port();
    let caddyfile = text("deploy/proxy/Caddyfile")
        .replace(
            "fleet.example {",
            &format!("https://localhost:{port} {{\n\ttls internal"),
        )
        .replace("127.0.0.1:8090", hub.http.trim_start_matches("http://"));
    let file = folder.path().join("Caddyfile");
    let here = "{\n\tadmin off\n\tauto_https disable_redirects\n\tskip_install_trust\n}\n";
    std::fs::write(&file, here.to_owned() + &caddyfile).unwrap();
    let _caddy = tokio::process::Command::new("caddy")
        .args(["run", "--adapter", "caddyfile", "--config"])
        .arg(&file)
        .env("XDG_DATA_HOME", folder.path())
        .env("XDG_CONFIG_HOME", folder.path())
        .env("HOME", folder.path())
        .stderr(std::fs::File::create(folder.path().join("caddy.log")).unwrap())
        .kill_on_drop(true)
        .spawn()
        .unwrap();
    // Its authority is made at the first start; curl trusts it and checks the name.
    let authority = folder.path().join("caddy/pki/authorities/local/root.crt");
    let asks = |path: &str, more: &[&str]| {
        let ended = Command::new("curl")
            .args(["--silent", "--show-error", "--max-time", "3", "--cacert"])
            .arg(&authority)
            .args(more)
            .arg(format!("https://localhost:{port}{path}"))
            .output()
            .unwrap();
        String::from_utf8_lossy(&ended.stdout).into_owned()
    };
    let until = Instant::now() + PATIENCE;
    while !asks("/healthz", &[]).contains("ok") {
        let log = std::fs::read_to_string(folder.path().join("caddy.log")).unwrap_or_default();
        assert!(Instant::now() < until, "{log}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let status = ["--output", "/dev/null", "--write-out", "%{http_code}"];
    assert_eq!(asks("/api/v1/nodes", &status), "401");
    let token = ["--header", "Authorization: Bearer a-long-random-secret"];
    assert_eq!(
        asks("/api/v1/nodes", &[&status[..], &token].concat()),
        "200"
    );
    // The first bytes of the stream come although it does not end.
    let stream = asks(
        "/api/v1/events",
        &[&token[..], &["--no-buffer", "--include"]].concat(),
    );
    assert!(stream.contains("text/event-stream"), "{stream}");
    assert!(
        stream.to_lowercase().contains("strict-transport-security"),
        "{stream}"
    );
}
