//! Asks a camera that gives no pictures which logins it takes, or what it sends instead: ffmpeg does not say it.

use super::address::after_login;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// The time for the whole question.
const ANSWER: Duration = Duration::from_secs(3);
/// The most bytes of an answer.
const MAX_HEAD: usize = 16 << 10;
/// The most characters of an answer that are shown.
const MOST_SHOWN: usize = 60;
/// What ffmpeg knows (`http_auth.c`); a digest without an algorithm is by MD5.
const KNOWN: [&str; 2] = ["MD5", "MD5-sess"];

/// The algorithm of the digest that the camera at `address` asks for, if ffmpeg does not know it. Asks without a login, which
/// counts as no wrong one.
pub(super) fn unknown_digest(address: &str) -> Option<String> {
    unknown(&head(address).ok()?)
}

/// What `address` answers, in words, if that is neither pictures nor a refusal, or what the address answers to which it
/// sends: ffmpeg follows it. Asks without a login.
pub(super) fn answer_without_pictures(address: &str) -> Option<String> {
    let first = head(address).ok()?;
    let Some(sent) = sent_elsewhere(&first) else {
        return without_pictures(&first);
    };
    let lead = format!("it answers {sent}: it sends to another address");
    let Some(next) = target(address, &first) else {
        return Some(format!("{lead} and does not say to which"));
    };
    // No answer to this question, as where the other address has TLS, is no fault.
    let second = head(&next).ok()?;
    if sent_elsewhere(&second).is_some() {
        let last = target(&next, &second)?;
        let leads_back = is_same(address, &last) || is_same(&next, &last);
        return leads_back.then(|| format!("{lead}, which sends back"));
    }
    let answer = without_pictures(&second)?;
    Some(format!("{lead}, and there {answer}"))
}

/// The status of an answer that sends to another address.
fn sent_elsewhere(head: &str) -> Option<String> {
    let (code, shown) = status(head)?;
    (300..400).contains(&code).then_some(shown)
}

/// The number of an answer's status, and the status as it can be shown.
fn status(head: &str) -> Option<(u16, String)> {
    let (_, status) = head.lines().next()?.split_once(' ')?;
    let code = status.get(..3)?.parse().ok()?;
    let shown: String = status.chars().filter(|c| !c.is_control()).take(MOST_SHOWN).collect();
    Some((code, shown.trim_end().to_owned()))
}

/// The address to which the answer of `address` sends.
fn target(address: &str, head: &str) -> Option<String> {
    let location = values(head, "Location").next()?;
    let location = location.split('#').next().unwrap_or_default();
    let is_safe = |c: char| !c.is_control() && !c.is_whitespace();
    if location.is_empty() || !location.chars().all(is_safe) {
        return None;
    }
    if location.contains("://") {
        return Some(location.to_owned());
    }
    let (scheme, _) = address.split_once("://")?;
    if location.starts_with("//") {
        return Some(format!("{scheme}:{location}"));
    }
    let place = after_login(address);
    let (authority, path_and_query) = place.split_at(place.find(['/', '?']).unwrap_or(place.len()));
    if location.starts_with('/') {
        return Some(format!("{scheme}://{authority}{location}"));
    }
    let path = path_and_query.split('?').next().unwrap_or_default();
    if location.starts_with('?') {
        return Some(format!("{scheme}://{authority}{path}{location}"));
    }
    let folder = path.rsplit_once('/').map_or("", |(folder, _)| folder);
    Some(format!("{scheme}://{authority}{folder}/{location}"))
}

/// True if two addresses differ in nothing but a login.
fn is_same(one: &str, other: &str) -> bool {
    after_login(one) == after_login(other)
}

/// What the head of an answer says, if no pictures follow it.
fn without_pictures(head: &str) -> Option<String> {
    let (code, shown) = status(head)?;
    match code {
        200 => {}
        201..300 => return Some(format!("it answers {shown}: no picture")),
        // With the login it may answer otherwise.
        _ => return None,
    }
    let content = values(head, "Content-Type").next()?;
    let kind = content.split(';').next()?.trim().to_ascii_lowercase();
    if kind.len() > MOST_SHOWN || !kind.chars().all(|c| c.is_ascii_graphic()) {
        return None;
    }
    if ["text/html", "application/xhtml+xml"].contains(&kind.as_str()) {
        return Some(format!(
            "it answers {kind}: a web page, not the camera's stream"
        ));
    }
    let is_text = kind.starts_with("text/")
        || ["application/json", "application/xml"].contains(&kind.as_str());
    if is_text {
        return Some(format!("it answers {kind}: no pictures"));
    }
    None
}

