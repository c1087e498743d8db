//! Lists for people, and errors as pages.

use super::*;

const BROWSER: &str = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8";

/// Returns the address behind a label on a page.
fn address<'a>(page: &'a str, label: &str) -> Option<&'a str> {
    let before = page.split_once(&format!("\">{label}</a>"))?.0;
    before.rsplit_once("href=\"").map(|(_, address)| address)
}

#[test]
fn the_lists_are_pages_that_say_when_they_are_empty() {
    let world = World::new();
    for list in ["captures", "diagnoses", "jobs", "models"] {
        let page = world.get(&format!("/{list}"));
        assert_eq!((page.status, page.header("content-type")), (200, "text/html; charset=utf-8"), "{list}");
        assert!(page.header("content-security-policy").contains("form-action 'self';"), "{list}");
        assert_eq!(page.header("cache-control"), "no-store");
        assert!(page.text.contains("There are none yet.") && !page.text.contains("<table>"), "{}", page.text);
        assert!(page.text.contains(&format!("action=\"/{list}\"")), "{}", page.text);
        let head = Answer::of(agent().head(world.url(&format!("/{list}"))).call());
        assert_eq!((head.status, &*head.text, head.header("content-type")), (200, "", "text/html; charset=utf-8"));
        assert!(world.get("/").text.contains(&format!("<a href=\"/{list}\">{list}</a>")), "{list}");
        assert_eq!(world.get(&format!("/{list}?other=1")).status, 400);
    }
    assert!(world.get("/").header("content-security-policy").contains("form-action 'none';"));
}

#[test]
fn the_links_of_a_search_lead_through_all_of_its_pages() {
    let world = World::new();
    for number in 0..60 {
        world.capture(&format!("a&b_{number}"), CaptureState::Complete, 0);
        world.capture(&format!("other {number}"), CaptureState::Complete, 0);
    }
    let first = world.get("/captures?q=A%26B_&page=1").text;
    assert!(first.contains("1 to 50 of those with “A&amp;B_”, the latest first."), "{first}");
    assert_eq!((first.matches("a&amp;b_").count(), address(&first, "previous page")), (50, None));
    let next = address(&first, "next page").unwrap().replace("&amp;", "&");
    assert_eq!(next, "/captures?q=A%26B_&page=2");
    let second = world.get(&next).text;
    assert!(second.contains("51 to 60 of those with"), "{second}");
    assert_eq!((second.matches("a&amp;b_").count(), address(&second, "next page")), (10, None));
    assert_eq!(address(&second, "previous page"), Some("/captures?q=A%26B_&amp;page=1"));
    assert!(!second.contains("other"), "{second}");
    assert!(world.get("/captures?page=3").text.contains("101 to 120, the latest first."));
    assert!(world.get("/captures?page=4").text.contains("There is no page 4."));
}

#[test]
fn the_lists_show_jobs_models_and_diagnoses_of_a_hostile_name() {
    let world = World::new();
    world.capture("<b>x", CaptureState::Complete, 2000);
    let model = r#"{"format": "vn100d-sensor-model-1", "name": "unit <7>", "rate_hz": 40, "channels": {"gyro_x": {"N": 1e-5}}}"#;
    assert_eq!(world.post("/v1/models", model).status, 201);
    let asked = world.post("/v1/captures/latest/diagnoses", r#"{"sim": "model-1"}"#);
    assert_eq!(asked.status, 202, "{asked:?}");
    let id = asked.json()["id"].clone();
    let report =
        eventually("the diagnosis", || world.get(&format!("/v1/diagnoses/{id}")), |answer| answer.status != 202);
    let summary = report.json()["summary"].as_str().unwrap().to_owned();
    let diagnoses = world.get("/diagnoses?q=UNIT+%3C7").text;
    for expected in [
        &*format!(
            "<a href=\"/diagnoses/{id}\">{}</a>",
            summary.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
        ),
        "<td class=\"\">unit &lt;7&gt;</td>",
        "\">&lt;b&gt;x</a>",
        ">done<",
    ] {
        assert!(diagnoses.contains(expected), "{expected}: {diagnoses}");
    }
    let jobs = world.get("/jobs?q=diagnosis").text;
    assert!(jobs.contains(&format!("<a href=\"/diagnoses/{id}\">diagnosis</a>")), "{jobs}");
    let models = world.get("/models?q=model-1").text;
    assert!(models.contains("<a href=\"/v1/models/model-1\">unit &lt;7&gt;</a>"), "{models}");
    for page in [&diagnoses, &jobs, &models, &world.get("/captures").text] {
        assert!(!page.contains("<b>x") && !page.contains("<7>"), "{page}");
    }
}

#[test]
fn a_browser_gets_errors_as_pages_and_a_program_gets_documents() {
    let world = World::new();
    for (path, status, title) in [
        ("/nothing/%3Cb%3E", 404, "There is nothing here."),
        ("/captures/77", 404, "There is nothing here."),
        ("/captures/77/series/gyro_x", 404, "There is nothing here."),
        ("/diagnoses/x", 404, "There is nothing here."),
        ("/v1/captures/77", 404, "There is nothing here."),
        ("/captures?page=0", 400, "The request cannot be understood."),
    ] {
        let page = world.get_with(path, "accept", BROWSER);
        assert_eq!((page.status, page.header("content-type")), (status, "text/html; charset=utf-8"), "{path}");
        assert!(page.header("content-security-policy").starts_with("default-src 'none'"), "{path}");
        assert_eq!((page.header("cache-control"), page.header("x-content-type-options")), ("no-store", "nosniff"));
        assert!(page.text.contains(&format!("<h1>{title}</h1>")), "{}", page.text);
        assert!(page.text.contains("<a href=\"/\">") && page.text.contains("<a href=\"/captures\">"), "{}", page.text);
        assert!(page.text.contains(&format!("/requests/{}", page.header("x-request-id"))), "{}", page.text);
        let kind = if status == 404 { "not-found" } else { "bad-request" };
        world.get(path).problem(status, kind);
        world.get_with(path, "accept", "application/json").problem(status, kind);
        let head = Answer::of(agent().head(world.url(path)).header("accept", BROWSER).call());
        assert_eq!((head.status, &*head.text), (status, ""), "{path}");
    }
    let refused = agent().post(world.url("/captures")).header("accept", BROWSER).send("q=x");
    let refused = Answer::of(refused);
    assert_eq!((refused.status, refused.header("content-type")), (405, "text/html; charset=utf-8"));
    assert!(refused.text.contains("The method is not allowed here.") && refused.header("allow").contains("GET"));
    world.post("/captures", "{}").problem(405, "method-not-allowed");
    let foreign = agent().get(world.url("/captures")).header("host", "evil.example").call();
    Answer::of(foreign).problem(403, "not-authorized");
}
