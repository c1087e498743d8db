//! Salvage: reads the rows on the pages of a damaged database, table by table.
//!
//! The table of a page is known from the tree that contains it, or from the form of its rows if the path to it is
//! destroyed. Rows of small tables are kept; for samples only the places are kept.

use super::super::CaptureState;
use super::super::batch::{BatchRow, StoredRow};
use super::cells::{Kind, Page, get, named, parse};
use super::image::{Image, u32_at};
use imu_core::sample::{Channel, DiscardCause, GapCause, Timebase};
use rusqlite::types::Value;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};

/// Pages whose rows are cached.
const CACHED: usize = 64;

/// A row by its row id and columns.
pub(super) type Row = Vec<Value>;

/// The places of the samples of one capture.
#[derive(Debug, Default)]
pub(super) struct Places {
    /// First and last `seq` on a leaf page, and the page; sorted.
    leaves: Vec<(i64, i64, u32)>,
    /// `seq` of rows on interior pages, and the page.
    single: BTreeMap<i64, u32>,
}

/// All rows found in the file.
#[derive(Debug)]
pub(super) struct Salvage {
    pub(super) image: Image,
    pub(super) captures: BTreeMap<i64, Row>,
    pub(super) channels: Vec<Row>,
    pub(super) segments: BTreeMap<i64, BTreeMap<i64, Row>>,
    pub(super) gaps: BTreeMap<i64, Vec<Row>>,
    pub(super) rejected: Vec<Row>,
    pub(super) events: BTreeMap<i64, Row>,
    pub(super) configurations: BTreeMap<i64, Row>,
    pub(super) batches: BTreeMap<i64, BTreeMap<i64, BatchRow>>,
    pub(super) places: BTreeMap<i64, Places>,
    /// Pages that should hold rows and cannot be read.
    pub(super) damaged_pages: u64,
    /// Rows that cannot be read on pages that can.
    pub(super) damaged_rows: u64,
    cache: BTreeMap<u32, Vec<(i64, StoredRow)>>,
}

impl Salvage {
    pub(super) fn of(image: Image) -> Self {
        let mut salvage = Self {
            image,
            captures: BTreeMap::new(),
            channels: Vec::new(),
            segments: BTreeMap::new(),
            gaps: BTreeMap::new(),
            rejected: Vec::new(),
            events: BTreeMap::new(),
            configurations: BTreeMap::new(),
            batches: BTreeMap::new(),
            places: BTreeMap::new(),
            damaged_pages: 0,
            damaged_rows: 0,
            cache: BTreeMap::new(),
        };
        let owners = salvage.owners();
        let free = salvage.free_pages();
        for number in 1..=salvage.image.pages {
            let owner = owners.get(&number).map(String::as_str);
            // A damaged header may claim pointer maps: a page of a table is none.
            let is_map = owner.is_none() && salvage.image.is_pointer_map(number);
            if free.contains(&number) || is_map {
                continue;
            }
            match parse(&salvage.image, number) {
                Some(page) => salvage.take(number, page, owner),
                None if owner.is_some_and(|owner| owner != "index") => salvage.damaged_pages += 1,
                // An overflow page, or one so damaged that its type cannot be determined.
                None => {}
            }
        }
        for places in salvage.places.values_mut() {
            places.leaves.sort_unstable();
        }
        salvage
    }

    /// Returns the table of every page that can be reached from a root.
    fn owners(&self) -> BTreeMap<u32, String> {
        let mut owners = BTreeMap::new();
        let mut schema = BTreeSet::new();
        self.walk(1, &mut |number| schema.insert(number));
        for number in schema {
            owners.insert(number, "sqlite_schema".to_owned());
            for (_, row) in parse(&self.image, number).map(|page| page.rows).unwrap_or_default() {
                let (Some(kind), Some(name), Some(root)) =
                    (get::<String>(&row, 0), get::<String>(&row, 1), get::<u32>(&row, 3))
                else {
                    continue;
                };
                let name = if kind == "table" { &name } else { "index" };
                self.walk(root, &mut |number| {
                    let new = !owners.contains_key(&number);
                    if new {
                        owners.insert(number, name.to_owned());
                    }
                    new
                });
            }
        }
        owners
    }

