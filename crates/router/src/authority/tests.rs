use super::*;
use std::os::unix::fs::PermissionsExt;
use std::process::Command;

const YEAR: Duration = Duration::from_secs(365 * 86_400);

fn authority() -> (tempfile::TempDir, Authority) {
    let folder = tempfile::tempdir().unwrap();
    let authority = Authority::create(folder.path(), "fleet north", YEAR * 10).unwrap();
    (folder, authority)
}

fn issue(authority: &mut Authority, role: Role, name: &str) -> Result<Issued, RouterError> {
    authority.issue(role, name, &[], YEAR)
}

#[track_caller]
fn assert_refused<T>(done: Result<T, RouterError>, why: &str) {
    let error = done.err().unwrap().to_string();
    assert!(error.contains(why), "{error}");
}

#[test]
fn a_certificate_names_role_name_and_issue_and_keys_are_private() {
    let (folder, mut authority) = authority();
    let issued = issue(&mut authority, Role::Node, "car-7").unwrap();
    assert_eq!(subject(&issued.certificate).unwrap(), "node/car-7/1");
    for (file, mode) in [
        (issued.key.as_path(), 0o600),
        (issued.certificate.as_path(), 0o644),
        (&folder.path().join(AUTHORITY_KEY), 0o600),
        (&folder.path().join("list.json"), 0o600),
    ] {
        let has = std::fs::metadata(file).unwrap().permissions().mode() & 0o777;
        assert_eq!(has, mode, "{}", file.display());
    }
}

#[test]
fn openssl_accepts_the_chain_for_the_intended_purposes() {
    let (folder, mut authority) = authority();
    let hosts = ["router.example".to_owned(), "127.0.0.1".to_owned()];
    let router = authority.issue(Role::Router, "east", &hosts, YEAR).unwrap();
    let node = issue(&mut authority, Role::Node, "car-7").unwrap();
    let openssl = |arguments: &[&str], file: &Path| {
        Command::new("openssl").args(arguments).arg(file).output().unwrap()
    };
    let trusted = folder.path().join(AUTHORITY).display().to_string();
    let verifies = |purpose: &str, file: &Path| {
        let verify = ["verify", "-purpose", purpose, "-CAfile", &trusted];
        openssl(&verify, file).status.success()
    };
    assert!(verifies("sslserver", &router.certificate));
    assert!(verifies("sslclient", &router.certificate));
    assert!(verifies("sslclient", &node.certificate));
    let is_router = verifies("sslserver", &node.certificate);
    assert!(!is_router, "a node is no router");
    let show = ["x509", "-noout", "-ext", "subjectAltName", "-in"];
    let shown = String::from_utf8(openssl(&show, &router.certificate).stdout).unwrap();
    for part in ["DNS:router.example", "IP Address:127.0.0.1"] {
        assert!(shown.contains(part), "{shown}");
    }
}

#[test]
fn a_name_has_one_valid_certificate_and_a_new_issue_after_revocation() {
    let (folder, mut authority) = authority();
    issue(&mut authority, Role::Node, "car-7").unwrap();
    let again = issue(&mut authority, Role::Node, "car-7");
    assert_refused(again, "renew it, or revoke it first");
    // The same name in another role is a different holder.
    issue(&mut authority, Role::Hub, "car-7").unwrap();
    let revoked = authority.revoke(Role::Node, "car-7").unwrap();
    assert_eq!(revoked.issue, 1);
    let twice = authority.revoke(Role::Node, "car-7");
    assert_refused(twice, "no valid certificate");
    drop(authority);
    let mut authority = Authority::open(folder.path()).unwrap();
    let next = issue(&mut authority, Role::Node, "car-7").unwrap();
    assert_eq!(subject(&next.certificate).unwrap(), "node/car-7/2");
    assert_eq!(authority.entries().len(), 3);
}

