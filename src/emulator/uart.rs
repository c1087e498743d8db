//! Uart: computes the bytes that a receiver at one baud rate reads from bytes sent at another. Pure.

/// Bits of one byte on the line: start, eight data bits from the lowest, stop.
const BITS: usize = 10;

/// Returns the bytes that a receiver at `receiver_baud` reads from `bytes` sent without pause at `sent_baud`, with an
/// idle line before and after them. A byte whose stop bit is missing is read as 0, as a terminal does.
pub fn received(bytes: &[u8], sent_baud: u32, receiver_baud: u32) -> Vec<u8> {
    if sent_baud == receiver_baud || bytes.is_empty() {
        return bytes.to_vec();
    }
    // The first bit is the idle line.
    let bits = 1 + bytes.len() * BITS;
    let level = |bit: usize| match bit.checked_sub(1).map(|bit| (bytes.get(bit / BITS), bit % BITS)) {
        None | Some((None, _) | (_, 9)) => true,
        Some((_, 0)) => false,
        Some((Some(byte), bit)) => byte >> (bit - 1) & 1 == 1,
    };
    // Time is counted in bits of the sender.
    let ratio = f64::from(sent_baud) / f64::from(receiver_baud);
    let at = |time: f64| level(time as usize);
    let mut out = Vec::new();
    let mut time = 0.0_f64;
    loop {
        // A byte begins at a falling edge; if the line is low already, it must rise first.
        let mut bit = time as usize;
        while bit < bits && !level(bit) {
            bit += 1;
        }
        while bit < bits && level(bit) {
            bit += 1;
        }
        if bit >= bits {
            return out;
        }
        let sample = |index: usize| at(bit as f64 + (index as f64 + 0.5) * ratio);
        let byte = (0..8).fold(0_u8, |byte, index| byte | u8::from(sample(index + 1)) << index);
        out.push(if sample(9) { byte } else { 0 });
        time = bit as f64 + 9.5 * ratio;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_the_same_rate_everything_is_received() {
        assert_eq!(received(b"$VNRRG,01*72\r\n", 115_200, 115_200), b"$VNRRG,01*72\r\n");
        // 2 % is within a receiver's tolerance
        assert_eq!(received(b"$VNRRG,01*72\r\n", 117_000, 115_200), b"$VNRRG,01*72\r\n");
    }

    #[test]
    fn a_faster_receiver_hears_more_bytes_and_a_slower_one_fewer() {
        let bytes: Vec<u8> = (0..=255).collect();
        let more = received(&bytes, 115_200, 921_600).len();
        let fewer = received(&bytes, 921_600, 115_200).len();
        assert!(more > 256 && fewer < 256 / 4 && fewer > 0, "{more} {fewer}");
        // U is 01010101: at half the rate every two bits are read as one byte
        assert_eq!(received(b"U", 9600, 9600), b"U");
        assert_ne!(received(b"UUUU", 19_200, 9600), b"UUUU");
    }
}
