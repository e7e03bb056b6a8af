//! Reads the bodies of tuning requests: a threshold as users write it beside other fields.

use albireo_service::http::{BODY_LIMIT, Problem};
use albireo_wire::Threshold;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::http::StatusCode;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// The object in a body.
pub(super) fn object(body: Result<Bytes, BytesRejection>) -> Result<Map<String, Value>, Problem> {
    let body = body.map_err(|rejection| match rejection.status() {
        StatusCode::PAYLOAD_TOO_LARGE => {
            let detail =
                format!("the body must have at most {BODY_LIMIT} bytes; select by glob or label");
            Problem::new(StatusCode::PAYLOAD_TOO_LARGE, detail)
        }
        status => Problem::new(status, rejection.body_text()),
    })?;
    let value: Value = serde_json::from_slice(&body).map_err(|error| {
        Problem::new(
            StatusCode::BAD_REQUEST,
            format!("the body is not JSON: {error}"),
        )
    })?;
    let Value::Object(mut object) = value else {
        return Err(unusable("the body must be a JSON object"));
    };
    // `"cam-*,region=north"` for `["cam-*", "region=north"]`.
    if let Some(Value::String(text)) = object.get("select") {
        let terms: Vec<Value> = text.split(',').map(|term| term.trim().into()).collect();
        object.insert("select".to_owned(), terms.into());
    }
    Ok(object)
}

/// A request with a threshold as users write it beside its own fields: `"u": 5e-4`.
#[derive(Deserialize)]
struct WithThreshold<T> {
    #[serde(flatten)]
    request: T,
    #[serde(flatten)]
    others: Map<String, Value>,
}

/// Reads a request that has a threshold beside its own fields.
pub(super) fn with_threshold<T: DeserializeOwned>(
    object: Map<String, Value>,
) -> Result<(Threshold, T), Problem> {
    let WithThreshold { request, others } = rest(object)?;
    let mut others = others.into_iter();
    match (others.next(), others.next()) {
        (Some((name, value)), None) => match value.as_f64().filter(|value| value.is_finite()) {
            Some(value) => Ok((Threshold::new(&name, value), request)),
            None => Err(unusable(format!("`{name}` must be a finite number"))),
        },
        (None, _) => Err(unusable(
            "the body must have a threshold, such as \"u\": 5e-4",
        )),
        (Some((one, _)), Some((other, _))) => Err(unusable(format!(
            "`{one}` and `{other}`: there must be one threshold and nothing else that is not known here"
        ))),
    }
}

/// Replaces a threshold as users write it, `{"u": 3e-4}`, by its message.
pub(super) fn name_threshold(written: &mut Value) -> Result<(), Problem> {
    let fault = || unusable(r#"values: each must be one threshold, such as {"u": 3e-4}"#);
    let fields = written.as_object().filter(|fields| fields.len() == 1);
    let (name, value) = (fields.and_then(|fields| fields.iter().next())).ok_or_else(fault)?;
    let value = value.as_f64().ok_or_else(fault)?;
    *written = serde_json::json!({ "name": name, "value": value });
    Ok(())
}

/// Reads what is left of an object.
pub(super) fn rest<T: DeserializeOwned>(object: Map<String, Value>) -> Result<T, Problem> {
    serde_json::from_value(Value::Object(object)).map_err(|error| unusable(error.to_string()))
}

pub(super) fn unusable(detail: impl Into<String>) -> Problem {
    Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail)
}
