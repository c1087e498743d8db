//! Prints the JSON Schema of sensor models: `cargo run --example sensor_model_schema > docs/sensor-model.schema.json`.

fn main() {
    println!("{:#}", imu_model::simulator::model::schema::schema());
}
