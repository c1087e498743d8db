//! The stream: reset, wrapped, at another rate or format, duplicated, held back (rows B9 to B12, B14, B15).
