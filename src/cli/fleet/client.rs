//! Talks to a hub or a node over HTTP.

use anyhow::{Context, anyhow, bail};
use reqwest::header::ACCEPT;
use reqwest::{Method, RequestBuilder, Response, Url};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::time::Duration;

/// Time limit of a plain answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(30);

/// Time limit of the question what is at the address, after an error.
const DESCRIBED_WITHIN: Duration = Duration::from_secs(2);

/// A hub, or a node.
pub(in crate::cli) struct Client {
    base: Url,
    /// What to do if it cannot be reached.
    remedy: &'static str,
    token: Option<String>,
    http: reqwest::Client,
}

impl Client {
    /// Talks to the service at `hub`; `remedy` is what to do if nothing answers there.
    pub(in crate::cli) fn new(
        hub: &str,
        token: Option<String>,
        remedy: &'static str,
    ) -> anyhow::Result<Self> {
        // `localhost:8090` would be an address with the scheme `localhost`.
        let is_http = |address: &Url| matches!(address.scheme(), "http" | "https");
        let base = Url::parse(hub)
            .ok()
            .filter(is_http)
            .with_context(|| format!("`{hub}` is not an address such as http://127.0.0.1:8090"))?;
        if base.scheme() == "https" {
            bail!(
                "`{hub}`: hubs and nodes serve HTTP without TLS, and so does this command: write http://, with \
                 `ssh -L 8090:127.0.0.1:8090 HOST` where others can listen"
            );
        }
        // A file with a token may end with a line break, also with that of Windows.
        let token = token.map(|token| token.trim().to_owned()).filter(|token| !token.is_empty());
        let is_graphic = |token: &str| token.bytes().all(|byte| byte.is_ascii_graphic());
        if token.as_deref().is_some_and(|token| !is_graphic(token)) {
            bail!("the token cannot be right: a token is printable ASCII without spaces");
        }
        let http = reqwest::Client::builder()
            .connect_timeout(Duration::from_secs(5))
            // An answer must come from the hub itself, so redirects are not followed.
            .redirect(reqwest::redirect::Policy::none())
            .build()?;
        Ok(Self {
            base,
            remedy,
            token,
            http,
        })
    }

    /// The error of a command to a hub; if the address is a node's, that is the error.
    pub(super) async fn explained(&self, error: anyhow::Error) -> anyhow::Error {
        if self.is_node().await {
            let base = &self.base;
            return anyhow!("{base} is a node, not a hub: name a hub by --hub or ALBIREO_HUB");
        }
        error
    }

    /// True if a node describes itself at the address, which needs no token.
    async fn is_node(&self) -> bool {
        let Ok(request) = self.request(Method::GET, "/openapi.json", &[]) else {
            return false;
        };
        let Ok(response) = request.timeout(DESCRIBED_WITHIN).send().await else {
            return false;
        };
        let described: Value = response.json().await.unwrap_or_default();
        described["info"]["title"] == "albireo node"
    }

    fn request(
        &self,
        method: Method,
        path: &str,
        query: &[(&str, String)],
    ) -> anyhow::Result<RequestBuilder> {
        let mut url = self.base.join(path)?;
        if !query.is_empty() {
            url.query_pairs_mut().extend_pairs(query);
        }
        let request = self.http.request(method, url);
        match &self.token {
            Some(token) => Ok(request.bearer_auth(token)),
            None => Ok(request),
        }
    }

    async fn send(&self, request: RequestBuilder) -> anyhow::Result<Response> {
        let base = &self.base;
        let response = match request.send().await {
            Ok(response) => response,
            Err(error) if error.is_connect() => bail!("{base} cannot be reached: {}", self.remedy),
            Err(error) => bail!("{base} gave no answer: {}", error.without_url()),
        };
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let problem: Value = response.json().await.unwrap_or_default();
        match problem["detail"].as_str() {
            Some(detail) => bail!("{detail}"),
            None => bail!("{base} answers {status}; is it a hub or a node?"),
        }
    }

    async fn json<T: DeserializeOwned>(&self, request: RequestBuilder) -> anyhow::Result<T> {
        let response = self.send(request.timeout(ANSWER_WITHIN)).await?;
        let text = response.text().await?;
        let base = &self.base;
        serde_json::from_str(&text)
            .with_context(|| format!("{base} does not answer as a hub of this version does"))
    }

