//! Imports: a recording becomes a capture, complete or not at all, beside a running capture.
//!
//! Records arrive in the order of a capture's (segment, samples, gap, segment…). They are written in steps of a few
//! tens of milliseconds, each in a separate transaction, so that the running capture's commits are not delayed. The
//! next step is gathered while one is written, and it is passed to the writer only after the one before is committed.
//! Steps are synced with the next commit, at the latest when the import is finished: no one relies on them before. The
//! new capture is visible only after [`Import::finish`]. An import that is dropped, fails or is killed leaves only rows
//! that [`Store::purge_step`] removes.

use super::captures::create;
use super::insert::insert;
use super::names::{check_name, name_is_free, numbered};
use super::schema::Durability;
use super::sql::{find, value};
use super::{Begun, NewCapture, Store, StoreError};
use imu_core::sample::Record;
use rusqlite::{Connection, Transaction, params};

/// Records written in one transaction.
const STEP: usize = 8000;

/// A capture that is being imported.
#[derive(Debug)]
pub struct Import {
    store: Store,
    id: i64,
    name: Option<String>,
    liked_name: Option<String>,
    fingerprint: Option<String>,
    pending: Vec<(i64, Record)>,
    /// The step that is being written, if any.
    begun: Option<Begun<()>>,
    finished: bool,
}

/// The outcome of an import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImportEnd {
    /// A new capture.
    Created(i64),
    /// The same recording was imported before, as this capture.
    Known(i64),
}

impl ImportEnd {
    /// Returns the capture that holds the recording.
    pub fn id(self) -> i64 {
        match self {
            Self::Created(id) | Self::Known(id) => id,
        }
    }
}

impl Store {
    /// Returns the capture that was imported from the recording with this fingerprint, if there is one.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn imported(&self, fingerprint: &str) -> Result<Option<i64>, StoreError> {
        let fingerprint = fingerprint.to_owned();
        self.execute(move |transaction| known(transaction, &fingerprint))
    }

    /// Begins an import. `fingerprint` identifies the recording's content: the same content makes one capture, however
    /// often it is imported. Without a fingerprint every import makes a capture.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`], [`StoreError::NameRefused`], or the error that the database reports.
    pub fn begin_import(&self, capture: NewCapture, fingerprint: Option<&str>) -> Result<Import, StoreError> {
        let name = capture.name.clone();
        if let Some(name) = &name {
            check_name(name)?;
        }
        let liked_name = capture.liked_name.clone().filter(|name| check_name(name).is_ok());
        let utc_ns = self.utc_ns();
        let fingerprint = fingerprint.map(str::to_owned);
        let of_row = fingerprint.clone();
        let id = self.execute(move |transaction| {
            if let Some(name) = &capture.name {
                let mine = match &of_row {
                    Some(fingerprint) => known(transaction, fingerprint)?.is_some(),
                    None => false,
                };
                if !mine && !name_is_free(transaction, name)? {
                    return Err(StoreError::NameTaken(name.clone()));
                }
            }
            create(transaction, &capture, utc_ns, "importing", of_row.as_deref())
        })?;
        let pending = Vec::with_capacity(STEP);
        Ok(Import { store: self.clone(), id, name, liked_name, fingerprint, pending, begun: None, finished: false })
    }
}

impl Import {
    /// Adds a record.
    ///
    /// # Errors
    /// The error that the database reports; the import must then be dropped.
    pub fn push(&mut self, record: Record) -> Result<(), StoreError> {
        self.pending.push((self.id, record));
        if self.pending.len() >= STEP { self.write() } else { Ok(()) }
    }

    /// Passes the gathered records to the writer, once it has committed the previous step.
    fn write(&mut self) -> Result<(), StoreError> {
        self.settle()?;
        let records = std::mem::replace(&mut self.pending, Vec::with_capacity(STEP));
        let utc_ns = self.store.utc_ns();
        let insert = move |transaction: &Transaction<'_>| insert(transaction, &records, utc_ns, 0).map(drop);
        self.begun = Some(self.store.begin(Durability::Later, insert)?);
        Ok(())
    }

    /// Waits for the step that is being written.
    fn settle(&mut self) -> Result<(), StoreError> {
        self.begun.take().map_or(Ok(()), Begun::wait)
    }

    /// Makes the capture visible. `ended_utc_ns` is the end of its recording, if known.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`] if another capture took the name meanwhile, or the error that the database reports.
    pub fn finish(mut self, ended_utc_ns: Option<i64>) -> Result<ImportEnd, StoreError> {
        self.write()?;
        self.settle()?;
        let (id, name, fingerprint) = (self.id, self.name.clone(), self.fingerprint.clone());
        let liked_name = self.liked_name.clone();
        let end = self.store.execute(move |transaction| {
            if let Some(fingerprint) = &fingerprint
                && let Some(known) = known(transaction, fingerprint)?
            {
                transaction.execute("UPDATE capture SET lifecycle = 'deleted' WHERE id = ?1", [id])?;
                return Ok(ImportEnd::Known(known));
            }
            // Names are assigned when a capture becomes visible: another one may have taken this name meanwhile.
            let called: String =
                value(transaction, "SELECT name FROM capture WHERE id = ?1 AND lifecycle = 'importing'", [id])?;
            if !name_is_free(transaction, &called)? {
                if let Some(name) = name {
                    return Err(StoreError::NameTaken(name));
                }
                let other = numbered(transaction, &liked_name.unwrap_or(called))?;
                transaction.execute("UPDATE capture SET name = ?2 WHERE id = ?1", params![id, other])?;
            }
            let sql = "UPDATE capture SET lifecycle = 'live', ended_utc_ns = coalesce(?2, ended_utc_ns) WHERE id = ?1";
            transaction.execute(sql, params![id, ended_utc_ns])?;
            Ok(ImportEnd::Created(id))
        })?;
        self.finished = true;
        Ok(end)
    }
}

impl Drop for Import {
    fn drop(&mut self) {
        if self.finished {
            return;
        }
        let id = self.id;
        let marked = self.store.execute(move |transaction| {
            transaction
                .execute("UPDATE capture SET lifecycle = 'deleted' WHERE id = ?1 AND lifecycle = 'importing'", [id])?;
            Ok(())
        });
        if let Err(error) = marked {
            tracing::warn!(message = "An unfinished import is cleared away at the next start.", id, %error);
        }
    }
}

fn known(connection: &Connection, fingerprint: &str) -> Result<Option<i64>, StoreError> {
    let sql = "SELECT id FROM capture WHERE fingerprint = ?1 AND lifecycle = 'live'";
    Ok(find(connection, sql, [fingerprint], |row| row.get(0))?)
}
