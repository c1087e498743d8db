//! The pages in a browser, as users see them: `tests/browser/pages.mjs` against the demonstration and a daemon with a
//! token. The lists byte by byte, also as no browser asks for them.

use crate::world::{Process, World, program};
use serde_json::Value;
use std::io::{Read as _, Write as _};
use std::path::Path;
use std::process::Command;
use vn100_testkit::tool;

/// The token in the configuration, which is also typed into the page.
const TOKEN: &str = "correct-horse-battery";
/// The properties that the script must have checked, and the minimum number of checks: a script that checks nothing is
/// no success. Pages are checked at two widths on light and on dark.
const HELD: [(&str, u64); 18] = [
    ("accessible", 56),
    ("compared", 6),
    ("diagnosis", 1),
    ("escaped", 10),
    ("list", 4),
    ("lost", 1),
    ("moves", 8),
    ("picture", 500),
    ("policy", 22),
    ("refused", 2),
    ("report", 1),
    ("request", 300),
    ("schedule", 3),
    ("screenshot", 68),
    ("static", 3),
    ("token", 3),
    ("width", 68),
    ("zoom", 2),
];

/// Returns `None`, with a note, if the browser, its driver or the script's runtime is missing.
fn at_hand(root: &Path) -> Option<()> {
    let there = |names: &str| {
        let found = Command::new("sh").args(["-c", &format!("command -v {names}")]).output().unwrap();
        found.status.success()
    };
    let browser = "chromium || command -v chromium-browser || command -v google-chrome";
    let driver = root.join("target/browser/node_modules/playwright-core/package.json").exists()
        && root.join("target/browser/node_modules/axe-core/package.json").exists();
    let found = [
        tool(there("node"), "node", "it runs the browser test's script"),
        tool(there(browser), "chromium", "the pages are looked at in it"),
        tool(driver, "playwright-core with axe-core", "node tests/browser/pages.mjs --install brings them"),
    ];
    found.iter().all(|found| *found).then_some(())
}

#[test]
fn people_go_from_the_first_page_to_the_diagnosis_and_every_page_is_sound() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    if at_hand(root).is_none() {
        return;
    }
    let world = World::new();
    let sensor = world.emulate(&[]);
    let guarded = world.daemon(&format!("[http]\ntoken = \"{TOKEN}\"\n"), &[]);
    let streaming = || (world.get("/v1/status")["sensor"]["state"] == "streaming").then_some(());
    world.until("the sensor sends", std::time::Duration::from_secs(30), streaming, &guarded);
    // Slow enough for the first page to be checked while it records. Its folder is removed with the test's.
    let mut demo = program();
    demo.args(["demo", "--listen", "127.0.0.1:0", "--speed", "600"]).env("TMPDIR", world.folder.path());
    let mut demo = Process::start(&mut demo, true);
    let address = demo.first_line.split("answers at ").nth(1).unwrap_or_else(|| panic!("{}", demo.log()));
    let output = Command::new("node")
        .arg(root.join("tests/browser/pages.mjs"))
        .args(["--demo", address.trim_end_matches('.')])
        .args(["--guarded", &world.url, "--token", TOKEN, "--pid", &guarded.id().to_string()])
        .arg("--pictures")
        .arg(root.join("target/screenshots"))
        .output()
        .unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let printed = format!("{}{}", text(&output.stdout), text(&output.stderr));
    let logs = || format!("{printed}\nthe demonstration:\n{}\nthe daemon:\n{}", demo.log(), guarded.log());
    assert!(output.status.success(), "{}", logs());
    let last = printed.lines().find(|line| line.starts_with("{\"held\"")).unwrap_or_else(|| panic!("{printed}"));
    let report: Value = serde_json::from_str(last).unwrap();
    for (kind, least) in HELD {
        let held = report["held"][kind].as_u64().unwrap_or(0);
        assert!(held >= least, "{kind} held {held} times instead of {least}: {report}");
    }
    assert_eq!(demo.terminate(), Some(0), "{}", demo.log());
    drop(sensor);
}

