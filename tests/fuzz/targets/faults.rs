//! The emulator's script of faults: accepted, or refused with its line; as many faults as lines that are not empty.

use vn100d::emulator::faults::{Schedule, parse_line};

pub fn refused_with_its_line(input: &[u8]) {
    let Ok(text) = std::str::from_utf8(input) else { return };
    let lines = text.lines().filter(|line| !line.split('#').next().unwrap_or_default().trim().is_empty()).count();
    match Schedule::parse(text, "fuzz.faults") {
        Err(error) => {
            let message = error.to_string();
            assert!(message.contains("fuzz.faults"), "{message}");
        }
        Ok(mut schedule) => {
            let mut found = 0;
            let mut tick = 0;
            while let Some(next) = schedule.next_tick() {
                assert!(next >= tick, "faults are in order");
                tick = next;
                let fault = schedule.due(tick).expect("it is due");
                // The text of a fault must be read as that fault.
                let again = parse_line(&fault.to_string(), "again", 1);
                assert_eq!(again.ok().flatten(), Some(fault));
                found += 1;
            }
            assert_eq!(found, lines);
        }
    }
}
