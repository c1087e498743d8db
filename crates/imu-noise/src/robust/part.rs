//! Parts: a channel's samples without gaps, with the time at which each part begins.

use std::ops::Range;

/// Samples of one channel without a gap between them, in the channel's unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Time of the first sample, s since the start of the capture.
    pub start_s: f64,
    /// The samples; finite.
    pub values: Vec<f64>,
}

impl Part {
    /// Returns the time of sample `index`, s since the start of the capture.
    pub(super) fn time_s(&self, index: usize, rate_hz: f64) -> f64 {
        self.start_s + index as f64 / rate_hz
    }
}

/// Samples of a portion of a record.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Portion {
    /// The parts, in order of time. Each is independent, however close the next one is.
    pub parts: Vec<Part>,
    /// Whether the first sample continues the last stretch of the portion before.
    pub continues: bool,
}

/// Returns the intervals (s, sorted, disjoint) that overlap a part.
fn reaching<'a>(
    part: &Part,
    intervals: &'a [(f64, f64)],
    rate_hz: f64,
) -> impl Iterator<Item = &'a (f64, f64)> + use<'a> {
    let (start_s, end_s) = (part.start_s, part.time_s(part.values.len(), rate_hz));
    let first = intervals.partition_point(|(_, to_s)| *to_s < start_s);
    intervals.get(first..).unwrap_or_default().iter().take_while(move |(from_s, _)| *from_s < end_s)
}

/// Cuts the intervals (s, sorted, disjoint) out of parts; remainders of fewer than two samples are left out.
pub fn without_intervals(parts: &[Part], intervals: &[(f64, f64)], rate_hz: f64) -> Vec<Part> {
    let mut kept = Vec::new();
    for part in parts {
        let length = part.values.len();
        let index = |time_s: f64| ((time_s - part.start_s) * rate_hz).clamp(0.0, length as f64);
        let mut from = 0;
        for (begin_s, end_s) in reaching(part, intervals, rate_hz) {
            let (begin, end) = (index(*begin_s).ceil() as usize, (index(*end_s).floor() as usize + 1).min(length));
            if begin >= length || end <= from {
                continue;
            }
            push(&mut kept, part, from..begin.max(from), rate_hz);
            from = end;
        }
        push(&mut kept, part, from..length, rate_hz);
    }
    kept
}

/// Replaces intervals (s, sorted, disjoint) inside a part by a straight line between the levels before and after. These
/// levels are means over a second, or over the length of the interval if that is longer. A part that lies inside an
/// interval entirely is left out.
pub fn bridged(parts: Vec<Part>, intervals: &[(f64, f64)], rate_hz: f64) -> Vec<Part> {
    parts.into_iter().filter_map(|part| bridge(part, intervals, rate_hz)).collect()
}

fn bridge(mut part: Part, intervals: &[(f64, f64)], rate_hz: f64) -> Option<Part> {
    let reach = (rate_hz.round() as usize).max(4);
    let last = part.values.len();
    let start_s = part.start_s;
    let rows = |(begin_s, end_s): &(f64, f64)| {
        let from = (((begin_s - start_s) * rate_hz).ceil().max(0.0) as usize).min(last);
        from..(((end_s - start_s) * rate_hz).floor().max(0.0) as usize + 1).min(last)
    };
    let disturbed: Vec<Range<usize>> = reaching(&part, intervals, rate_hz).map(rows).collect();
    let mut undisturbed_from = 0;
    for (index, Range { start: from, end: to }) in disturbed.iter().cloned().enumerate() {
        let mean = |range: Range<usize>| {
            let count = range.len();
            (count > 0).then(|| part.values[range].iter().sum::<f64>() / count as f64)
        };
        // The samples inside the neighbouring intervals are not a level.
        let disturbed_from = disturbed.get(index + 1).map_or(last, |next| next.start);
        // A long bridge uses as many samples for its levels; otherwise the white noise of its ends would look like a
        // slow change.
        let reach = reach.max(to.saturating_sub(from));
        let before = mean(from.saturating_sub(reach).max(undisturbed_from).min(from)..from);
        let after = mean(to..(to + reach).min(disturbed_from).max(to));
        // Between two touching intervals there is no level: the bridge before ends at a level.
        let before = before.or(after).or_else(|| from.checked_sub(1).map(|end| part.values[end]));
        let (before, after) = before.zip(after.or(before))?;
        undisturbed_from = to;
        let count = (to.saturating_sub(from) + 1) as f64;
        for (index, value) in part.values[from.min(to)..to].iter_mut().enumerate() {
            *value = before + (after - before) * (index as f64 + 1.0) / count;
        }
    }
    Some(part)
}

