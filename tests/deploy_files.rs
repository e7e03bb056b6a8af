//! The shipped files: manual pages, completions, packages, containers, proxies.

use crate::support::fleet::HubProcess;
use crate::support::{assert_contains, free_port, process, project, run, run_command, text, until};
use clap::CommandFactory;
use std::path::Path;
use std::process::Command;

fn says(arguments: &[&str]) -> String {
    run(arguments, &[]).succeeds()
}

#[track_caller]
fn accepts(program: &str, arguments: &[&str]) -> String {
    run_command(Command::new(program).args(arguments)).succeeds()
}

#[test]
fn every_subcommand_has_a_manual_page_with_examples_and_every_shell_its_completions() {
    let folder = tempfile::tempdir().unwrap();
    says(&["man", folder.path().to_str().unwrap()]);
    for command in albireo::cli::Arguments::command().get_subcommands() {
        let page = format!("albireo-{}.1", command.get_name());
        let page = std::fs::read_to_string(folder.path().join(page)).unwrap();
        assert_contains(&page, &[".SH NAME", "Examples:"]);
    }
    for shell in ["bash", "zsh", "fish"] {
        assert_contains(&says(&["completions", shell]), &["node"]);
    }
}

#[test]
fn manifests_and_changelog_agree_on_the_version_and_another_tag_is_rejected() {
    let notes_of = |tag| run_command(Command::new("bash").args(["deploy/release-version.sh", tag]));
    let notes = notes_of(concat!("v", env!("CARGO_PKG_VERSION"))).succeeds();
    assert!(!notes.is_empty(), "no notes in the changelog");
    assert_contains(&notes_of("v0.0.1").fails(), &["the tag has 0.0.1"]);
}

#[test]
fn every_action_in_the_public_workflows_is_pinned_by_hash() {
    for file in ["ci", "release"] {
        let text = text(&format!(".github/workflows/{file}.yml"));
        for action in text.lines().filter(|line| line.contains("uses: ")) {
            let (_, version) = action.split_once('@').unwrap();
            let hash = version.bytes().take_while(u8::is_ascii_hexdigit);
            assert_eq!(hash.count(), 40, "{file}: {action}");
        }
        // Without this line a job has all permissions.
        assert_contains(&text, &["uses: ", "\npermissions:"]);
    }
}

#[test]
fn scripts_outside_the_packages_parse_and_stop_at_the_first_error() {
    for script in ["deploy/dist.sh", "deploy/fetch-onnxruntime.sh"] {
        accepts("bash", &["-n", script]);
        assert_contains(&text(script), &["\nset -e"]);
    }
}

/// An attribute belongs to the case below it.
#[rstest::rstest]
#[ignore = "needs shellcheck"]
#[case::shellcheck("shellcheck --severity=warning deploy/*.sh deploy/debian/*/*")]
#[ignore = "needs hadolint"]
#[case::hadolint("hadolint deploy/docker/Dockerfile deploy/docker/Dockerfile.l4t")]
#[ignore = "needs Docker Compose"]
#[case::compose(
    "cd deploy/docker && docker compose config -q || docker-compose -f compose.yml config -q"
)]
fn the_shipped_files_are_valid_for_the_tools_that_read_them(#[case] check: &str) {
    accepts("sh", &["-c", check]);
}

/// Runs a maintainer script of `package` with `folder` as its root, and with fake user commands.
fn runs_in(package: &str, script: &str, argument: &str, folder: &Path) {
    let here = folder.display();
    let text = text(&format!("deploy/debian/{package}/{script}"));
    // The second is where the package gets the lines that enable, restart and stop its unit.
    assert_contains(&text, &["\nset -e\n", "\n#DEBHELPER#\n"]);
    let text = text
        .replace("/etc/", &format!("{here}/etc/"))
        .replace("/var/lib/", &format!("{here}/var/lib/"));
    let file = folder.join(script);
    std::fs::write(&file, text).unwrap();
    let bin = folder.join("bin");
    std::fs::create_dir_all(&bin).unwrap();
    for command in ["getent", "groupadd", "useradd", "chown"] {
        crate::support::script(&bin, command, "exit 0");
    }
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let mut sh = Command::new("sh");
    run_command(sh.arg(&file).arg(argument).env("PATH", path)).succeeds();
}

