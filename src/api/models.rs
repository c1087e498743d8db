//! Stored sensor models, which requests name by their id.

use super::extract::{J, P, Q};
use super::page::{self, PageQuery};
use super::problem::{ApiError, Problem};
use super::state::ApiState;
use crate::jobs::{EFFECTS_MAX, JobError, check_size};
use crate::store::{ModelEntry, ModelRow, StoreError};
use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, Uri};
use axum::response::Response;
use imu_core::units::parse_duration;
use imu_cost::{Cost, CostError, Request as CostRequest, Tolerance};
use imu_model::simulator::SensorModel;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The most horizons of a cost.
const HORIZONS_MAX: usize = 12;
/// The most samples of alignment and horizon together: an hour at 800 Hz.
const SAMPLES_MAX: f64 = 3e6;

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

/// What is asked of a model's cost.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CostQuery {
    /// Times without aid, increasing, separated by commas; with the limits at most 12.
    #[param(default = "1s,10s,1min,10min,1h")]
    horizons: Option<String>,
    /// Time at rest before, over which the bias is taken as a mean.
    #[param(default = "30s")]
    align: Option<String>,
    /// Limits on a 95 % band, such as `heading=1deg/10min,position=1m/10s`.
    tolerance: Option<String>,
}

impl CostQuery {
    fn request(&self) -> Result<CostRequest, ApiError> {
        let time = |key: &str, text: &str| {
            let found = parse_duration(text.trim());
            found.map(|of| of.as_secs_f64()).map_err(|error| ApiError::bad_request(format!("`{key}`: {error}")))
        };
        let mut request = CostRequest { simulate: false, ..CostRequest::default() };
        if let Some(text) = &self.horizons {
            request.horizons_s = text.split(',').map(|one| time("horizons", one)).collect::<Result<_, _>>()?;
        }
        if let Some(text) = &self.align {
            request.align_s = time("align", text)?;
        }
        if let Some(text) = &self.tolerance {
            request.tolerances = Tolerance::parse(text).map_err(JobError::from)?;
        }
        // A limit has a horizon of its own.
        let found = request.horizons_s.len() + request.tolerances.len();
        if found > HORIZONS_MAX {
            let text =
                format!("{found} times and limits, expected at most {HORIZONS_MAX} in `horizons` and `tolerance`");
            return Err(ApiError::bad_request(text));
        }
        Ok(request)
    }
}

/// What the errors of a sensor model cost: growth of attitude, velocity and position errors without aid, by cause. An
/// effect that has no closed form is not simulated here: its quantities are left out, and a note states why.
#[utoipa::path(get, path = "/v1/models/{id}/cost", tag = "diagnoses",
    params(("id" = String, Path, description = "Id, as `model-1`"), CostQuery), responses(
    (status = 200, body = Object, description = "`vn100d-cost-1`"),
    (status = 400, body = Problem, content_type = "application/problem+json", description = "Times or limits make no sense"),
    (status = 422, body = Problem, content_type = "application/problem+json",
     description = "The model has no channel of an integration, or no quantity with a closed form"),
    (status = 404, body = Problem, content_type = "application/problem+json", description = "There is no such model")))]
pub(super) async fn cost(
    State(state): State<ApiState>,
    P(id): P,
    Q(query): Q<CostQuery>,
) -> Result<Json<Cost>, ApiError> {
    let request = query.request()?;
    let found = state.compute(move |reader, _| {
        let row = reader.model(number(&id)?)?;
        let model = SensorModel::from_value(&serde_json::from_str(&row.body)?, &id)?;
        check_size(&model, EFFECTS_MAX)?;
        let longest_s = request.horizons_s.iter().chain(request.tolerances.iter().map(|of| &of.horizon_s));
        let longest_s = request.align_s + longest_s.copied().fold(0.0, f64::max);
        let internal_hz = model.internal_rate_hz(model.rate_hz);
        if longest_s * internal_hz > SAMPLES_MAX {
            let most_s = (SAMPLES_MAX / internal_hz).floor();
            return Err(CostError::Long { found: longest_s, rate_hz: internal_hz, most_s }.into());
        }
        Ok(imu_cost::cost(&model, &id, &request)?)
    });
    Ok(Json(found.await?))
}

fn number(id: &str) -> Result<i64, StoreError> {
    let number = id.strip_prefix("model-").and_then(|number| number.parse().ok());
    number.ok_or_else(|| StoreError::NoSuchModel(id.chars().take(40).collect()))
}
