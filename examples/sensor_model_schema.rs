//! Prints the JSON Schema of sensor models: `cargo run --example sensor_model_schema > docs/sensor-model.schema.json`.

fn main() {
    println!("{:#}", vn100d::simulator::model::schema::schema());
}
