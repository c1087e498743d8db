//! The page of two captures side by side, and the page on which they are chosen.

use super::extract::Q;
use super::html::{html, html_with_form};
use super::pages::{self, Analyses};
use super::problem::ApiError;
use super::state::ApiState;
use crate::gallery::{self, Picture};
use crate::page::{self, ComparisonView, Figure, PAIRS, Side};
use axum::extract::State;
use axum::response::Response;
use imu_core::sample::Channel;
use serde::Deserialize;

/// The captures.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ComparisonQuery {
    /// Id, name, or `latest`.
    a: Option<String>,
    /// Id, name, or `latest`.
    b: Option<String>,
}

/// Returns the page: two captures side by side, or the choice of two if one is not given.
pub(super) async fn comparison(
    State(state): State<ApiState>,
    Q(query): Q<ComparisonQuery>,
) -> Result<Response, ApiError> {
    let given = |name: Option<String>| name.filter(|name| !name.is_empty());
    let (Some(a), Some(b)) = (given(query.a), given(query.b)) else {
        let captures = state.read(|reader| pages::ended(reader, None)).await?;
        return Ok(html_with_form(page::choice(&captures)));
    };
    let _permit = state.drawing_permit().await?;
    let (facts, jobs) = state
        .read(move |reader| {
            let ids = [reader.resolve(&a)?, reader.resolve(&b)?];
            let facts = [gallery::facts(reader, ids[0])?, gallery::facts(reader, ids[1])?];
            Ok((facts, [pages::jobs_of(reader, ids[0])?, pages::jobs_of(reader, ids[1])?]))
        })
        .await?;
    if facts[0].row.id == facts[1].row.id {
        let message = format!("`a` and `b` are both the capture {}: choose two", facts[0].row.name);
        return Err(ApiError::bad_request(message));
    }
    let analyses = [
        pages::analyses(&state, facts[0].row.id, &jobs[0]).await,
        pages::analyses(&state, facts[1].row.id, &jobs[1]).await,
    ];
    let mut remarks = Vec::new();
    for (facts, of) in facts.iter().zip(&analyses) {
        let own = of.remarks.iter().cloned().chain(facts.remark());
        remarks.extend(own.map(|remark| format!("{}: {remark}", facts.row.name)));
    }
    let figures = [0, 1].map(|side| {
        let (facts, id) = (&facts[side], facts[side].row.id.to_string());
        let own = gallery::pictures(facts, &analyses[side].documents).into_iter();
        let own = own.filter(|of| PAIRS.iter().any(|(_, names)| names.contains(&of.name().as_str())));
        own.map(|picture| (picture.name(), pages::linked(&id, picture))).collect()
    });
    let [a, b] = [0, 1].map(|side| Side {
        row: &facts[side].row,
        documents: &analyses[side].documents,
        figures: &figures[side],
    });
    let view = ComparisonView {
        sides: [a, b],
        both: &both([&a, &b]),
        remarks: &remarks,
        waits: analyses.iter().any(|of: &Analyses| of.waits),
    };
    Ok(html(page::comparison(&view)))
}

/// Returns the pictures that have a curve of each capture.
fn both([a, b]: [&Side<'_>; 2]) -> Vec<Figure> {
    let deviates = |side: &Side<'_>, channel: &Channel| {
        side.documents.allan.as_ref().is_some_and(|report| report.channels.contains_key(channel))
    };
    let mut shared = Channel::ANALYSED.to_vec();
    shared.retain(|channel| deviates(a, channel) && deviates(b, channel));
    shared.sort_by_key(page::order);
    shared
        .iter()
        .map(|channel| {
            let picture = Picture::AllanOfOne(*channel);
            Figure::Linked {
                alt: format!("Allan deviation of {channel} in {} and in {}", a.row.name, b.row.name),
                address: format!("/v1/captures/{}/plots/{}.svg?beside={}", a.row.id, picture.name(), b.row.id),
                height: picture.height(),
            }
        })
        .collect()
}
