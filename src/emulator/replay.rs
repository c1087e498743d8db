//! Replay: sends recorded raw lines instead of a simulated stream, unchanged. Pure but for the iterator that feeds it.
//!
//! The recording begins once the host has stopped sending commands: from then on the host listens, and no line is lost.

/// Silence of the host after which the recording begins, ns of real time.
const QUIET_NS: u64 = 100_000_000;
/// A host that sends no command gets the recording after this time, ns.
const UNASKED_NS: u64 = 10_000_000_000;
/// Internal ticks per second.
const TICKS_PER_SECOND: f64 = 800.0;

/// A recording that is being replayed.
pub struct Replay {
    lines: Box<dyn Iterator<Item = Vec<u8>> + Send>,
    /// The line that is sent next.
    next: Option<Vec<u8>>,
    asked_ns: Option<u64>,
    first_ns: Option<u64>,
    /// Tick of the first line and number of lines sent.
    start: Option<(u64, u64)>,
    /// How much faster than real time the clock runs: hosts need real time.
    speed: f64,
}

impl Replay {
    /// Creates a recording of these lines, without their line ends, at `speed` times real time.
    pub fn new(mut lines: Box<dyn Iterator<Item = Vec<u8>> + Send>, speed: f64) -> Self {
        let next = lines.next();
        Self { lines, next, asked_ns: None, first_ns: None, start: None, speed: speed.max(1.0) }
    }

    /// Records that the host sent a command.
    pub fn on_command(&mut self, now_ns: u64) {
        self.asked_ns = Some(now_ns);
    }

    /// Returns the tick at which the next line is due, if the recording has begun and has not ended.
    pub fn next_tick(&mut self, tick: u64, rate_hz: f64, now_ns: u64) -> Option<u64> {
        self.next.as_ref()?;
        let first_ns = *self.first_ns.get_or_insert(now_ns);
        let begun = match (self.start, self.asked_ns) {
            (Some(_), _) => true,
            (None, Some(asked_ns)) => now_ns >= asked_ns + (QUIET_NS as f64 * self.speed) as u64,
            (None, None) => now_ns >= first_ns + (UNASKED_NS as f64 * self.speed) as u64,
        };
        if !begun {
            return None;
        }
        let (start, sent) = *self.start.get_or_insert((tick, 0));
        Some(start + (sent as f64 * TICKS_PER_SECOND / rate_hz).round() as u64)
    }

    /// Sends the next line.
    pub fn emit(&mut self, out: &mut Vec<u8>) {
        if let Some(line) = std::mem::replace(&mut self.next, self.lines.next()) {
            out.extend_from_slice(&line);
            out.extend_from_slice(b"\r\n");
            if let Some((_, sent)) = &mut self.start {
                *sent += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_waits_for_the_host_and_keeps_its_rate() {
        let lines: Vec<Vec<u8>> = (0..3).map(|line| format!("$VNYPR,{line}").into_bytes()).collect();
        let mut replay = Replay::new(Box::new(lines.into_iter()), 1.0);
        assert_eq!(replay.next_tick(0, 40.0, 0), None);
        replay.on_command(1_000_000_000);
        assert_eq!(replay.next_tick(800, 40.0, 1_000_000_000 + QUIET_NS - 1), None);
        let mut out = Vec::new();
        let mut ticks = Vec::new();
        while let Some(tick) = replay.next_tick(1000, 40.0, 1_000_000_000 + QUIET_NS) {
            ticks.push(tick);
            replay.emit(&mut out);
        }
        assert_eq!(ticks, [1000, 1020, 1040]);
        assert_eq!(out, b"$VNYPR,0\r\n$VNYPR,1\r\n$VNYPR,2\r\n");
    }

    #[test]
    fn a_host_that_never_talks_gets_the_recording_all_the_same() {
        let mut replay = Replay::new(Box::new(std::iter::once(b"x".to_vec())), 1.0);
        assert_eq!(replay.next_tick(0, 40.0, 5), None);
        assert_eq!(replay.next_tick(8000, 40.0, UNASKED_NS + 5), Some(8000));
    }
}
