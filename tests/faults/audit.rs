//! Audit: what every fault test ends in. Nothing lost silently, nothing torn, nothing leaked.
