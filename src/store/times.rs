//! The time of day, as rows contain it.

use serde::{Serialize, Serializer};

/// UTC in ns since 1970; written as RFC 3339 with nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, utoipa::ToSchema)]
#[schema(value_type = String, format = DateTime, example = "2026-11-21T20:00:00.000000000Z")]
pub struct UtcNs(pub i64);

impl std::fmt::Display for UtcNs {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&crate::clock::rfc3339(self.0))
    }
}

impl Serialize for UtcNs {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
