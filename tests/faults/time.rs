//! Time: stepped, slewed, unset, suspended (rows D1 to D5).
