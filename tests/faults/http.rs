//! HTTP under abuse (rows E1 to E7).