    /// Visits the pages of a tree; `visit` returns whether a page is new.
    fn walk(&self, root: u32, visit: &mut impl FnMut(u32) -> bool) {
        let mut todo = vec![root];
        while let Some(number) = todo.pop() {
            if number == 0 || number > self.image.pages || !visit(number) {
                continue;
            }
            if let Some(page) = parse(&self.image, number) {
                todo.extend(page.children);
            }
        }
    }

    /// Returns the free pages: their content was deleted (fileformat2, 1.5).
    fn free_pages(&self) -> BTreeSet<u32> {
        let mut free = BTreeSet::new();
        let mut trunk = self.image.page(1).map_or(0, |page| u32_at(&page, 32));
        while trunk != 0 && trunk <= self.image.pages && free.insert(trunk) {
            let Some(page) = self.image.page(trunk) else { break };
            let leaves = (u32_at(&page, 4) as usize).min(page.len() / 4 - 2);
            free.extend((0..leaves).map(|index| u32_at(&page, 8 + 4 * index)));
            trunk = u32_at(&page, 0);
        }
        free
    }

    fn take(&mut self, number: u32, page: Page, owner: Option<&str>) {
        if owner == Some("sqlite_schema") || owner == Some("index") {
            return;
        }
        self.damaged_rows += page.damaged;
        let tree = matches!(page.kind, Kind::IndexLeaf | Kind::IndexInterior);
        let mut range: BTreeMap<i64, (i64, i64)> = BTreeMap::new();
        for (row_id, row) in page.rows {
            let is = |table: &str| owner.is_none_or(|owner| owner == table);
            if tree {
                if let Some((capture, sample)) = Some(&row).filter(|_| is("sample")).and_then(|row| sample_of(row)) {
                    if page.kind == Kind::IndexInterior {
                        self.places.entry(capture).or_default().single.insert(sample.seq, number);
                    } else {
                        let (first, last) = range.entry(capture).or_insert((sample.seq, sample.seq));
                        *first = sample.seq.min(*first);
                        *last = sample.seq.max(*last);
                    }
                } else if let Some(batch) = Some(&row).filter(|_| is("batch")).and_then(|row| batch_of(row)) {
                    self.batches.entry(batch.capture_id).or_default().entry(batch.first_seq).or_insert(batch);
                } else if is("segment") && is_segment(&row) {
                    if let (Some(capture), Some(segment)) = (get(&row, 0), get(&row, 1)) {
                        self.segments.entry(capture).or_default().entry(segment).or_insert(row);
                    }
                } else if is("rejected") && is_rejected(&row) {
                    self.rejected.push(row);
                } else if is("channel") && is_channel(&row) {
                    self.channels.push(row);
                } else if owner.is_some_and(|owner| ["sample", "batch", "segment"].contains(&owner)) {
                    self.damaged_rows += 1;
                }
            } else if is("capture") && is_capture(&row) {
                self.captures.entry(row_id).or_insert(row);
            } else if is("gap") && is_gap(&row) {
                if let Some(capture) = get(&row, 1) {
                    self.gaps.entry(capture).or_default().push(row);
                }
            } else if is("event") && is_event(&row) {
                self.events.entry(row_id).or_insert(row);
            } else if is("configuration") && is_configuration(&row) {
                self.configurations.entry(row_id).or_insert(row);
            } else if owner.is_some_and(|owner| ["capture", "gap", "event", "configuration"].contains(&owner)) {
                self.damaged_rows += 1;
            }
        }
        for (capture, (first, last)) in range {
            self.places.entry(capture).or_default().leaves.push((first, last, number));
        }
    }

    /// Returns the readable samples of `first..end`, by `seq`; several versions if a damaged row claims another's
    /// place.
    pub(super) fn samples(&mut self, capture: i64, first: i64, end: i64) -> BTreeMap<i64, Vec<StoredRow>> {
        let mut pages = BTreeSet::new();
        if let Some(places) = self.places.get(&capture) {
            // Leaves do not overlap, except stale ones: those that begin before `first` may reach into the range.
            let from = places.leaves.partition_point(|leaf| leaf.0 < first);
            let before = places.leaves[..from].iter().rev().take(8).filter(|leaf| leaf.1 >= first);
            pages.extend(before.map(|leaf| leaf.2));
            pages.extend(places.leaves[from..].iter().take_while(|leaf| leaf.0 < end).map(|leaf| leaf.2));
            pages.extend(places.single.range(first..end).map(|(_, page)| *page));
        }
        let mut found: BTreeMap<i64, Vec<StoredRow>> = BTreeMap::new();
        for page in pages {
            for (of, row) in self.rows_of(page) {
                if *of == capture && (first..end).contains(&row.seq) {
                    let versions = found.entry(row.seq).or_default();
                    if !versions.contains(row) {
                        versions.push(*row);
                    }
                }
            }
        }
        found
    }

