//! Bodies of requests and answers: JSON that is exactly what was agreed on, failures as sentences.

use super::control::Denied;
use super::order::OrderError;
use axum::body::Bytes;
use axum::extract::{FromRequest, Request};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use serde::de::DeserializeOwned;
use serde_json::json;

/// A request that was not carried out, and why.
#[derive(Debug)]
pub struct Failure {
    status: StatusCode,
    text: String,
}

impl Failure {
    /// A status and a sentence.
    pub fn new(status: StatusCode, text: impl ToString) -> Self {
        Self { status, text: text.to_string() }
    }

    /// A value that makes no sense.
    pub fn value(text: impl ToString) -> Self {
        Self::new(StatusCode::UNPROCESSABLE_ENTITY, text)
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        (self.status, axum::Json(json!({ "error": self.text }))).into_response()
    }
}

impl From<Denied> for Failure {
    fn from(denied: Denied) -> Self {
        Self::new(StatusCode::CONFLICT, denied)
    }
}

impl From<OrderError> for Failure {
    fn from(error: OrderError) -> Self {
        let status = match error {
            OrderError::Busy(_) => StatusCode::CONFLICT,
            OrderError::Stale | OrderError::Ending => StatusCode::SERVICE_UNAVAILABLE,
            OrderError::Stage(_) | OrderError::Place(_) | OrderError::Unsafe(_) | OrderError::Value(_) => {
                StatusCode::UNPROCESSABLE_ENTITY
            }
        };
        Self::new(status, error)
    }
}

/// A JSON body. It must be declared as such: a form of a foreign page cannot.
pub struct Body<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequest<S> for Body<T> {
    type Rejection = Failure;

    async fn from_request(request: Request, state: &S) -> Result<Self, Failure> {
        let kind = request.headers().get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or("");
        if kind.split(';').next().map(str::trim) != Some("application/json") {
            let text = "send a JSON object, with the header 'Content-Type: application/json'";
            return Err(Failure::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, text));
        }
        let bytes = Bytes::from_request(request, state).await.map_err(|e| Failure::new(e.status(), e.body_text()))?;
        read(&bytes).map(Self).map_err(|text| Failure::new(StatusCode::BAD_REQUEST, text))
    }
}

/// Reads JSON; what is wrong is named with its key.
///
/// # Errors
/// A sentence.
pub fn read<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let path = error.path().to_string();
        let inner = error.into_inner();
        if path == "." { inner.to_string() } else { format!("{path}: {inner}") }
    })?;
    reader.end().map_err(|e| e.to_string())?;
    Ok(value)
}