fn push(kept: &mut Vec<Part>, part: &Part, range: Range<usize>, rate_hz: f64) {
    if range.len() >= 2 {
        let start_s = part.time_s(range.start, rate_hz);
        kept.push(Part { start_s, values: part.values[range].to_vec() });
    }
}

/// Returns the samples `range` of parts, counted over all parts in order.
pub fn samples_of(parts: &[Part], range: &Range<usize>, rate_hz: f64) -> Portion {
    let mut first = 0;
    let mut found = Portion::default();
    for part in parts {
        let within = |number: usize| number.saturating_sub(first).min(part.values.len());
        let of = within(range.start)..within(range.end);
        if !of.is_empty() {
            found.continues |= found.parts.is_empty() && of.start > 0;
            found.parts.push(Part { start_s: part.time_s(of.start, rate_hz), values: part.values[of].to_vec() });
        }
        first += part.values.len();
    }
    found
}

/// Determines whether the first part of a portion continues the last one of the portion before. It does if a record is
/// read in portions, unless the part's beginning or the other's end was removed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Seam {
    end_s: Option<f64>,
}

impl Seam {
    /// Returns, for every part, whether it continues the one before it, and remembers the end of the last part.
    pub(super) fn joins<'a>(
        &mut self,
        parts: &'a [Part],
        continues: bool,
        rate_hz: f64,
    ) -> impl Iterator<Item = (&'a Part, bool)> + use<'a> {
        let before = self.end_s;
        if let Some(last) = parts.last() {
            self.end_s = Some(last.time_s(last.values.len(), rate_hz));
        }
        parts.iter().enumerate().map(move |(index, part)| {
            let close = before.is_some_and(|end_s| (part.start_s - end_s).abs() < 0.5 / rate_hz);
            (part, index == 0 && continues && close)
        })
    }
}

/// A channel's level: means over some samples. Slow changes need no more data, for any length of the record.
#[derive(Debug, Clone)]
pub struct Levels {
    per_level: usize,
    samples_hz: f64,
    parts: Vec<Part>,
    seam: Seam,
    /// Sum and count of the present level, and whether it continues with the last part.
    open: (f64, usize, bool),
}

impl Levels {
    /// Minimum number of levels per second, if samples come faster and there are not too many.
    const RATE_HZ: f64 = 20.0;
    /// Maximum number of levels of a record.
    const MOST: u64 = 1 << 20;

    /// Creates levels for a record of `samples` samples.
    pub fn new(rate_hz: f64, samples: u64) -> Self {
        let least = usize::try_from(samples.div_ceil(Self::MOST)).unwrap_or(usize::MAX);
        let per_level = ((rate_hz / Self::RATE_HZ).floor() as usize).max(least).max(1);
        Self { per_level, samples_hz: rate_hz, parts: Vec::new(), seam: Seam::default(), open: (0.0, 0, false) }
    }

    /// Returns the number of levels per second.
    pub(super) fn rate_hz(&self) -> f64 {
        self.samples_hz / self.per_level as f64
    }

    /// Returns the levels; no part is empty.
    pub(super) fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Returns the levels without some times.
    pub(super) fn without(&self, intervals: &[(f64, f64)]) -> Vec<Part> {
        without_intervals(&self.parts, intervals, self.rate_hz())
    }

