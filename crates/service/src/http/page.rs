//! Serves the web pages with all their files: built from `web/` and embedded in a release. A debug build reads them
//! from `web/dist` of its checkout each time, so work on a page needs no compiler.

use super::Problem;
use axum::Router;
use axum::extract::Path;
use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE,
    REFERRER_POLICY, VARY,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use rust_embed::Embed;

/// The path of a page's files; open to all, like the page itself: they are the same wherever this version runs.
pub(super) const ASSETS: &str = "/assets/";

/// Allows only the page's own files, and calls to the service it came from. No page builds markup or script from text,
/// which Trusted Types enforce in browsers that support them.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; \
                      require-trusted-types-for 'script'; trusted-types 'none'";

/// Shown if the page was not built.
const MISSING: &str = "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n\
    <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>albireo: no page</title>\n\
    <h1>This program was built without its pages</h1>\n\
    <p>They are built from the folder <code>web</code>, which needs Node.js 20.19 or later with npm \
    (Debian: <code>apt-get install nodejs npm</code>; others: nodejs.org). Then:</p>\n\
    <pre>make web\ncargo build</pre>\n\
    <p>Everything else works: <a href=\"/openapi.json\">/openapi.json</a> describes the interface, \
    <a href=\"/readyz\">/readyz</a> reports the state of the service.</p>\n</html>\n";

#[derive(Embed)]
#[folder = "../../web/dist"]
struct Built;

/// Adds the page `name` at `/`, `node.html` or `hub.html`, and the files it loads.
pub fn with_page<S>(router: Router<S>, name: &'static str) -> Router<S>
where
    S: Clone + Send + Sync + 'static,
{
    let page = move |headers: HeaderMap| async move { answer(name, &headers) };
    router.route("/", get(page)).route("/assets/{file}", get(asset))
}

fn answer(name: &str, headers: &HeaderMap) -> Response {
    let page = file(name, headers, "no-cache")
        .unwrap_or_else(|| ([(CONTENT_TYPE, "text/html; charset=utf-8")], MISSING).into_response());
    let policy = [
        (CONTENT_SECURITY_POLICY, POLICY),
        (REFERRER_POLICY, "no-referrer"),
    ];
    (policy, page).into_response()
}

/// A file of a page. Its name changes with its contents, so a cached copy never expires.
async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    let name = format!("assets/{name}");
    file(&name, &headers, "public, max-age=31536000, immutable").ok_or_else(|| {
        let detail = "this version has no such page file; reload the page";
        Problem::new(StatusCode::NOT_FOUND, detail)
    })
}

/// Returns an embedded file, gzip-compressed at build time if the client accepts that; `None` if it does not exist.
fn file(name: &str, headers: &HeaderMap, caching: &'static str) -> Option<Response> {
    let common = [
        (CONTENT_TYPE, media_type(name)?),
        (CACHE_CONTROL, caching),
        (VARY, "accept-encoding"),
    ];
    if takes_gzip(headers)
        && let Some(packed) = Built::get(&format!("{name}.gz"))
    {
        return Some((common, [(CONTENT_ENCODING, "gzip")], packed.data).into_response());
    }
    Some((common, Built::get(name)?.data).into_response())
}

/// The media types of page files; no other file is served.
fn media_type(name: &str) -> Option<&'static str> {
    match name.rsplit_once('.')?.1 {
        "html" => Some("text/html; charset=utf-8"),
        "js" => Some("text/javascript; charset=utf-8"),
        "css" => Some("text/css; charset=utf-8"),
        "svg" => Some("image/svg+xml"),
        _ => None,
    }
}

/// True if `Accept-Encoding` accepts gzip.
fn takes_gzip(headers: &HeaderMap) -> bool {
    headers
        .get_all(ACCEPT_ENCODING)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(accepts_gzip)
}

/// True for `gzip` and `gzip;q=0.5`, but not for `gzip;q=0`, which refuses it.
fn accepts_gzip(coding: &str) -> bool {
    let (name, parameter) = coding.split_once(';').unwrap_or((coding, ""));
    let parameter = parameter.trim().to_ascii_lowercase();
    let weight = parameter.strip_prefix("q=");
    let is_refused = weight.is_some_and(|weight| weight.parse() == Ok(0.0_f32));
    name.trim().eq_ignore_ascii_case("gzip") && !is_refused
}

#[cfg(test)]
mod tests;
