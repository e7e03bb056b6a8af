//! Refuses a query of a request that changes something on a route that reads none.

use super::Problem;
use axum::Router;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use utoipa::openapi::path::{Operation, ParameterIn, PathItem};
use utoipa::openapi::{OpenApi, RefOr};

/// The beginning of the routes of an interface, and of those of one camera.
const OF_ALL: &str = "/api/v1/";
const OF_ONE_CAMERA: &str = "/api/v1/cameras/{camera}/";

/// Refuses the query of a request that changes something wherever `document` names no parameter of one: it would be ignored,
/// and the request would do something else than was meant, such as set the threshold of all cameras instead of one's.
/// Requests that only read keep it: health checks add one (`/readyz?verbose`), and pages one against a cache. Routes with
/// parameters refuse unknown ones themselves.
pub fn refuse_unread_queries<S>(router: Router<S>, document: OpenApi) -> Router<S>
where
    S: Clone + Send + Sync + 'static,
{
    router.layer(from_fn_with_state(Arc::new(document), refuse))
}

async fn refuse(State(document): State<Arc<OpenApi>>, request: Request, next: Next) -> Response {
    let is_asked = request.uri().query().is_some_and(|query| !query.is_empty());
    if is_asked
        && let Some(matched) = request.extensions().get::<MatchedPath>()
        && let Some(wrong) = unread(&document, matched.as_str(), request.method())
    {
        return Problem::new(StatusCode::BAD_REQUEST, wrong).into_response();
    }
    next.run(request).await
}

/// What is wrong with any query for this path, and what to do instead; `None` if the route reads one, changes nothing, or is
/// none.
fn unread(document: &OpenApi, path: &str, method: &Method) -> Option<String> {
    let operation = operation(document.paths.paths.get(path)?, method)?;
    if reads_query(operation) {
        return None;
    }
    let mut words = format!("{method} {path} takes no query");
    if operation.request_body.is_some() {
        words.push_str("; what it sets is in the body");
    }
    if let Some(rest) = path.strip_prefix(OF_ALL) {
        let of_one = format!("{OF_ONE_CAMERA}{rest}");
        if document.paths.paths.contains_key(&of_one) {
            words.push_str(&format!("; for one camera there is {of_one}"));
        }
    }
    Some(words)
}

/// The operation of a path that this method asks for, if it changes something.
fn operation<'a>(item: &'a PathItem, method: &Method) -> Option<&'a Operation> {
    match *method {
        Method::PUT => item.put.as_ref(),
        Method::POST => item.post.as_ref(),
        Method::DELETE => item.delete.as_ref(),
        Method::PATCH => item.patch.as_ref(),
        _ => None,
    }
}

fn reads_query(operation: &Operation) -> bool {
    let parameters = operation.parameters.as_deref().unwrap_or_default();
    parameters.iter().any(|parameter| match parameter {
        RefOr::T(parameter) => parameter.parameter_in == ParameterIn::Query,
        // What is described elsewhere may be of a query.
        RefOr::Ref(_) => true,
    })
}
