//! Image: the pages of a database file as its last commit left them, including the log, read without SQLite and without
//! a write.
//!
//! # Source
//! "Database File Format", sqlite.org/fileformat2.html: the header (1.3), the write-ahead log (4). In the log a frame's
//! checksum continues from the one before. It is taken from that frame's header, not computed, so that only the damaged
//! frame is skipped.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

const LOG_HEADER: usize = 32;
const FRAME_HEADER: usize = 24;
/// The page size if the header is damaged: SQLite's default, which this program never changes.
const PAGE_SIZE: usize = 4096;

/// A database file and the newer pages in its log.
#[derive(Debug)]
pub(super) struct Image {
    file: File,
    log: Option<File>,
    /// Pages whose newest committed version is in the log, and its offset there.
    newer: BTreeMap<u32, u64>,
    pub(super) page_size: usize,
    pub(super) pages: u32,
    /// Frames of the log that fail their checksum.
    pub(super) damaged_frames: u64,
    /// Whether some pages are pointer maps.
    has_pointer_maps: bool,
}

impl Image {
    pub(super) fn open(path: &Path, log: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        let mut image = Self {
            file,
            log: None,
            newer: BTreeMap::new(),
            page_size: PAGE_SIZE,
            pages: 0,
            damaged_frames: 0,
            has_pointer_maps: false,
        };
        let mut header = [0; 100];
        if length >= 100 && image.file.read_exact_at(&mut header, 0).is_ok() && header.starts_with(b"SQLite format 3\0")
        {
            let size = match u16::from_be_bytes([header[16], header[17]]) {
                1 => 65_536,
                size => usize::from(size),
            };
            if size.is_power_of_two() && (512..=65_536).contains(&size) {
                image.page_size = size;
            }
        }
        image.pages = u32::try_from(length / image.page_size as u64).unwrap_or(u32::MAX);
        if let Ok(log) = File::open(log) {
            image.take_log(log)?;
        }
        image.has_pointer_maps = image.page(1).is_some_and(|page| u32_at(&page, 52) > 0);
        Ok(image)
    }

    /// Records where the log has newer pages, up to the last complete commit.
    fn take_log(&mut self, log: File) -> io::Result<()> {
        let length = log.metadata()?.len();
        let mut header = [0; LOG_HEADER];
        if length < LOG_HEADER as u64 {
            return Ok(());
        }
        log.read_exact_at(&mut header, 0)?;
        let big_endian = match u32_at(&header, 0) {
            0x377f_0682 => false,
            0x377f_0683 => true,
            _ => return Ok(()),
        };
        let page_size = u32_at(&header, 8) as usize;
        if !page_size.is_power_of_two() || !(512..=65_536).contains(&page_size) {
            return Ok(());
        }
        self.page_size = page_size;
        let salts = [u32_at(&header, 16), u32_at(&header, 20)];
        let mut seed = [u32_at(&header, 24), u32_at(&header, 28)];
        let mut pending = BTreeMap::new();
        let mut damaged = 0;
        let mut frame = vec![0; FRAME_HEADER + page_size];
        let mut at = LOG_HEADER as u64;
        while at + frame.len() as u64 <= length {
            log.read_exact_at(&mut frame, at)?;
            // Frames of an earlier cycle of the log follow its end.
            if [u32_at(&frame, 8), u32_at(&frame, 12)] != salts {
                break;
            }
            let sum = checksum(&frame[FRAME_HEADER..], checksum(&frame[..8], seed, big_endian), big_endian);
            let stored = [u32_at(&frame, 16), u32_at(&frame, 20)];
            let (page, pages_after) = (u32_at(&frame, 0), u32_at(&frame, 4));
            if sum == stored && page > 0 {
                pending.insert(page, at + FRAME_HEADER as u64);
                if pages_after > 0 {
                    self.newer.append(&mut pending);
                    self.pages = pages_after;
                    self.damaged_frames += std::mem::take(&mut damaged);
                }
            } else {
                damaged += 1;
            }
            seed = stored;
            at += frame.len() as u64;
        }
        self.log = Some(log);
        Ok(())
    }

    /// Returns whether a page is a pointer map, which holds no rows and may begin as a page of rows does (fileformat2, 1.8).
    pub(super) fn is_pointer_map(&self, number: u32) -> bool {
        let size = self.page_size as u64;
        let every = size / 5 + 1;
        // The page of the file's locks is never used.
        let lock_page = (1 << 30) / size + 1;
        let map = number.checked_sub(2).map(|after| u64::from(after) / every * every + 2);
        self.has_pointer_maps && map.is_some_and(|map| u64::from(number) == map + u64::from(map == lock_page))
    }

    /// Returns a page, counted from 1; `None` if it cannot be read.
    pub(super) fn page(&self, number: u32) -> Option<Vec<u8>> {
        if number == 0 {
            return None;
        }
        let mut page = vec![0; self.page_size];
        match (self.newer.get(&number), &self.log) {
            (Some(at), Some(log)) => log.read_exact_at(&mut page, *at).ok()?,
            _ => {
                let at = u64::from(number - 1) * self.page_size as u64;
                self.file.read_exact_at(&mut page, at).ok()?;
            }
        }
        Some(page)
    }
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..at + 4).and_then(|four| four.try_into().ok()).map_or(0, u32::from_be_bytes)
}

/// Returns the log's checksum (fileformat2, 4.2): over pairs of 32-bit words in the byte order that the header states.
fn checksum(bytes: &[u8], seed: [u32; 2], big_endian: bool) -> [u32; 2] {
    let [mut s0, mut s1] = seed;
    for pair in bytes.chunks_exact(8) {
        let word = |at: usize| {
            let four = [pair[at], pair[at + 1], pair[at + 2], pair[at + 3]];
            if big_endian { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) }
        };
        s0 = s0.wrapping_add(word(0)).wrapping_add(s1);
        s1 = s1.wrapping_add(word(4)).wrapping_add(s0);
    }
    [s0, s1]
}
