//! Figures: what is shared, counted since the start, for the status and the metrics.

use crate::observe::ShareStatus;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A counter.
#[derive(Debug, Default)]
pub(super) struct Count(AtomicU64);

impl Count {
    pub(super) fn add(&self, by: u64) {
        self.0.fetch_add(by, Ordering::Relaxed);
    }
    pub(super) fn set(&self, to: u64) {
        self.0.store(to, Ordering::Relaxed);
    }
    pub(super) fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
    /// Returns the count and sets it to zero.
    pub(super) fn take(&self) -> u64 {
        self.0.swap(0, Ordering::Relaxed)
    }
}

/// Texts that change seldom.
#[derive(Debug, Default)]
struct Texts {
    terminal: Option<String>,
    /// Why link and socket do not work.
    errors: [Option<String>; 2],
}

/// The two ways in which data is shared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    Link,
    Socket,
}

#[derive(Debug, Default)]
pub(super) struct Counts {
    /// Whether a program has the terminal open.
    pub(super) reading: Count,
    pub(super) bytes: Count,
    pub(super) dropped_bytes: Count,
    pub(super) ignored_bytes: Count,
    pub(super) clients: Count,
    pub(super) clients_refused: Count,
    pub(super) lines: Count,
    pub(super) lost_lines: Count,
    /// Samples that found no room, and that the clients do not know of yet.
    pub(super) missed: Count,
    texts: Mutex<Texts>,
}

/// The figures of the share, common to its parts.
#[derive(Debug, Clone, Default)]
pub struct ShareFigures {
    pub(super) counts: Arc<Counts>,
    pub(super) link: Option<String>,
    pub(super) socket: Option<String>,
}

impl ShareFigures {
    /// Returns the present figures.
    pub fn status(&self) -> ShareStatus {
        let counts = &self.counts;
        let texts = counts.texts.lock().unwrap_or_else(PoisonError::into_inner);
        let errors: Vec<&str> = texts.errors.iter().flatten().map(String::as_str).collect();
        ShareStatus {
            link: self.link.clone(),
            terminal: texts.terminal.clone(),
            reading: counts.reading.get() > 0,
            bytes: counts.bytes.get(),
            dropped_bytes: counts.dropped_bytes.get(),
            ignored_bytes: counts.ignored_bytes.get(),
            socket: self.socket.clone(),
            clients: counts.clients.get(),
            clients_refused: counts.clients_refused.get(),
            lines: counts.lines.get(),
            lost_lines: counts.lost_lines.get(),
            error: (!errors.is_empty()).then(|| errors.join("; ")),
        }
    }

    pub(super) fn terminal(&self, path: &Path) {
        self.texts(|texts| texts.terminal = Some(path.display().to_string()));
    }

    /// Notes why a way does not work, or that it works; logs what is new.
    pub(super) fn state(&self, way: Way, error: Option<String>) {
        self.texts(|texts| {
            let known = &mut texts.errors[way as usize];
            if *known != error {
                match &error {
                    Some(error) => tracing::warn!(%error, "share"),
                    None => tracing::info!("the live data is shared again"),
                }
                *known = error;
            }
        });
    }

    fn texts(&self, change: impl FnOnce(&mut Texts)) {
        change(&mut self.counts.texts.lock().unwrap_or_else(PoisonError::into_inner));
    }
}
