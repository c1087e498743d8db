//! Inputs that once failed.

/// Target, and the input as hex.
const FOUND: [(&str, &str); 3] = [
    // Durations went through `f64`: one of 158446744073709551616 ms was another when it was written and read again.
    ("faults", "306d20686f6c64203135383434363734343037333730393535313631366d73"),
    // A name of 3 GB in a schema of 30 bytes was given memory before it was found absent.
    ("mcap", "894d434150300d0a031e000000000000000100022b32c8000000000000000000000000000000000000000000000000"),
    // A row that ended with a carriage return and the one behind it were rejected as one.
    ("csv", "74696d655f732c6779726f5f785f7261645f730d3731303335383236370d2c310a373130333538323637372c33"),
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