/// Returns the whole answer, head and body, to a request of these bytes.
fn answer(world: &World, method: &str, target: &[u8], accept: &str) -> String {
    let host = world.url.trim_start_matches("http://");
    let mut stream = std::net::TcpStream::connect(host).unwrap();
    stream.set_read_timeout(Some(std::time::Duration::from_secs(20))).unwrap();
    let rest = format!(" HTTP/1.1\r\nHost: {host}\r\nAccept: {accept}\r\nConnection: close\r\n\r\n");
    stream.write_all(&[method.as_bytes(), b" ", target, rest.as_bytes()].concat()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn a_capture_is_found_in_the_list_by_its_note_and_no_request_breaks_a_list() {
    let world = World::new();
    let daemon = world.daemon("", &[]);
    for number in 0..3 {
        let csv = format!("time_s,gyro_x_rad_s\n0.000,0\n0.025,{number}\n0.050,1\n");
        let (status, body) =
            world.request_as("POST", &format!("/v1/imports?name=desk_{number}"), "text/csv", &csv).unwrap();
        assert_eq!(status, 201, "{body}\n{}", daemon.log());
    }
    let note = r#"{"note": "100 % <script>alert(1)</script> on \"foam\"", "pinned": true}"#;
    assert_eq!(world.request("PATCH", "/v1/captures/desk_1", note).unwrap().0, 200);
    let get = |target: &str| answer(&world, "GET", target.as_bytes(), "text/html");
    let all = get("/captures");
    let places = ["desk_2", "desk_1", "desk_0"].map(|name| all.find(&format!("\">{name}</a>")).unwrap());
    assert!(places.is_sorted() && all.contains("<td class=\"\">kept</td>"), "{all}");
    assert!(all.contains("100 % &lt;script&gt;alert(1)&lt;/script&gt; on &quot;foam&quot;"), "{all}");
    let found = get("/captures?q=ON+%22Foam");
    assert!(
        found.contains(">desk_1</a>") && !found.contains(">desk_0</a>") && !found.contains("<script>alert"),
        "{found}"
    );
    for (escaped, expected) in [("%25", [false, true, false]), ("k_2", [false, false, true]), ("DESK_", [true; 3])] {
        let found = get(&format!("/captures?q={escaped}"));
        assert_eq!([0, 1, 2].map(|number| found.contains(&format!(">desk_{number}</a>"))), expected, "{escaped}");
    }
    let long = format!("q={}", "%C3%A9".repeat(1700));
    let queries: [(&[u8], &str); 15] = [
        (b"page=0", "400"),
        (b"page=-1", "400"),
        (b"page=1e9", "400"),
        (b"page=abc", "400"),
        (b"page=", "400"),
        (b"page=1000000000", "200"),
        (b"page=1&page=2", "400"),
        (b"x=1", "400"),
        (long.as_bytes(), "400"),
        (b"q=%", "200"),
        (b"q=_&page=4294967295", "200"),
        (b"q=%27%22%5C%3Cscript%3E", "200"),
        (b"q=it's", "200"),
        (b"q=%FF%FE", "200"),
        (b"q=a%00b", "400"),
    ];
    for list in ["captures", "diagnoses", "jobs", "models"] {
        for (query, status) in queries {
            let target = [format!("/{list}?").as_bytes(), query].concat();
            let shown = String::from_utf8_lossy(&target).into_owned();
            let page = answer(&world, "GET", &target, "text/html");
            assert!(page.starts_with(&format!("HTTP/1.1 {status} ")), "{shown}: {page}");
            assert!(page.contains("<h1>") && page.contains("<p") && !page.contains("<script>"), "{shown}: {page}");
        }
        // No address has such bytes: the HTTP library answers by itself.
        for query in [&b"q=it's\""[..], b"q=\xff\xc3"] {
            let page = answer(&world, "GET", &[format!("/{list}?").as_bytes(), query].concat(), "text/html");
            assert!(["HTTP/1.1 400 ", "HTTP/1.1 200 "].iter().any(|status| page.starts_with(status)), "{page}");
        }
        let head = answer(&world, "HEAD", format!("/{list}").as_bytes(), "text/html");
        assert!(head.starts_with("HTTP/1.1 200 ") && head.ends_with("\r\n\r\n"), "{head}");
    }
    let gone = get("/captures/desk_9");
    assert!(gone.starts_with("HTTP/1.1 404 ") && gone.contains("<h1>There is nothing here.</h1>"), "{gone}");
    let document = answer(&world, "GET", b"/captures/desk_9", "*/*");
    assert!(document.contains("content-type: application/problem+json"), "{document}");
}
