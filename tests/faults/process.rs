//! The process and its host: killed, stopped, out of memory, upgraded (rows A1 to A10).