#[test]
fn renewal_keeps_the_name_and_replaces_key_and_expiry() {
    let (_folder, mut authority) = authority();
    let first = issue(&mut authority, Role::Node, "car-7").unwrap();
    let key = std::fs::read(&first.key).unwrap();
    let second = authority.renew(Role::Node, "car-7", YEAR * 2).unwrap();
    assert_eq!(subject(&second.certificate).unwrap(), "node/car-7/1");
    assert_ne!(std::fs::read(&second.key).unwrap(), key);
    assert!(second.entry.ends_s > first.entry.ends_s);
    assert_eq!(authority.entries().len(), 1);
    let nobody = authority.renew(Role::Node, "car-8", YEAR);
    assert_refused(nobody, "no valid certificate");
}

#[test]
fn unsafe_names_and_impossible_lifetimes_are_rejected() {
    let (_folder, mut authority) = authority();
    for name in ["", "a/b", "*", "../x", "a b"] {
        assert_refused(issue(&mut authority, Role::Node, name), "name");
    }
    // No rules could be made for it.
    assert_refused(issue(&mut authority, Role::Node, "all"), "`all`");
    for lasts in [YEAR * 1_000_000, Duration::MAX] {
        let refused = authority.issue(Role::Node, "car-7", &[], lasts);
        assert_refused(refused, "a certificate cannot contain that time");
    }
}

#[test]
fn a_host_that_no_node_could_find_in_a_certificate_is_refused() {
    let (_folder, mut authority) = authority();
    let mut issue =
        |name: &str, host: &str| authority.issue(Role::Router, name, &[host.to_owned()], YEAR);
    for host in [
        "",
        "127.0.0.1:7447",
        "tcp/host:7447",
        "https://x",
        "[::1]",
        "not a host",
        "a..b",
        "a.example.",
        "-a.example",
        "999.0.0.1",
    ] {
        assert_refused(issue("east", host), "without scheme, port and brackets");
    }
    let hosts = [
        "127.0.0.1",
        "::1",
        "router",
        "a-1.fleet.example",
        "*.fleet.example",
    ];
    for (number, host) in hosts.iter().enumerate() {
        issue(&format!("router-{number}"), host).unwrap();
    }
}

#[test]
fn an_authority_with_the_certificate_of_another_key_issues_nothing() {
    let (folder, first) = authority();
    let (other, _second) = authority();
    drop(first);
    let certificate = folder.path().join(AUTHORITY);
    std::fs::copy(other.path().join(AUTHORITY), &certificate).unwrap();
    let refused = Authority::open(folder.path());
    assert_refused(refused, "belongs to another key than that in authority.key");
}

#[test]
fn neither_a_second_authority_nor_an_unreadable_list_overwrites_the_first() {
    let (folder, first) = authority();
    drop(first);
    let again = Authority::create(folder.path(), "other", YEAR);
    assert_refused(again, "authority.pem exists already");
    let list = folder.path().join("list.json");
    for text in ["{", r#"{"v": 9, "issued": []}"#] {
        std::fs::write(&list, text).unwrap();
        assert_refused(Authority::open(folder.path()), "list.json");
        assert_eq!(std::fs::read_to_string(&list).unwrap(), text);
    }
}

#[test]
fn a_look_for_an_authority_where_there_is_none_leaves_nothing_there() {
    let folder = tempfile::tempdir().unwrap();
    let refused = Authority::open(folder.path());
    assert_refused(refused, "albireo cert authority --folder");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn an_authority_whose_list_is_lost_issues_nothing() {
    let (folder, mut authority) = authority();
    issue(&mut authority, Role::Node, "car-7").unwrap();
    authority.revoke(Role::Node, "car-7").unwrap();
    drop(authority);
    // With an empty list car-7 would get the name of the revoked certificate again.
    std::fs::remove_file(folder.path().join("list.json")).unwrap();
    assert_refused(Authority::open(folder.path()), "list.json");
}

#[test]
fn a_key_without_a_certificate_is_named_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let key = folder.path().join(AUTHORITY_KEY);
    std::fs::write(&key, "a key").unwrap();
    let refused = Authority::create(folder.path(), "fleet north", YEAR);
    assert_refused(refused, "authority.key exists already");
    assert_eq!(std::fs::read_to_string(&key).unwrap(), "a key");
}
