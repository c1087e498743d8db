//! Inputs that once failed.

/// Target, and the input as hex.
const FOUND: [(&str, &str); 5] = [
    // Durations went through `f64`: a duration of 158446744073709551616 ms changed when it was written and read again.
    ("faults", "306d20686f6c64203135383434363734343037333730393535313631366d73"),
    // A name of 3 GB in a schema of 30 bytes was allocated before it was found to be missing.
    ("mcap", "894d434150300d0a031e000000000000000100022b32c8000000000000000000000000000000000000000000000000"),
    // A row that ended with a carriage return and the one behind it were rejected as one.
    ("csv", "74696d655f732c6779726f5f785f7261645f730d3731303335383236370d2c310a373130333538323637372c33"),
    // The rounding had so many periods that one of its levels exceeded all integers.
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
    // The line through stamps that jump back and forth fell: the rate was below 0.
    (
        "csv",
        "74696d655f732c6779726f5f785f7261645f730a333538323637372c320d332c370a3335383236372e2c320d332c370a3335\
         383236372e2c320d332c370a3335383236372e2c320d332c370a3335383236372e2c320d332c370a3335383236372e2c320d\
         3335383236372e2c330d312c340d36372c330a312c340a3335383236372e2c320a312c340d372c330a312c340a372c330a31\
         2c340d372c330a312c340a352c360a312c340d372c330a312c340a372c330d312c340a372c330a312c340d372c330a312c34\
         0a372c330d312c340a372c330a312c340d372c330d312c340a352c330d312c370a35383236372c320a312c370a3538323637\
         2e2c320a312c370a35383236372e2c320a312c370a35383236372e2c320a312c370a3335383236372e2c320a312c370a3335\
         383236372e2c320a312c370a3335383236372e2c320a312c370a3335383236372e2c320a312c340a372c330a312c340a3335\
         383236372e2c320a312c340a3335383236372e2c320a312c340a352c390a3335383236372e2c32",
    ),
];

pub fn of(target: &str) -> Vec<Vec<u8>> {
    let bytes = |hex: &str| -> Vec<u8> {
        hex.as_bytes()
            .chunks(2)
            .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
            .collect()
    };
    let mut found: Vec<Vec<u8>> = FOUND.iter().filter(|(name, _)| *name == target).map(|(_, hex)| bytes(hex)).collect();
    if target == "csv" {
        // Found by `table` in an array: the length of a vector beyond all numbers was a NaN in a remark.
        let rows: String = (0..40).map(|row| format!("{row},1e200,1e200,{row}e200\n")).collect();
        found.push(format!("time_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2\n{rows}").into_bytes());
    }
    found
}