#[test]
fn installing_makes_a_token_and_a_name_upgrading_keeps_them_and_purging_removes_them() {
    use std::os::unix::fs::PermissionsExt;
    for package in ["node", "hub", "router"] {
        let folder = tempfile::tempdir().unwrap();
        for made in ["etc/albireo", "etc/default"] {
            std::fs::create_dir_all(folder.path().join(made)).unwrap();
        }
        let token = folder.path().join(format!("etc/albireo/{package}-token"));
        runs_in(package, "postinst", "configure", folder.path());
        let first = std::fs::read_to_string(&token).unwrap();
        let mut digits = first.trim_end().bytes();
        assert_eq!(digits.len(), 48, "{first}");
        assert!(digits.all(|digit| digit.is_ascii_hexdigit()), "{first}");
        let mode = std::fs::metadata(&token).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode, 0o640, "{package}");
        let name = folder.path().join("etc/default/albireo-node");
        if package == "node" {
            let text = std::fs::read_to_string(&name).unwrap();
            let value = text.trim_end().strip_prefix("ALBIREO_NODE__NAME=").unwrap();
            albireo_wire::check_segment("node name", value).unwrap();
            std::fs::write(&name, "ALBIREO_NODE__NAME=mine\n").unwrap();
        }
        runs_in(package, "postinst", "configure", folder.path());
        let kept = std::fs::read_to_string(&token).unwrap();
        assert_eq!(kept, first, "an upgrade keeps it");
        if package == "node" {
            assert_contains(&std::fs::read_to_string(&name).unwrap(), &["mine"]);
        }
        runs_in(package, "postrm", "remove", folder.path());
        assert!(token.exists(), "{package}: a removal keeps it");
        runs_in(package, "postrm", "purge", folder.path());
        assert!(!token.exists() && !name.exists(), "{package}");
    }
}

#[test]
fn every_file_of_a_package_exists_and_brings_its_configuration() {
    let manifest: toml::Value = toml::from_str(&text("Cargo.toml")).unwrap();
    let packages = &manifest["package"]["metadata"]["deb"];
    let variants = packages["variants"].as_table().unwrap();
    assert_eq!(variants.len(), 4);
    for (name, variant) in variants {
        let assets = variant["assets"].as_array().unwrap();
        for asset in assets {
            let from = asset[0].as_str().unwrap();
            // `make dist` builds files that are not in the clone.
            let built = from.starts_with("target/");
            let place = project(from.trim_end_matches("/*"));
            assert!(built || place.exists(), "{name}: {from}");
        }
        let Some(scripts) = variant.get("maintainer-scripts") else {
            continue;
        };
        let installed = project(scripts.as_str().unwrap()).join("postinst");
        assert!(installed.exists(), "{name}: {scripts}");
        for kept in variant["conf-files"].as_array().unwrap() {
            let kept = kept.as_str().unwrap();
            let brought = |asset: &toml::Value| asset[1].as_str() == kept.strip_prefix('/');
            assert!(assets.iter().any(brought), "{name}: {kept}");
        }
    }
}

#[test]
fn every_image_copies_every_workspace_member_and_only_files_that_exist() {
    let manifest: toml::Value = toml::from_str(&text("Cargo.toml")).unwrap();
    for image in ["Dockerfile", "Dockerfile.l4t"] {
        let image = text(&format!("deploy/docker/{image}"));
        for member in manifest["workspace"]["members"].as_array().unwrap() {
            let folder = member.as_str().unwrap().split('/').next().unwrap();
            assert_contains(&image, &[&format!("\nCOPY {folder} {folder}\n")]);
        }
        let copied = image.lines().filter_map(|line| line.strip_prefix("COPY "));
        for line in copied.filter(|line| !line.starts_with("--from")) {
            let (from, _) = line.rsplit_once(' ').unwrap();
            // Skips names that are set at build time.
            for from in from.split(' ').filter(|word| !word.contains("${")) {
                assert!(project(from).exists(), "{from} of `{line}`");
            }
        }
        assert_contains(&image, &["\nUSER ", "\nHEALTHCHECK "]);
    }
}

