//! For tests: the writer without its thread, and simulated failures of the disk.

use super::super::progress::locked;
use super::{Failure, Writer};
use crate::observe::StorageState;
use imu_core::sample::Record;
use std::time::Duration;
use tokio::time::Instant;

impl Writer {
    /// Writes the records and behaves as if the commit had returned an error.
    pub(in crate::store) fn pretend_failed_commit(&mut self, records: Vec<(i64, Record)>) {
        self.batch = records;
        self.write_batch().unwrap();
        self.in_doubt = true;
        self.suspect = true;
        self.connection = None;
    }

    /// Behaves as if the disk had reported an error: the connection is closed.
    pub(in crate::store) fn pretend_io_error(&mut self) {
        let code = rusqlite::ffi::Error::new(rusqlite::ffi::SQLITE_IOERR_WRITE);
        self.fail(Failure::of(&rusqlite::Error::SqliteFailure(code, None).into()));
        assert!(self.connection.is_none());
    }

    /// Behaves as if the disk had gone: the lock's file takes nothing any more.
    pub(in crate::store) fn pretend_no_disk(&mut self, lock: &std::path::Path) {
        self.parts.lock.file = std::fs::File::open(lock).unwrap();
    }

    /// Commits the records at the first attempt that succeeds; returns how many failed.
    pub(in crate::store) fn write_now(&mut self, records: impl IntoIterator<Item = (i64, Record)>) -> usize {
        self.batch.extend(records);
        for failed in 0..5 {
            self.commit();
            if self.batch.is_empty() || self.damage.is_some() {
                return failed;
            }
        }
        panic!("{:?}", locked(&self.parts.progress));
    }

    /// Tries a step of correcting civil times; returns when the next one is due.
    pub(in crate::store) fn correct_now(&mut self) -> Option<Duration> {
        self.correct_times();
        self.correcting.map(|at| at - Instant::now())
    }

    /// Checks whether the path still names the open file.
    pub(in crate::store) fn check_now(&mut self) {
        self.check_file();
    }

    /// Tries the batch once.
    pub(in crate::store) fn attempt(&mut self) -> StorageState {
        self.commit();
        locked(&self.parts.progress).state
    }

    /// Tries the batch again.
    pub(in crate::store) fn retry_now(&mut self) {
        self.commit();
        assert!(self.batch.is_empty());
    }
}
