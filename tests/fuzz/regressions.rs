//! Inputs that once failed.

/// Target, and the input as hex.
const FOUND: [(&str, &str); 4] = [
    // Durations went through `f64`: one of 158446744073709551616 ms was another when it was written and read again.
    ("faults", "306d20686f6c64203135383434363734343037333730393535313631366d73"),
    // A name of 3 GB in a schema of 30 bytes was given memory before it was found absent.
    ("mcap", "894d434150300d0a031e000000000000000100022b32c8000000000000000000000000000000000000000000000000"),
    // A row that ended with a carriage return and the one behind it were rejected as one.
    ("csv", "74696d655f732c6779726f5f785f7261645f730d3731303335383236370d2c310a373130333538323637372c33"),
    // The rounding was so many periods that a level of it was beyond all integers.
    (
        "csv",
        "74696d655f732c2c616363656c5f7a5f6d5f73322c74656d70657261747572655f630a302c2c2c350a2e30352c2c372c0a30\
         2c2c382c0a352c2c372c0a302c2c2c350a352c2c372c0a302c2c2c350a302c2c372c0a302c2c2c350a352c2c372c0a302c2c\
         2c350a352c2c372c0a302c2c2c350a352c2c372c0a302c2c2c350a352c2c372c0a302c2c382c0a352c2c372c0a302c2c2c35\
         0a352c2c372c0a302c2c2c350a352c2c372c0a302c2c2c350a2e352c2c372c0a302c2c2c350a352c2c372c0a302c2c2c350a\
         302c2c372c0a302c2c2c350a352c2c372c0a302c2c2d392e382c32350a302c2c2d392e382c32350a2e30352c2c2c350a2e30\
         352c2c2d372c0a322c2c2c320a2e30352c2c2d372c0a302c2c382c0d2e30352c2c2d392e372c0a302c2c2c350a2e30352c2c\
         2d392e372c0a302c2c372c0a302c2c2c350a352c2c372c0a302c2c382c0a352c2c372c0a302c2c2c350a2e30352c2c2d392e\
         372c0a302c2c382c0d2e30352c2c2d392e372c0a302c2c2c350a2e30352c2c2d392e372c0a302c2c2c350d352c2c372c0a30\
         2c2c2c350a352c2c372c0a302c2c2c350a302c2c372c0a302c2c2c350a2e30352c2c2d392e372c0a302c2c382c0a2e30352c\
         2c2d392e372c0a302c2c2c350a352c2c372c0a2e30352c2c2c360a322c2c392c",
    ),
];

pub fn of(target: &str) -> Vec<Vec<u8>> {
    let bytes = |hex: &str| -> Vec<u8> {
        hex.as_bytes()
            .chunks(2)
            .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
            .collect()
    };
    FOUND.iter().filter(|(name, _)| *name == target).map(|(_, hex)| bytes(hex)).collect()
}
