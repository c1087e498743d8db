//! accounting

/// placeholder
#[derive(Debug)]
pub struct Accountant;
/// placeholder
#[derive(Debug)]
pub struct Observation;
