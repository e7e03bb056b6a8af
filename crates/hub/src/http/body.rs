//! Reads the bodies of tuning requests, in which users write a threshold as a field under its own name.

use albireo_service::http::Problem;
use albireo_wire::Threshold;
use axum::http::StatusCode;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Reads the JSON object in a body.
pub(super) fn object(body: &[u8]) -> Result<Map<String, Value>, Problem> {
    let value: Value = serde_json::from_slice(body).map_err(|error| {
        let detail = format!("the body is not JSON: {error}");
        Problem::new(StatusCode::BAD_REQUEST, detail)
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

/// Splits an object into the request and the fields that are not part of it. Requests flatten other types, so `serde`
/// cannot reject unknown fields itself.
fn read<T>(object: Map<String, Value>) -> Result<(T, Map<String, Value>), Problem>
where
    T: DeserializeOwned + Serialize + Default,
{
    let known = serde_json::to_value(T::default()).unwrap_or_default();
    let (own, others): (Map<_, _>, Map<_, _>) =
        object.into_iter().partition(|(name, _)| known.get(name).is_some());
    let request =
        serde_json::from_value(Value::Object(own)).map_err(|error| unusable(error.to_string()))?;
    Ok((request, others))
}

/// Reads the threshold that is the only field: `"u": 5e-4`.
fn threshold(fields: &Map<String, Value>) -> Result<Threshold, Problem> {
    let mut fields = fields.iter();
    let Some((name, value)) = fields.next() else {
        return Err(unusable("there must be a threshold, such as \"u\": 5e-4"));
    };
    if let Some((other, _)) = fields.next() {
        return Err(unusable(format!(
            "`{name}` and `{other}`: there must be one threshold and no other unknown field"
        )));
    }
    match value.as_f64() {
        Some(value) => Ok(Threshold::new(name, value)),
        None => Err(unusable(format!("`{name}` must be a number"))),
    }
}

/// Reads a request that has a threshold beside its own fields: `"u": 5e-4`.
pub(super) fn with_threshold<T>(object: Map<String, Value>) -> Result<(Threshold, T), Problem>
where
    T: DeserializeOwned + Serialize + Default,
{
    let (request, others) = read(object)?;
    Ok((threshold(&others)?, request))
}

/// Converts a threshold from the form that users write, `{"u": 3e-4}`, to the form in messages.
pub(super) fn name_threshold(written: &mut Value) -> Result<(), Problem> {
    let fields = written
        .as_object()
        .ok_or_else(|| unusable(r#"values: each must be such as {"u": 3e-4}"#))?;
    *written = serde_json::json!(threshold(fields)?);
    Ok(())
}

/// Reads a request and rejects unknown fields.
pub(super) fn known_fields<T>(object: Map<String, Value>) -> Result<T, Problem>
where
    T: DeserializeOwned + Serialize + Default,
{
    let (request, others) = read(object)?;
    match others.keys().next() {
        None => Ok(request),
        Some(name) => Err(unusable(format!("unknown field `{name}`"))),
    }
}

/// Cuts rows, of which one more than `limit` was asked for, to a page. Returns the cursor of the next page if there is one.
pub(super) fn cut_page<T>(rows: &mut Vec<T>, limit: i64, id: impl Fn(&T) -> i64) -> Option<i64> {
    let has_next = rows.len() as i64 > limit;
    rows.truncate(usize::try_from(limit).unwrap_or(usize::MAX));
    match rows.last() {
        Some(last) if has_next => Some(id(last)),
        _ => None,
    }
}

/// The problem document of an invalid request.
pub(super) fn unusable(detail: impl Into<String>) -> Problem {
    Problem::new(StatusCode::UNPROCESSABLE_ENTITY, detail)
}
