//! Rejected lines between two samples, placed by their stamps.
//!
//! A spliced line fails its checksum, but its stamp was written by another program and still shows when a sample was
//! taken. Steps are counted from stamp to stamp, so that a hole beside a rejected line is exactly that hole.

/// Rejected lines whose stamps are kept; further ones between two samples are only counted.
const PLACED_MAX: usize = 1000;

/// The lines rejected since the last sample.
#[derive(Debug, Clone, Default)]
pub(super) struct Between {
    /// Stamp, ns, and whether the line failed its checksum; increasing.
    placed: Vec<(i64, bool)>,
    /// Lines without a usable stamp.
    pub(super) unplaced: u64,
    /// Whether a line without a usable stamp failed its checksum.
    pub(super) unplaced_checksum: bool,
}

/// One of the stamps from the sample before to the sample behind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Instant {
    pub(super) stamp_ns: i64,
    /// `None` for the sample behind, else whether the rejected line failed its checksum.
    pub(super) rejected: Option<bool>,
}

impl Between {
    pub(super) fn add(&mut self, stamp_ns: Option<i64>, checksum: bool) {
        match stamp_ns {
            Some(stamp_ns)
                if self.placed.len() < PLACED_MAX && self.placed.last().is_none_or(|(last, _)| *last < stamp_ns) =>
            {
                self.placed.push((stamp_ns, checksum));
            }
            _ => {
                self.unplaced += 1;
                self.unplaced_checksum |= checksum;
            }
        }
    }

    /// Returns the number of lines.
    pub(super) fn count(&self) -> u64 {
        self.placed.len() as u64 + self.unplaced
    }

    /// Returns whether a line failed its checksum.
    pub(super) fn any_checksum(&self) -> bool {
        self.unplaced_checksum || self.placed.iter().any(|(_, checksum)| *checksum)
    }

    /// Drops lines whose stamps do not lie between the samples' stamps: those stamps are wrong.
    pub(super) fn settle(&mut self, from_ns: i64, to_ns: i64) {
        let before = self.placed.len();
        let mut misplaced_checksum = false;
        self.placed.retain(|(stamp_ns, checksum)| {
            let inside = (from_ns..to_ns).contains(stamp_ns) && *stamp_ns > from_ns;
            misplaced_checksum |= !inside && *checksum;
            inside
        });
        self.unplaced += (before - self.placed.len()) as u64;
        self.unplaced_checksum |= misplaced_checksum;
    }

    /// Returns the stamps up to the sample at `to_ns`.
    pub(super) fn instants(&self, to_ns: i64) -> impl Iterator<Item = Instant> + '_ {
        let placed = self.placed.iter().map(|(stamp_ns, checksum)| (*stamp_ns, Some(*checksum)));
        placed.chain([(to_ns, None)]).map(|(stamp_ns, rejected)| Instant { stamp_ns, rejected })
    }

    pub(super) fn clear(&mut self) {
        self.placed.clear();
        (self.unplaced, self.unplaced_checksum) = (0, false);
    }
}
