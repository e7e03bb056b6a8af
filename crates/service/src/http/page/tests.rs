use super::*;
use axum::http::{HeaderName, HeaderValue};

fn asking(name: HeaderName, value: &'static str) -> HeaderMap {
    HeaderMap::from_iter([(name, HeaderValue::from_static(value))])
}

#[test]
fn gzip_needs_an_accept_encoding_that_allows_it() {
    for (value, takes) in [
        ("gzip", true),
        ("br, GZIP;q=0.5", true),
        ("gzip;q=0", false),
        ("gzip;Q=0", false),
        ("gzip; q=0.000, br", false),
        ("br, zstd", false),
        ("xgzip", false),
    ] {
        let headers = asking(ACCEPT_ENCODING, value);
        assert_eq!(takes_gzip(&headers), takes, "{value}");
    }
    assert!(!takes_gzip(&HeaderMap::new()));
}

#[test]
fn each_page_has_a_strict_content_security_policy() {
    for page in ["node.html", "hub.html"] {
        let response = answer(page, &HeaderMap::new());
        assert_eq!(response.status(), StatusCode::OK);
        let policy = &response.headers()[CONTENT_SECURITY_POLICY];
        let policy = policy.to_str().unwrap();
        assert!(policy.contains("default-src 'none'"));
        assert!(!policy.contains("unsafe"), "{policy}");
        assert_eq!(response.headers()[CONTENT_TYPE], "text/html; charset=utf-8");
    }
}

#[test]
fn files_that_are_not_page_assets_are_not_served() {
    for name in [".gitignore", "node.html.gz", "../Cargo.toml", "assets/", ""] {
        let served = file(name, &HeaderMap::new(), "no-cache");
        assert!(served.is_none(), "{name}");
    }
}

/// Checks the files of the embedded build; passes if there is none.
#[test]
fn assets_are_compressed_if_the_client_accepts_gzip() {
    for name in Built::iter().filter(|name| media_type(name).is_some()) {
        let plain = file(&name, &HeaderMap::new(), "no-cache").unwrap();
        let packed = file(&name, &asking(ACCEPT_ENCODING, "gzip"), "no-cache").unwrap();
        assert!(!plain.headers().contains_key(CONTENT_ENCODING), "{name}");
        assert_eq!(packed.headers()[CONTENT_ENCODING], "gzip", "{name}");
    }
}