    fn rows_of(&mut self, page: u32) -> &[(i64, StoredRow)] {
        if self.cache.len() > CACHED {
            self.cache.clear();
        }
        let image = &self.image;
        self.cache.entry(page).or_insert_with(|| {
            let rows = parse(image, page).map(|page| page.rows).unwrap_or_default();
            rows.iter().filter_map(|(_, row)| sample_of(row)).collect()
        })
    }

    /// Returns the `seq` after the last sample found.
    pub(super) fn end_of(&self, capture: i64) -> i64 {
        let Some(places) = self.places.get(&capture) else { return 0 };
        let leaf = places.leaves.iter().map(|leaf| leaf.1 + 1).max().unwrap_or(0);
        leaf.max(places.single.last_key_value().map_or(0, |(seq, _)| seq + 1))
    }
}

fn sample_of(row: &[Value]) -> Option<(i64, StoredRow)> {
    let mut sample = StoredRow {
        seq: get(row, 1).filter(|seq| *seq >= 0)?,
        segment_id: get(row, 2).filter(|segment| *segment > 0)?,
        device_time_ns: get(row, 3)?,
        host_mono_ns: get(row, 4)?,
        host_utc_ns: get(row, 5)?,
        sync_count: get(row, 6 + Channel::COUNT)?,
        ..StoredRow::default()
    };
    for (index, value) in sample.values.iter_mut().enumerate() {
        *value = get(row, 6 + index)?;
    }
    Some((get(row, 0)?, sample))
}

fn batch_of(row: &[Value]) -> Option<BatchRow> {
    let [capture_id, first_seq, count] = [get(row, 0)?, get(row, 1)?, get::<i64>(row, 2)?];
    let crc = get(row, 4)?;
    // A batch is a commit's or an import's step and never this large.
    let is_batch = row.len() == 5 && get::<i64>(row, 3).is_some() && (1..1_000_000).contains(&count) && first_seq >= 0;
    is_batch.then_some(BatchRow { capture_id, first_seq, count, crc })
}

fn integers(row: &[Value], columns: &[usize]) -> bool {
    columns.iter().all(|column| get::<i64>(row, *column).is_some())
}

fn is_json<T: DeserializeOwned>(row: &[Value], column: usize) -> bool {
    get::<String>(row, column).is_some_and(|json| serde_json::from_str::<T>(&json).is_ok())
}

fn is_capture(row: &[Value]) -> bool {
    let lifecycle = get::<String>(row, 4).unwrap_or_default();
    row.len() >= 22
        && get::<String>(row, 1).is_some()
        && named::<CaptureState>(row, 3).is_some()
        && ["live", "importing", "deleted"].contains(&lifecycle.as_str())
        && integers(row, &[5, 13, 14])
}

fn is_segment(row: &[Value]) -> bool {
    row.len() >= 12
        && integers(row, &[0, 1, 2, 3, 4])
        && get(row, 5).is_some_and(|rate_hz: f64| rate_hz.is_finite() && rate_hz > 0.0)
        && named::<Timebase>(row, 6).is_some()
        && is_json::<Vec<String>>(row, 7)
}

fn is_gap(row: &[Value]) -> bool {
    row.len() >= 10 && integers(row, &[1, 2, 3, 4, 7, 8]) && named::<GapCause>(row, 9).is_some()
}

fn is_rejected(row: &[Value]) -> bool {
    row.len() == 3 && integers(row, &[0, 2]) && named::<DiscardCause>(row, 1).is_some()
}

fn is_channel(row: &[Value]) -> bool {
    row.len() == 6 && integers(row, &[0]) && named::<Channel>(row, 1).is_some()
}

fn is_event(row: &[Value]) -> bool {
    row.len() >= 6 && integers(row, &[1, 2]) && [3, 4].into_iter().all(|column| get::<String>(row, column).is_some())
}

fn is_configuration(row: &[Value]) -> bool {
    row.len() >= 5 && integers(row, &[1, 2, 3]) && is_json::<serde_json::Value>(row, 4)
}
