//! Storage: full, failing, slow, read-only, locked, damaged, gone (rows C1 to C11).
