//! Lists for people: captures, diagnoses, jobs and models, with a search and pages by number.

use super::extract::Q;
use super::html::html_with_form;
use super::page;
use super::problem::ApiError;
use super::state::ApiState;
use crate::page::{self as html, ListView, SEARCH_MAX};
use crate::store::{Found, Reader, Search, StoreError};
use axum::extract::State;
use axum::http::Uri;
use axum::response::Response;
use serde::Deserialize;

/// The wanted part of a list.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ListQuery {
    /// A text that each row must contain.
    q: Option<String>,
    /// The number of the page, from 1.
    page: Option<String>,
}

impl ListQuery {
    fn search(self) -> Result<Search, ApiError> {
        let text = self.q.map(|text| text.trim().to_owned()).filter(|text| !text.is_empty());
        if let Some(text) = &text {
            let length = text.chars().count();
            if length > SEARCH_MAX {
                let reason = format!("`q` has {length} characters: it may have {SEARCH_MAX}");
                return Err(ApiError::bad_request(reason));
            }
            if text.chars().any(char::is_control) {
                return Err(ApiError::bad_request("`q` has a control character, which no row contains"));
            }
        }
        let page = match self.page.as_deref() {
            None => 1,
            Some(number) => number.parse().ok().filter(|number| *number > 0).ok_or_else(|| {
                let found: String = number.chars().take(40).collect();
                ApiError::bad_request(format!("`page` is `{found}`: expected a number from 1 to {}", u32::MAX))
            })?,
        };
        Ok(Search { text, page })
    }
}

/// Returns the page of a list: `find` reads the rows, `show` writes them.
async fn answer<T: Send + 'static>(
    state: &ApiState,
    uri: &Uri,
    query: ListQuery,
    find: fn(&Reader, &Search) -> Result<Found<T>, StoreError>,
    show: fn(&ListView<'_, T>) -> String,
) -> Result<Response, ApiError> {
    let search = query.search()?;
    let own = search.clone();
    let found = state.read(move |reader| find(reader, &own)).await?;
    let address = |number: u32| page::with(uri, "page", &number.to_string());
    let previous = (search.page > 1).then(|| address(search.page - 1));
    let next = search.page.checked_add(1).filter(|_| found.more).map(address);
    let view = ListView { search: &search, found: &found, previous: previous.as_deref(), next: next.as_deref() };
    Ok(html_with_form(show(&view)))
}

/// Returns the page of all captures.
pub(super) async fn captures(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<ListQuery>,
) -> Result<Response, ApiError> {
    answer(&state, &uri, query, Reader::find_captures, html::captures).await
}

/// Returns the page of all diagnoses.
pub(super) async fn diagnoses(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<ListQuery>,
) -> Result<Response, ApiError> {
    answer(&state, &uri, query, Reader::find_diagnoses, html::diagnoses).await
}

/// Returns the page of all jobs.
pub(super) async fn jobs(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<ListQuery>,
) -> Result<Response, ApiError> {
    answer(&state, &uri, query, Reader::find_jobs, html::jobs).await
}

/// Returns the page of all models.
pub(super) async fn models(
    State(state): State<ApiState>,
    uri: Uri,
    Q(query): Q<ListQuery>,
) -> Result<Response, ApiError> {
    answer(&state, &uri, query, Reader::find_models, html::models).await
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(q: Option<&str>, page: Option<&str>) -> Result<Search, ApiError> {
        ListQuery { q: q.map(str::to_owned), page: page.map(str::to_owned) }.search()
    }

    #[test]
    fn a_page_is_a_number_from_1_and_a_search_is_short_text() {
        assert_eq!(search(None, None).unwrap(), Search { text: None, page: 1 });
        assert_eq!(search(Some("  "), Some("2")).unwrap(), Search { text: None, page: 2 });
        assert_eq!(search(Some(" a_% "), None).unwrap().text.as_deref(), Some("a_%"));
        assert!(search(Some(&"é".repeat(SEARCH_MAX)), Some("4294967295")).is_ok());
        for wrong in ["0", "-1", "1e9", "abc", "", "4294967296", "1.5", " 1", "١"] {
            assert!(search(None, Some(wrong)).unwrap_err().to_string().starts_with("`page` is"), "{wrong}");
        }
        for wrong in [&"x".repeat(SEARCH_MAX + 1), "a\0b", "a\nb"] {
            assert!(search(Some(wrong), None).unwrap_err().to_string().starts_with("`q` has"), "{wrong:?}");
        }
    }
}