    /// Takes the next samples, in order of time; `continues` has the meaning of [`Portion::continues`]. Samples at the
    /// end of a stretch that are too few for a level are left out.
    pub fn push(&mut self, parts: &[Part], continues: bool) {
        for (part, joins) in self.seam.joins(parts, continues, self.samples_hz) {
            if !joins {
                self.open = (0.0, 0, false);
            }
            for (index, value) in part.values.iter().enumerate() {
                self.open.0 += value;
                self.open.1 += 1;
                if self.open.1 < self.per_level {
                    continue;
                }
                let level = self.open.0 / self.per_level as f64;
                match self.parts.last_mut().filter(|_| self.open.2) {
                    Some(last) => last.values.push(level),
                    None => {
                        let middle_s = 0.5 * (self.per_level - 1) as f64 / self.samples_hz;
                        let start_s = part.time_s(index, self.samples_hz) - middle_s;
                        self.parts.push(Part { start_s, values: vec![level] });
                    }
                }
                self.open = (0.0, 0, true);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_cut_out_and_nothing_else() {
        let part = Part { start_s: 10.0, values: (0..100).map(f64::from).collect() };
        let kept = without_intervals(std::slice::from_ref(&part), &[(0.0, 9.9), (12.0, 13.0), (19.0, 40.0)], 10.0);
        assert_eq!(kept.len(), 2);
        assert_eq!((kept[0].start_s, kept[0].values.len()), (10.0, 20));
        assert_eq!(kept[1].values[0], 31.0);
        assert!((kept[1].start_s - 13.1).abs() < 1e-12);
        assert_eq!(kept[1].values.last(), Some(&89.0));
        assert_eq!(without_intervals(std::slice::from_ref(&part), &[], 10.0), std::slice::from_ref(&part));
        assert!(without_intervals(&[part], &[(0.0, 100.0)], 10.0).is_empty());
    }

    #[test]
    fn a_bridge_joins_the_levels_of_its_ends() {
        let mut values = vec![1.0; 50];
        values.extend([900.0; 5]);
        values.extend([2.0; 45]);
        let parts = bridged(vec![Part { start_s: 3.0, values }], &[(8.0, 8.4)], 10.0);
        assert_eq!(parts[0].values[49], 1.0);
        assert!((parts[0].values[52] - 1.5).abs() < 1e-12);
        assert_eq!(parts[0].values[55], 2.0);
    }

    #[test]
    fn a_bridge_takes_no_level_from_the_disturbance_beside_it() {
        let mut values = vec![0.0; 400];
        values[100..110].fill(50.0);
        values[114..300].fill(900.0);
        values[301..310].fill(-70.0);
        let rate_hz = 10.0;
        let intervals = [(10.0, 10.95), (11.4, 29.95), (30.1, 30.45), (30.5, 30.95)];
        let parts = bridged(vec![Part { start_s: 0.0, values }], &intervals, rate_hz);
        assert!(parts[0].values.iter().all(|value| *value == 0.0), "{:?}", parts[0].values);
    }

    #[test]
    fn a_part_inside_an_interval_is_left_out() {
        let parts =
            [(0.0, 1.0), (10.0, 9.0), (20.0, 1.0)].map(|(start_s, value)| Part { start_s, values: vec![value; 50] });
        let kept = bridged(parts.to_vec(), &[(9.0, 16.0)], 10.0);
        assert_eq!(kept.iter().map(|part| part.start_s).collect::<Vec<_>>(), [0.0, 20.0]);
        assert!(kept.iter().all(|part| part.values.iter().all(|value| *value == 1.0)));
    }

    #[test]
    fn levels_are_the_same_however_the_samples_come() {
        let values: Vec<f64> = (0..1000).map(|i| f64::from(i % 37)).collect();
        let of =
            |from: usize, to: usize| Part { start_s: 5.0 + from as f64 / 100.0, values: values[from..to].to_vec() };
        let mut whole = Levels::new(100.0, 1000);
        whole.push(&[of(0, 403), of(500, 1000)], false);
        let mut pieces = Levels::new(100.0, 1000);
        for (from, to, continues) in
            [(0, 1, false), (1, 399, true), (399, 403, true), (450, 454, false), (500, 502, false), (502, 1000, true)]
        {
            pieces.push(&[of(from, to)], continues);
        }
        assert_eq!((whole.rate_hz(), whole.parts()), (20.0, pieces.parts()), "four samples are less than a level");
        // A stretch that begins at another one's end is still another stretch.
        let mut apart = Levels::new(100.0, 1000);
        apart.push(&[of(0, 400), of(400, 403)], false);
        apart.push(&[of(500, 700)], true);
        apart.push(&[of(700, 1000)], false);
        assert_eq!(apart.parts().len(), 3);
        assert_eq!(whole.parts().iter().map(|part| part.values.len()).collect::<Vec<_>>(), [80, 100]);
        assert_eq!(whole.parts()[0].values[0], 2.0);
        assert!((whole.parts()[1].start_s - 10.02).abs() < 1e-12);
        // The number of levels is limited for records of any length.
        assert_eq!(Levels::new(100.0, 1 << 40).per_level, 1 << 20);
    }

    #[test]
    fn samples_are_counted_over_all_parts() {
        let parts =
            [Part { start_s: 0.0, values: vec![1.0, 2.0, 3.0] }, Part { start_s: 9.0, values: vec![4.0, 5.0, 6.0] }];
        let found = samples_of(&parts, &(1..5), 10.0);
        assert!(found.continues);
        assert_eq!(found.parts[0], Part { start_s: 0.1, values: vec![2.0, 3.0] });
        assert_eq!(found.parts[1], Part { start_s: 9.0, values: vec![4.0, 5.0] });
        assert!(!samples_of(&parts, &(3..5), 10.0).continues);
        assert!(samples_of(&parts, &(6..9), 10.0).parts.is_empty());
    }
}