    /// Sends a GET request.
    pub(super) async fn get<T: DeserializeOwned>(
        &self,
        path: &str,
        query: &[(&str, String)],
    ) -> anyhow::Result<T> {
        self.json(self.request(Method::GET, path, query)?).await
    }

    /// Sends a request with a JSON body.
    pub(super) async fn post<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
    ) -> anyhow::Result<T> {
        let request = self.request(Method::POST, path, &[])?;
        self.json(request.json(body)).await
    }

    /// Sends a request without a body; the answer need not be JSON.
    pub(in crate::cli) async fn plain(
        &self,
        method: Method,
        path: &str,
    ) -> anyhow::Result<Response> {
        let request = self.request(method, path, &[])?;
        self.send(request.timeout(ANSWER_WITHIN)).await
    }

    /// Sends `body` by PUT and passes each line of the answer to `take` as it arrives.
    pub(super) async fn put_lines<T: DeserializeOwned>(
        &self,
        path: &str,
        body: &impl Serialize,
        mut take: impl FnMut(T) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let request = self
            .request(Method::PUT, path, &[])?
            .header(ACCEPT, "application/x-ndjson")
            .json(body);
        let mut answer = self.send(request).await?;
        let mut take_line = |line: &[u8]| {
            let value =
                serde_json::from_slice(line).context("a line of the answer cannot be read")?;
            take(value)
        };
        let mut unread = Vec::new();
        while let Some(bytes) = answer.chunk().await.context("the connection to the hub broke")? {
            unread.extend_from_slice(&bytes);
            while let Some(end) = unread.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = unread.drain(..=end).collect();
                take_line(&line)?;
            }
        }
        // A proxy may have taken the end of the last line.
        if !unread.trim_ascii().is_empty() {
            take_line(&unread)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_without_http_is_refused_with_an_example() {
        for address in [
            "localhost:8090",
            "car-7:8080",
            "127.0.0.1:8090",
            "ftp://hub",
            "",
        ] {
            let refused = Client::new(address, None, "").err().unwrap().to_string();
            let expected = format!("`{address}` is not an address such as http://127.0.0.1:8090");
            assert_eq!(refused, expected);
        }
        for address in ["http://localhost:8090", "http://hub.example/fleet/"] {
            assert!(Client::new(address, None, "").is_ok(), "{address}");
        }
    }

    #[test]
    fn an_address_with_tls_is_refused_with_what_to_write() {
        let refused = Client::new("https://hub.example", None, "").err().unwrap().to_string();
        assert!(refused.contains("write http://"), "{refused}");
    }

    #[test]
    fn a_token_is_used_without_its_line_break_and_one_that_cannot_be_right_is_refused() {
        let with_token = |token: &str| Client::new("http://hub", Some(token.to_owned()), "");
        let token = with_token("0123456789abcdef\r\n").unwrap().token;
        assert_eq!(token.as_deref(), Some("0123456789abcdef"));
        assert_eq!(with_token(" \r\n").unwrap().token, None);
        for wrong in ["two words", "a\rb", "schl\u{fc}ssel"] {
            let refused = with_token(wrong).err().unwrap().to_string();
            assert!(refused.contains("printable ASCII"), "{refused}");
            assert!(!refused.contains(wrong), "{refused}");
        }
    }

    #[tokio::test]
    async fn a_node_at_the_address_of_the_hub_is_called_a_node() {
        use std::io::{Read, Write};
        for (title, is_node) in [("albireo node", true), ("albireo hub", false)] {
            let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
            let address = format!("http://{}", listener.local_addr().unwrap());
            let serving = std::thread::spawn(move || {
                let (mut stream, _) = listener.accept().unwrap();
                let _ = stream.read(&mut [0; 4096]).unwrap();
                let body = format!("{{\"info\": {{\"title\": \"{title}\"}}}}");
                let length = body.len();
                write!(
                    stream,
                    "HTTP/1.1 200 OK\r\nContent-Length: {length}\r\n\r\n{body}"
                )
                .unwrap();
            });
            let client = Client::new(&address, None, "").unwrap();
            let said = client.explained(anyhow!("404")).await.to_string();
            assert_eq!(said.contains("is a node, not a hub"), is_node, "{said}");
            serving.join().unwrap();
        }
    }
}
