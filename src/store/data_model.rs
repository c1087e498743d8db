//! The queries of docs/data-model.md, run as they are written there.

use super::tests::World;
use imu_core::sample::{ConnectedSensor, Record};
use rusqlite::Connection;

const DOCUMENT: &str = include_str!("../../docs/data-model.md");

fn queries() -> Vec<&'static str> {
    DOCUMENT.split("```sql\n").skip(1).filter_map(|rest| rest.split("```").next()).collect()
}

fn rows(connection: &Connection, sql: &str) -> usize {
    let mut statement = connection.prepare(sql).unwrap_or_else(|error| panic!("{error}: {sql}"));
    let mut rows = statement.query([]).unwrap();
    let mut count = 0;
    while rows.next().unwrap_or_else(|error| panic!("{error}: {sql}")).is_some() {
        count += 1;
    }
    count
}

#[test]
fn every_query_of_the_data_model_runs_and_finds_what_is_there() {
    let world = World::new();
    let id = world.capturing();
    assert_eq!(id, 1);
    let sensor = ConnectedSensor { serial_number: Some("0100012345".to_owned()), ..ConnectedSensor::default() };
    world.send(id, [Record::Configuration(Box::new(sensor))]);
    world.send(id, super::tests::a_capture());
    world.store.flush_blocking().unwrap();
    let job = super::NewJob::new(super::JobKind::Noise, id, serde_json::json!({}));
    let job = world.store.submit_job(job, u64::MAX).unwrap().0.id;
    world.store.claim_job().unwrap();
    let body = r#"{"channels": {"gyro_x": {"N": {"value": 1.2e-4}}}}"#;
    world.store.finish_job(job, body.to_owned()).unwrap();
    let reader = world.reader();
    let queries = queries();
    assert!(queries.len() >= 11, "{}", queries.len());
    for sql in queries {
        let found = rows(&reader.connection, sql);
        if sql.contains("rows_there") || sql.contains("received <>") {
            assert_eq!(found, 0, "the counters agree: {sql}");
        } else {
            assert!(found > 0, "{sql}");
        }
    }
}

#[test]
fn every_table_and_every_column_of_a_sample_is_described() {
    let world = World::new();
    let connection = &world.reader().connection;
    let names = |sql: &str| -> Vec<String> {
        let mut statement = connection.prepare(sql).unwrap();
        statement.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect()
    };
    let mut described = names("SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite_%'");
    for table in ["sample", "capture", "segment", "gap"] {
        described.extend(names(&format!("SELECT name FROM pragma_table_info('{table}')")));
    }
    for name in described {
        let plain = ["capture_id", "gap_id"].contains(&name.as_str());
        assert!(
            plain || DOCUMENT.contains(&format!("`{name}`")) || DOCUMENT.contains(&format!("### {name}")),
            "{name}"
        );
    }
}