/// The values of a header in the head of an answer.
fn values<'a>(head: &'a str, name: &'a str) -> impl DoubleEndedIterator<Item = &'a str> {
    head.lines().filter_map(move |line| {
        let (found, value) = line.split_once(':')?;
        found.trim().eq_ignore_ascii_case(name).then_some(value.trim())
    })
}

/// The head of the answer to a request without a login.
fn head(address: &str) -> io::Result<String> {
    let invalid = || io::Error::from(ErrorKind::InvalidInput);
    let (scheme, _) = address.split_once("://").ok_or_else(invalid)?;
    let place = after_login(address);
    let (authority, path) = place.split_at(place.find(['/', '?']).unwrap_or(place.len()));
    let (usual_port, request) = match scheme.to_ascii_lowercase().as_str() {
        "rtsp" => {
            let request = format!(
                "DESCRIBE rtsp://{place} RTSP/1.0\r\nCSeq: 1\r\nAccept: application/sdp\r\n\r\n"
            );
            (554, request)
        }
        "http" => {
            let root = if path.starts_with('/') { "" } else { "/" };
            let request = format!(
                "GET {root}{path} HTTP/1.1\r\nHost: {authority}\r\nConnection: close\r\n\r\n"
            );
            (80, request)
        }
        _ => return Err(invalid()),
    };
    let host_and_port = match authority.rsplit_once(':') {
        Some((_, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => authority.to_owned(),
        _ => format!("{authority}:{usual_port}"),
    };
    let until = Instant::now() + ANSWER;
    let host = host_and_port.to_socket_addrs()?.next().ok_or_else(invalid)?;
    let mut camera = TcpStream::connect_timeout(&host, ANSWER)?;
    camera.set_write_timeout(Some(ANSWER))?;
    camera.write_all(request.as_bytes())?;
    let mut head = Vec::new();
    let mut part = [0; 1024];
    while head.len() < MAX_HEAD && !head.windows(4).any(|end| end == b"\r\n\r\n") {
        let left = until.saturating_duration_since(Instant::now());
        camera.set_read_timeout(Some(left.max(Duration::from_millis(1))))?;
        match camera.read(&mut part)? {
            0 => break,
            length => head.extend_from_slice(&part[..length]),
        }
        if left.is_zero() {
            break;
        }
    }
    Ok(String::from_utf8_lossy(&head).into_owned())
}

/// The algorithm that ffmpeg does not know. Of several offers it takes the last digest, and a digest before a basic login.
fn unknown(head: &str) -> Option<String> {
    let mut digest = values(head, "WWW-Authenticate").filter_map(|offer| {
        let (kind, rest) = offer.split_once(' ')?;
        kind.eq_ignore_ascii_case("Digest").then_some(rest)
    });
    let algorithm = digest.next_back()?.split(',').find_map(|parameter| {
        let (name, value) = parameter.split_once('=')?;
        name.trim()
            .eq_ignore_ascii_case("algorithm")
            .then(|| value.trim().trim_matches('"'))
    })?;
    let is_plain = |c: &char| c.is_ascii_alphanumeric() || *c == '-';
    let algorithm: String = algorithm.chars().filter(is_plain).take(20).collect();
    if KNOWN.contains(&algorithm.as_str()) {
        return None;
    }
    Some(algorithm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn the_last_digest_counts_because_ffmpeg_takes_it() {
        let md5 = "WWW-Authenticate: Digest realm=\"c\", nonce=\"1\", algorithm=MD5\r\n";
        let sha = "www-authenticate: Digest realm=\"c\", algorithm=\"SHA-256\", nonce=\"1\"\r\n";
        let basic = "WWW-Authenticate: Basic realm=\"c\"\r\n";
        let old = "WWW-Authenticate: Digest realm=\"c\", nonce=\"1\"\r\n";
        for (offers, found) in [
            (sha.to_owned(), Some("SHA-256")),
            (format!("{md5}{sha}"), Some("SHA-256")),
            (format!("{sha}{basic}"), Some("SHA-256")),
            (format!("{sha}{md5}"), None),
            (md5.to_owned(), None),
            (old.to_owned(), None),
            (basic.to_owned(), None),
            (String::new(), None),
        ] {
            let head = format!("RTSP/1.0 401 Unauthorized\r\nCSeq: 1\r\n{offers}\r\n");
            assert_eq!(unknown(&head).as_deref(), found, "{offers}");
        }
    }

    #[test]
    fn an_answer_that_is_no_camera_is_told_by_its_status_or_its_kind() {
        let page = Some("it answers text/html: a web page, not the camera's stream");
        for (status, kind, said) in [
            ("200 OK", "text/html; charset=utf-8", page),
            ("200", "Text/HTML", page),
            (
                "200 OK",
                "application/json",
                Some("it answers application/json: no pictures"),
            ),
            (
                "204 No Content",
                "",
                Some("it answers 204 No Content: no picture"),
            ),
            ("200 OK", "image/jpeg", None),
            ("200 OK", "multipart/x-mixed-replace; boundary=b", None),
            ("200 OK", "application/vnd.apple.mpegurl", None),
            ("401 Unauthorized", "text/html", None),
            ("503 Service Unavailable", "text/html", None),
        ] {
            let head = format!("HTTP/1.1 {status}\r\ncontent-type: {kind}\r\n\r\n");
            assert_eq!(without_pictures(&head).as_deref(), said, "{status} {kind}");
        }
        assert_eq!(without_pictures("nonsense"), None);
    }

    /// A server that answers each path by `answer`, and its address.
    fn serve(answer: fn(&str) -> String) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            for client in listener.incoming() {
                let mut client = client.unwrap();
                let mut question = [0; 1024];
                let length = client.read(&mut question).unwrap();
                let question = String::from_utf8_lossy(&question[..length]);
                let path = question.split(' ').nth(1).unwrap_or_default();
                client.write_all(answer(path).as_bytes()).unwrap();
            }
        });
        address
    }

    #[test]
    fn an_address_that_sends_elsewhere_is_judged_by_what_is_there() {
        let server = serve(|path| {
            let of_kind = |kind| format!("HTTP/1.1 200 OK\r\nContent-Type: {kind}\r\n\r\n");
            let to = |location| format!("HTTP/1.1 302 Found\r\nLocation: {location}\r\n\r\n");
            match path {
                "/page" => of_kind("text/html"),
                "/stream" => of_kind("multipart/x-mixed-replace"),
                "/cameras/to-page" => to("/page"),
                "/cameras/to-stream" => to("/stream"),
                "/to-tls" => to("https://127.0.0.1:1/stream"),
                "/to-itself" => to("/to-itself?"),
                "/to-itself?" => to("to-itself?"),
                "/there" => to("/back"),
                "/back" => to("/there"),
                "/far" => to("/cameras/to-page"),
                _ => "HTTP/1.1 302 Found\r\n\r\n".to_owned(),
            }
        });
        let lead = "it answers 302 Found: it sends to another address";
        for (path, said) in [
            (
                "/cameras/to-page",
                Some(", and there it answers text/html: a web page, not the camera's stream"),
            ),
            ("/cameras/to-stream", None),
            ("/to-tls", None),
            ("/to-itself", Some(", which sends back")),
            ("/there", Some(", which sends back")),
            ("/far", None),
            ("/nowhere", Some(" and does not say to which")),
        ] {
            let expected = said.map(|said| format!("{lead}{said}"));
            let asked = server.replace("://", "://ann:s3cret@") + path;
            assert_eq!(answer_without_pictures(&asked), expected, "{path}");
        }
        let found = target(
            "http://a:b@h:1/x/y?z",
            "HTTP/1.1 302 F\r\nLocation: w?v#u\r\n",
        );
        assert_eq!(found.as_deref(), Some("http://h:1/x/w?v"));
    }
}
