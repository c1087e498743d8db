//! Stored sensor models, which requests name by their id.

use super::extract::{J, P, Q};
use super::page::{self, PageQuery};
use super::problem::{ApiError, Problem};
use super::state::ApiState;
use crate::jobs::JobError;
use crate::store::{ModelEntry, ModelRow, StoreError};
use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, Uri};
use axum::response::Response;
use imu_model::simulator::SensorModel;
use serde::Serialize;
use serde_json::Value;

/// A sensor model with its properties.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Model {
    #[serde(flatten)]
    entry: ModelEntry,
    /// The model, `vn100d-sensor-model-1`.
    #[schema(value_type = Object)]
    model: Value,
}

impl TryFrom<ModelRow> for Model {
    type Error = JobError;
    fn try_from(row: ModelRow) -> Result<Self, JobError> {
        Ok(Self { model: serde_json::from_str(&row.body)?, entry: row.entry })
    }
}

/// A page of models, the latest first.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Models {
    models: Vec<ModelEntry>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
}

/// Sensor models, the latest first.
#[utoipa::path(get, path = "/v1/models", tag = "diagnoses", params(PageQuery), responses(
    (status = 200, body = Models),
    (status = 400, body = Problem, content_type = "application/problem+json")))]
pub(super) async fn list(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<PageQuery>,
) -> Result<Response, ApiError> {
    let request = query.request()?;
    let found = state.read(move |reader| reader.models(&request)).await?;
    Ok(page::answer(&uri, found, |models, next| Models { models, next }))
}

/// Stores a sensor model. The same model again returns the same entry.
#[utoipa::path(post, path = "/v1/models", tag = "diagnoses", request_body = Object, responses(
    (status = 201, body = Model, headers(("Location" = String, description = "The model"))),
    (status = 200, body = Model, description = "It was here before"),
    (status = 400, body = Problem, content_type = "application/problem+json", description = "It is no sensor model"),
    (status = 409, body = Problem, content_type = "application/problem+json", description = "There are as many as are kept")))]
pub(super) async fn keep(State(state): State<ApiState>, J(body, _permit): J<Value>) -> Result<Response, ApiError> {
    let body = body.ok_or_else(|| ApiError::bad_request("the body is empty: expected a sensor model"))?;
    let model = SensorModel::from_value(&body, "the body").map_err(JobError::from)?;
    let text = serde_json::to_string(&model).map_err(JobError::from)?;
    let (row, is_new) = state.change(move |parts| parts.store.keep_model(&model.name, model.rate_hz, text)).await?;
    let model = Model::try_from(row)?;
    Ok(page::made(is_new, &format!("/v1/models/{}", model.entry.id), model))
}

/// One sensor model.
#[utoipa::path(get, path = "/v1/models/{id}", tag = "diagnoses",
    params(("id" = String, Path, description = "Id, as `model-1`")), responses(
    (status = 200, body = Model)))]
pub(super) async fn show(State(state): State<ApiState>, P(id): P) -> Result<Json<Model>, ApiError> {
    let row = state.read(move |reader| reader.model(number(&id)?)).await?;
    Ok(Json(Model::try_from(row)?))
}

/// Deletes a sensor model; diagnoses that were requested with it stay.
#[utoipa::path(delete, path = "/v1/models/{id}", tag = "diagnoses",
    params(("id" = String, Path, description = "Id, as `model-1`")), responses(
    (status = 204, description = "It is gone")))]
pub(super) async fn delete(State(state): State<ApiState>, P(id): P) -> Result<StatusCode, ApiError> {
    state.change(move |parts| parts.store.delete_model(number(&id)?)).await?;
    Ok(StatusCode::NO_CONTENT)
}

fn number(id: &str) -> Result<i64, StoreError> {
    let number = id.strip_prefix("model-").and_then(|number| number.parse().ok());
    number.ok_or_else(|| StoreError::NoSuchModel(id.chars().take(40).collect()))
}
