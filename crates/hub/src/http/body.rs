//! Reads the bodies of tuning requests: a knob's value under its own name beside other fields.

use albireo_service::http::{BODY_LIMIT, Problem};
use albireo_wire::KnobValue;
use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::http::StatusCode;
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

/// Takes the knob's value out of an object.
pub(super) fn knob(object: &mut Map<String, Value>) -> Result<KnobValue, Problem> {
    let knob: KnobValue =
        serde_json::from_value(Value::Object(object.clone())).map_err(|error| {
            unusable(format!(
                "the body must have the value of one knob, such as \"u\": 5e-4: {error}"
            ))
        })?;
    object.remove(knob.name);
    if !knob.value.is_finite() {
        return Err(unusable(format!("`{}` must be a finite number", knob.name)));
    }
    Ok(knob)
}

/// Reads what is left of an object.
pub(super) fn rest<T: DeserializeOwned>(object: Map<String, Value>) -> Result<T, Problem> {
    serde_json::from_value(Value::Object(object)).map_err(|error| unusable(error.to_string()))
}

pub(super) fn unusable(detail: impl Into<String>) -> Problem {
    Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail)
}
