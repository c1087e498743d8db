//! Two captures side by side, and diagnoses with what the page's form sends.

use super::*;
use serde_json::{Value, json};

#[test]
fn two_captures_are_chosen_on_a_page_and_shown_side_by_side() {
    let world = World::new();
    assert!(world.get("/compare").text.contains("There are no two captures that have ended."));
    world.capture("one <b>", CaptureState::Complete, 4000);
    world.capture("two", CaptureState::Complete, 5000);
    world.capture("open", CaptureState::Capturing, 1000);
    world.capture("empty", CaptureState::Complete, 0);
    let choice = world.get("/compare?a=&b=1");
    assert!(choice.header("content-security-policy").contains("form-action 'self';"));
    let names = ["one &lt;b&gt;</option>", ">two</option>", ">open</option>", ">empty</option>"];
    assert_eq!(names.map(|name| choice.text.matches(name).count()), [2, 2, 0, 0], "{}", choice.text);
    let of_one = world.get("/captures/two").text;
    let form = "action=\"/compare\"><input type=\"hidden\" name=\"a\" value=\"2\">";
    assert!(of_one.contains(form) && of_one.contains("<option value=\"1\">one &lt;b&gt;</option>"), "{of_one}");
    assert!(!of_one.contains("<option value=\"2\">"), "a capture is not offered beside itself: {of_one}");
    // It waits for the analyses by itself.
    let first = world.get("/compare?a=1&b=two");
    assert!(first.status == 200 && first.header("cache-control") == "no-store", "{first:?}");
    let page = eventually("both", || world.get("/compare?a=1&b=two").text, |page| !page.contains("data-waits"));
    for expected in [
        "<h1>one &lt;b&gt; and two</h1>",
        "<th scope=\"row\">samples</th><td>4000</td><td>5000</td>",
        "<h2>Noise parameters</h2>",
        "src=\"/v1/captures/1/plots/allan-gyro_x.svg?beside=2\"",
        "href=\"/v1/captures/1/plots/allan-gyro_x.png?beside=2\"",
        "src=\"/v1/captures/2/plots/gaps.svg\"",
    ] {
        assert!(page.contains(expected), "{expected}: {page}");
    }
    for (query, status) in [("a=1&b=1", 400), ("a=1&b=9", 404), ("a=1&b=2&c=3", 400)] {
        assert_eq!(world.get(&format!("/compare?{query}")).status, status, "{query}");
    }
}

#[test]
fn a_picture_has_the_curves_of_two_captures() {
    let world = World::new();
    world.capture("one <b>", CaptureState::Complete, 4000);
    world.capture("two", CaptureState::Complete, 5000);
    let path = "/v1/captures/1/plots/allan-gyro_x.svg?beside=two";
    let picture = eventually("the analyses", || world.get(path), |answer| answer.status != 202);
    assert_eq!((picture.status, picture.header("content-type")), (200, "image/svg+xml"), "{picture:?}");
    assert!(picture.text.contains("one &lt;b&gt;") && picture.text.contains("line second"), "{}", picture.text);
    let tag = picture.header("etag");
    assert_eq!(world.get_with(path, "if-none-match", tag).status, 304);
    // Another name is another picture.
    let renamed = world.patch("/v1/captures/2", r#"{"name": "foam"}"#);
    assert_eq!(renamed.status, 200, "{renamed:?}");
    let again = world.get_with("/v1/captures/1/plots/allan-gyro_x.svg?beside=foam", "if-none-match", tag);
    assert!(again.status == 200 && again.text.contains(">foam<"), "{again:?}");
    for (path, status, reason) in [
        ("psd-gyro.svg?beside=2", 400, "`beside` is for allan-"),
        ("allan-gyro.svg?beside=2", 400, "`beside` is for allan-"),
        ("allan-gyro_x.svg?beside=nobody", 404, "nobody"),
        ("allan-gyro_x.svg?beside=2&from=1", 400, "`from` and `to`"),
    ] {
        let refused = world.get(&format!("/v1/captures/1/plots/{path}"));
        assert!(refused.status == status && refused.text.contains(reason), "{path}: {refused:?}");
    }
}

#[test]
fn an_encoder_is_a_reference_with_the_axis_of_the_request() {
    let world = World::new();
    world.jobs.stop();
    world.capture("a", CaptureState::Complete, 4000);
    let rows: String = (0..1000).map(|row| format!("{},{}\n", f64::from(row) * 0.1, row % 7)).collect();
    let model =
        json!({"format": "vn100d-sensor-model-1", "name": "unit", "rate_hz": 40, "channels": {"gyro_x": {"N": 1e-5}}});
    let ask = |axis: Value| {
        let body = json!({"sim": model, "reference": format!("time_s,encoder_rpm\n{rows}"), "reference_axis": axis});
        world.post("/v1/captures/a/diagnoses", &body.to_string())
    };
    let refused = ask(Value::Null);
    assert!(refused.status == 400 && refused.text.contains("`reference_axis`"), "{refused:?}");
    let [z, again, y] = ["z", "z", "y"].map(|axis| ask(json!(axis)));
    assert_eq!([z.status, again.status, y.status], [202, 200, 202], "{z:?}");
    assert_eq!(z.json()["params"]["reference"]["axis"], "z", "{z:?}");
    // The same text about another axis is another diagnosis.
    assert_eq!(z.json()["id"], again.json()["id"]);
    assert_ne!(z.json()["id"], y.json()["id"]);
}
