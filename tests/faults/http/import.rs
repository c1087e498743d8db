//! `vn100d import` beside a running daemon uses the daemon.

use super::*;

/// Runs `vn100d import --json` on the world's database; returns its exit code, report and error output.
fn import(world: &World, arguments: &[&str]) -> (Option<i32>, Value, String) {
    let output = program()
        .args(["--data-dir", world.path("data").to_str().unwrap()])
        .args(["--config", world.path("vn100d.toml").to_str().unwrap(), "--json", "import"])
        .args(arguments)
        .output()
        .unwrap();
    let answer = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output.status.code(), answer, String::from_utf8_lossy(&output.stderr).into_owned())
}

/// As docs/cli.md states for `import`: beside a daemon it uses the daemon, with the same report and exit codes.
#[test]
fn an_import_beside_a_daemon_goes_through_it_and_is_the_import_without_one() {
    let world = World::new();
    let mut csv = String::from("time_s,gyro_x_rad_s,colour\n");
    for row in 0..scaled(40_000, 2_000_000) {
        // One hole of 40 samples, one line that is not a sample.
        let at = (row + if row < 5000 { 0 } else { 40 }) as f64 / 40.0;
        csv.push_str(&format!("{at:.3},{:.6},red\n", noise(row as u64, Channel::GyroX)));
        if row == 100 {
            csv.push_str("rubbish\n");
        }
    }
    let file = world.path("desk.csv");
    std::fs::write(&file, &csv).unwrap();
    let file = file.to_str().unwrap();
    let packed = world.path("second.csv.gz");
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(csv.replace("red", "blue").as_bytes()).unwrap();
    std::fs::write(&packed, encoder.finish().unwrap()).unwrap();

    let alone = World::new();
    std::fs::write(alone.path("vn100d.toml"), "").unwrap();
    let (code, offline, errors) = import(&alone, &[file]);
    assert_eq!(code, Some(3), "{errors}");

    let _sensor = world.emulate(&[]);
    let listen = world.url.trim_start_matches("http://").to_owned();
    let daemon = world.daemon(&format!("[http]\nlisten = \"{listen}\"\n"), &["--capture", "1h"]);
    let some = || world.try_get("/v1/status").filter(|status| status["capture"]["samples"].as_u64() > Some(20));
    world.until("samples", Duration::from_secs(15), some, &daemon);
    let (code, online, errors) = import(&world, &[file]);
    assert_eq!(code, Some(3), "{errors}");
    let mut expected = offline.clone();
    expected[0]["capture"] = online[0]["capture"].clone();
    assert_eq!(online, expected, "the report through the daemon");
    assert_eq!(online[0]["missing"], 40, "{online}");
    let (code, again, errors) = import(&world, &[file]);
    assert_eq!(code, Some(3), "{errors}");
    expected[0]["new"] = json!(false);
    assert_eq!(again, expected, "the same recording is the same capture");
    let (code, second, errors) = import(&world, &[packed.to_str().unwrap(), "--name", "packed"]);
    assert_eq!(code, Some(3), "{errors}");
    assert_eq!((&second[0]["samples"], &second[0]["new"]), (&online[0]["samples"], &json!(true)));
    let capture = world.get("/v1/captures/packed");
    assert_eq!((capture["state"].as_str(), capture["missing"].as_u64()), (Some("imported"), Some(40)));

    // Refusals are the same as without a daemon: by exit code, and by the name that the user knows.
    std::fs::write(world.path("nonsense.txt"), "this is no recording\n".repeat(200)).unwrap();
    let nonsense = world.path("nonsense.txt");
    let (code, _, errors) = import(&world, &[nonsense.to_str().unwrap()]);
    assert_eq!((code, import(&alone, &[nonsense.to_str().unwrap()]).0), (Some(1), Some(1)), "{errors}");
    assert!(errors.contains("nonsense.txt") && !errors.contains(".import-"), "{errors}");
    let (code, _, errors) = import(&world, &[world.path("absent.csv").to_str().unwrap()]);
    assert_eq!(code, Some(74), "{errors}");
    std::fs::write(world.path("third.csv"), csv.replace("red", "green")).unwrap();
    let (code, _, errors) = import(&world, &[world.path("third.csv").to_str().unwrap(), "--name", "packed"]);
    assert_eq!(code, Some(1), "{errors}");
    assert!(errors.contains("packed"), "{errors}");
    // A body that is cut off leaves no trace.
    let head =
        "POST /v1/imports HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/csv\r\nContent-Length: 100000\r\n\r\n";
    let cut = sent(&world, &[head.as_bytes(), &csv.as_bytes()[..50_000]].concat()).unwrap();
    std::thread::sleep(Duration::from_millis(200));
    drop(cut);
    let free = || {
        let left = std::fs::read_dir(world.path("data")).unwrap().flatten();
        (left.filter(|entry| entry.file_name().to_string_lossy().starts_with(".import-")).count() == 0).then_some(())
    };
    world.until("nothing is left of it", Duration::from_secs(5), free, &daemon);
    assert_eq!(world.get("/v1/captures")["captures"].as_array().unwrap().len(), 3);
    nothing_missing(&world);
    // Without a daemon that answers, the lock alone decides.
    let (code, _, errors) = {
        std::fs::write(world.path("vn100d.toml"), "[http]\nlisten = \"127.0.0.1:9\"\n").unwrap();
        import(&world, &[file])
    };
    assert_eq!(code, Some(73), "{errors}");
    drop(daemon);
    settle(&world);
}
