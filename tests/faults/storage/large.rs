//! A large database answers as quickly as a small one (row C11).

use super::*;
use crate::tools;

/// Row C11.
#[test]
fn a_large_database_answers_as_quickly_as_a_small_one() {
    let world = World::new();
    let begun = Instant::now();
    build(&world.database(), tools::scaled(50, 1221), 8192);
    // More captures than fit on a page.
    {
        let connection = rusqlite::Connection::open(world.database()).unwrap();
        let rows = connection
            .execute(
                "INSERT INTO capture (name, source, state, created_utc_ns, software) WITH RECURSIVE n(i) AS \
                 (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < ?1) SELECT 'c' || i, 'x', 'stopped', i, 'x' FROM n",
                [tools::scaled(2000, 20_000)],
            )
            .unwrap();
        assert!(rows >= 2000);
    }
    println!("built in {:?}: {} bytes", begun.elapsed(), world.database().metadata().unwrap().len());
    let _sensor = world.emulate(FAST);
    let begun = Instant::now();
    let mut daemon = start(&world, &[], "", &["--capture", "1h"]);
    println!("answers after {:?}", begun.elapsed());
    until_committed(&world, 40, START, &daemon);
    println!("samples on disk after {:?}", begun.elapsed());
    let watch = Watch::start(&world);
    let agent: ureq::Agent = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(20))).build().into();
    let mut took: Vec<Duration> = (0..50)
        .map(|_| {
            let begun = Instant::now();
            let url = format!("{}/v1/captures", world.url);
            agent.get(&url).call().unwrap().body_mut().read_to_string().unwrap();
            begun.elapsed()
        })
        .collect();
    took.sort_unstable();
    println!("first page of captures: median {:?}, slowest {:?}", took[25], took[49]);
    assert!(took[25] <= Duration::from_millis(200), "{took:?}");
    watch.settle();
    stop_and_settle(&world, &mut daemon);
}