#[test]
fn the_shipped_configurations_pass_check() {
    // The file alone: the model and the token come from the package.
    says(&["check", "--file-only", "deploy/debian/node.toml"]);
    let check = ["check", "--file-only", "deploy/docker/node.toml"];
    run(&check, &[("ALBIREO_NODE__NAME", "car-1")]).succeeds();
    let peer = zenoh::Config::from_file(project("deploy/zenoh/node-peer.json5"));
    assert!(peer.is_ok(), "{:?}", peer.err());
    says(&["check", "--file-only", "deploy/debian/hub.toml"]);
    says(&["check", "--file-only", "deploy/docker/hub.toml"]);
    for router in [
        &["deploy/docker/router.json5"][..],
        &["config/zenoh-router.json5"],
        // Access rules are written per fleet, and certificates, too.
        &[
            "deploy/zenoh/router.json5",
            "--no-access-control",
            "--file-only",
        ],
    ] {
        says(&[&["router", "--check", "--config"][..], router].concat());
    }
}

#[test]
fn every_command_in_the_compose_file_parses() {
    let compose = text("deploy/docker/compose.yml");
    let commands = compose
        .lines()
        .filter_map(|line| line.trim().strip_prefix("command: "))
        .map(|command| serde_json::from_str::<Vec<String>>(command).unwrap());
    // The broker is another program.
    let commands: Vec<_> = commands.filter(|words| words[0] != "mosquitto").collect();
    assert!(commands.len() >= 6, "{commands:?}");
    for words in commands {
        let words = std::iter::once("albireo").chain(words.iter().map(String::as_str));
        albireo::cli::Arguments::command().try_get_matches_from(words).unwrap();
    }
}

#[tokio::test]
#[ignore = "needs Caddy and curl"]
async fn the_proxy_adds_tls_and_forwards_the_token_and_the_event_stream() {
    let folder = tempfile::tempdir().unwrap();
    let token = ("ALBIREO_HTTP__TOKEN", "a-long-random-secret".to_owned());
    let (_, hub) = HubProcess::fresh(vec![token]).await;
    let port = free_port();
    let site = format!("https://localhost:{port} {{\n\ttls internal");
    let caddyfile = text("deploy/proxy/Caddyfile")
        .replace("fleet.example {", &site)
        .replace("127.0.0.1:8090", hub.http.trim_start_matches("http://"));
    let file = folder.path().join("Caddyfile");
    let here = "{\n\tadmin off\n\tauto_https disable_redirects\n\tskip_install_trust\n}\n";
    std::fs::write(&file, here.to_owned() + &caddyfile).unwrap();
    let _caddy = process("caddy")
        .args(["run", "--adapter", "caddyfile", "--config"])
        .arg(&file)
        .env("XDG_DATA_HOME", folder.path())
        .env("XDG_CONFIG_HOME", folder.path())
        .env("HOME", folder.path())
        .stderr(std::fs::File::create(folder.path().join("caddy.log")).unwrap())
        .spawn()
        .unwrap();
    // Caddy creates its authority at the first start; curl trusts it and checks the name.
    let authority = folder.path().join("caddy/pki/authorities/local/root.crt");
    let asks = |path: &str, more: &[&str]| {
        let mut curl = Command::new("curl");
        curl.args(["--silent", "--show-error", "--max-time", "30", "--cacert"]);
        curl.arg(&authority).args(more);
        run_command(curl.arg(format!("https://localhost:{port}{path}"))).out
    };
    let answers = async || asks("/healthz", &[]).contains("ok");
    until("Caddy answers", answers).await;
    let status = ["--output", "/dev/null", "--write-out", "%{http_code}"];
    assert_eq!(asks("/api/v1/nodes", &status), "401");
    let token = ["--header", "Authorization: Bearer a-long-random-secret"];
    let both = [&status[..], &token].concat();
    assert_eq!(asks("/api/v1/nodes", &both), "200");
    // The first bytes of the stream arrive although it does not end.
    let included = [&token[..], &["--no-buffer", "--include", "--max-time", "3"]].concat();
    let stream = asks("/api/v1/events", &included).to_lowercase();
    assert_contains(&stream, &["text/event-stream", "strict-transport-security"]);
}
